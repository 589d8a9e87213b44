"""Margins of requirements: above 0 exactly where a requirement is missed."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from studies.ranking.figures import parse_requirement
from studies.search.requirement_margins import requirement_margins

NUMBERS = st.floats(allow_infinity=True, allow_nan=True)


@given(
    st.lists(NUMBERS, min_size=1, max_size=5),
    st.sampled_from(["<=", "<", ">=", ">"]),
    st.floats(-1e6, 1e6) | st.sampled_from([0.0, 5e-324]),
)
def test_a_margin_is_above_zero_where_the_requirement_is_missed(S: list[float], operator: str, limit: float) -> None:
    requirement = parse_requirement(f"S {operator} {limit!r}")
    values = np.array([*S, limit])
    figures: Any = SimpleNamespace(S=values)
    margins = requirement_margins([requirement], figures)
    assert margins.shape == (values.size, 1)
    np.testing.assert_array_equal(margins[:, 0] <= 0, requirement.met(values))
    assert not np.isnan(margins).any()


def test_margins_are_parts_of_the_limit() -> None:
    figures: Any = SimpleNamespace(S=np.array([3.0, 1.0, np.nan]), reduction=np.array([0.2, 0.5, 0.4]))
    requirements = [parse_requirement(text) for text in ("S <= 2", "reduction >= 0.4", "reduction > 0", "S < 1")]
    found = requirement_margins(requirements, figures)
    np.testing.assert_allclose(found[0], [0.5, 0.5, -0.2, 2.0], rtol=1e-12)
    np.testing.assert_allclose(found[1, :3], [-0.5, -0.25, -0.5], rtol=1e-12)
    assert 0 < found[1, 3] < 1e-9  # at the limit, which does not belong to it
    assert found[2].tolist() == [np.inf, 0.0, -0.4, np.inf]
    assert requirement_margins([], figures).shape == (3, 0)
    negative: Any = SimpleNamespace(S=np.zeros(3), dtle_min=np.array([-0.3, -0.2, -0.1]))
    found = requirement_margins([parse_requirement("dtle_min >= -0.2")], negative)
    np.testing.assert_allclose(found[:, 0], [0.5, 0.0, -0.5], rtol=1e-12)
