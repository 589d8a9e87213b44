"""Departures for the tests of the scenario model."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from ldctoolkit.departures import LEFT, PARAMETER_NAMES, RIGHT, Departures


@pytest.fixture(scope="session")
def departures() -> Callable[..., Departures]:
    """Makes n departures a side; a column can be replaced, by default only T, d_y and v_mean vary."""

    def make(n: int = 200, seed: int = 0, **changed: object) -> Departures:
        rng = np.random.default_rng(seed)
        m = 2 * n
        columns = {
            "T": np.clip(np.exp(rng.normal(0.7, 0.5, m)), 0.51, 9.9),
            "d_y": rng.gamma(3.0, 0.07, m),
            "sigma_y": 0.05,
            "v_mean": rng.normal(25.0, 3.0, m),
            "a_mean": 0.0,
            "sigma_v": 0.04,
            "c_0": 0.0,
            "dc": 0.0,
        } | changed
        return Departures(
            side=np.repeat([LEFT, RIGHT], n),
            **{name: np.broadcast_to(np.asarray(columns[name], dtype=float), m).copy() for name in PARAMETER_NAMES},
            recording=np.full(m, "r"),
            start_time=np.zeros(m),
            samples=np.full(m, 20),
        )

    return make
