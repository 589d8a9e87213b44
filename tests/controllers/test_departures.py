"""Laws for steering by themselves: each brings departures of both signs of curvature back, at 11 to 38 m/s."""

import numpy as np
import pytest

from controllers import PID, PurePursuit, SlidingMode, Stanley
from ldctoolkit import Controller, EventStatus, Scenarios, simulate

SOME = Scenarios.from_arrays(
    T=[2.5, 6.0, 4.0, 5.0], d_y=[0.4, 0.7, 0.6, 0.9], v_mean=[11.0, 18.0, 27.0, 38.0], c_0=[1e-3, -2e-3, 0.0, 5e-4]
)


@pytest.mark.parametrize(
    ("design", "reduction", "left", "beyond"),
    [
        (PID(K_p=-0.015), 0.1, 0.1, 0.25),
        (Stanley(), 0.2, 0.03, 0.05),
        (SlidingMode(), 0.1, 1e-3, 0.01),
        (PurePursuit(T_lp=1.0), 0.2, 0.15, 0.3),  # what side slip leaves in a bend
    ],
    ids=lambda value: value.name if isinstance(value, Controller) else "",
)
def test_it_brings_departures_back(design: Controller, reduction: float, left: float, beyond: float) -> None:
    """What is left of e_y [m] in the end, and how far it goes beyond the centre on the way."""
    out = simulate(design, SOME, y_s=0.1, settle=20.0 if design.name == "pid" else 10.0, trajectories=True)
    assert (out.status == EventStatus.OK).all()
    assert (out.reduction > reduction).all()
    paths = out.trajectories
    for i in range(4):
        e_y = paths.x[i, np.isfinite(paths.t[i]), 0]
        straight = design.name == "pure_pursuit" and SOME.c_0[i] == 0.0
        assert abs(e_y[-1]) < (0.01 if straight else left)
        assert e_y.min() > -beyond
    assert np.nanmax(np.abs(paths.delta)) <= 0.1
