"""Departures for the tests of the scenario model."""

from collections.abc import Callable

import pytest

from helpers.models import varied_departures
from ldctoolkit.departures import Departures


@pytest.fixture(scope="session")
def departures() -> Callable[..., Departures]:
    """Makes n departures a side; a column can be replaced, by default only T, d_y and v_mean vary."""

    def make(n: int = 200, seed: int = 0, **changed: object) -> Departures:
        still: dict[str, object] = {"sigma_y": 0.05, "a_mean": 0.0, "sigma_v": 0.04, "c_0": 0.0, "dc": 0.0}
        return varied_departures(n, seed, **(still | changed))

    return make
