"""Limits of rank correlations by drawing twice from one population."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from studies.report.model_match.match import rank_limits


def ranks(x: np.ndarray) -> np.ndarray:
    """Rank correlations of (m, n, d) departures, (m, d, d)."""
    centred = stats.rankdata(x, axis=1) - 0.5 * (x.shape[1] + 1)
    moments = np.einsum("mni,mnj->mij", centred, centred)
    size = np.sqrt(np.einsum("mii->mi", moments))
    return np.asarray(moments / (size[:, :, None] * size[:, None, :]))


@pytest.mark.slow
@pytest.mark.parametrize(("n", "other"), [(20, 20), (40, 500), (200, 300)])
def test_chance_leads_beyond_them_as_rarely_as_told(n: int, other: int) -> None:
    """Four correlated normal columns, six pairs, both samples drawn."""
    rng = np.random.default_rng(n)
    root = np.linalg.cholesky(
        [[1.0, 0.8, -0.3, 0.0], [0.8, 1.0, 0.0, 0.0], [-0.3, 0.0, 1.0, 0.5], [0.0, 0.0, 0.5, 1.0]]
    )
    repetitions, above = 1500, np.triu_indices(4, 1)
    one, two = (ranks(rng.normal(size=(repetitions, m, 4)) @ root.T)[:, *above] for m in (n, other))
    beyond = 0
    for mine, reference in zip(one, two, strict=True):
        limits = np.array([rank_limits(float(r), n, other, 6) for r in reference])
        beyond += bool(np.any((mine < limits[:, 0]) | (mine > limits[:, 1])))
    # 5 % or fewer (Bonferroni, correlated pairs; limits of small samples are some wider), four standard errors
    assert 0.01 < beyond / repetitions < 0.05 + 4.0 * np.sqrt(0.05 * 0.95 / repetitions)


def test_limits_hold_the_reference_and_close_with_the_number() -> None:
    for reference in (-1.0, -0.4, 0.0, 0.9, 1.0):
        wide, narrow = rank_limits(reference, 30, 100, 28), rank_limits(reference, 3000, 10_000, 28)
        assert -1.0 <= wide[0] <= narrow[0] <= reference + 1e-6
        assert reference - 1e-6 <= narrow[1] <= wide[1] <= 1.0
    # at r = 0 artanh r has the variance 1/(n - 3) = 0.01; Student's quantile of 97.5 % with 100 degrees is 1.984
    assert rank_limits(0.0, 103, 1e9, 1) == pytest.approx((-0.1958, 0.1958), abs=1e-4)
    assert rank_limits(0.3, 100, 100, 1)[1] < rank_limits(0.3, 100, 100, 28)[1]
