"""Vehicles behind their steering actuators, sampled exactly: first-order lag, pure delay of any part of a sample.

The command, held for a sample, passes the delay and the lag before it steers: d wheel/dt = (u(t - delay) - wheel)/lag.
Where the delay is no multiple of the sample time two commands act within one sample (K. J. Astrom, B. Wittenmark,
*Computer-Controlled Systems*, 3rd ed. (1997), section 2.6). Limits of the actuator are left out.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.vehicle.discretization import discretize

_WHOLE = 1e-9
"""Parts of a sample of delay that are rounding."""


@dataclasses.dataclass(frozen=True)
class AugmentedStep:
    """One sample of n vehicles: xi+ = A xi + B delta_(k-whole) + B_old delta_(k-whole-1) + E_0 r + E_1 r+."""

    # (n, j, j) xi is the error state x (j = 4); with a lag (e_y, de_y/dt, e_psi, de_psi/dt, wheel angle), j = 5
    A: FloatArray
    # (n, j) Weights of the younger and the older of two commands that act within the sample; `B_old` is 0 where the
    # delay is a multiple of the sample time
    B: FloatArray
    B_old: FloatArray
    # (n, j) Weights of the lane's yaw rate at the start and the end of the sample
    E_0: FloatArray
    E_1: FloatArray
    whole: int  # [samples] Age of the younger command
    split: bool  # Two commands act within a sample

    @property
    def past(self) -> int:
        """Earlier commands that are still on their way, m."""
        return self.whole + int(self.split)

    def with_commands(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """The same with the commands on their way as states: s = (xi, delta_(k-1), ..., delta_(k-m)), k = j + m."""
        n, j = self.B.shape
        A, B, E_0, E_1 = np.zeros((n, j + self.past, j + self.past)), *np.zeros((3, n, j + self.past))
        A[:, :j, :j], E_0[:, :j], E_1[:, :j] = self.A, self.E_0, self.E_1
        if self.whole:
            A[:, :j, j + self.whole - 1] = self.B
        else:
            B[:, :j] = self.B
        if self.split:
            A[:, :j, j + self.whole] = self.B_old
        if self.past:
            B[:, j] = 1.0
            A[:, j + 1 :, j:-1] = np.eye(self.past - 1)
        return A, B, E_0, E_1


def augmented(A: FloatArray, B: FloatArray, E: FloatArray, dt: float, *, lag: float, delay: float) -> AugmentedStep:
    """Sample n vehicles dx/dt = A x + B wheel + E r behind their actuator.

    Parameters
    ----------
    A : (n, 4, 4)
    B, E : (n, 4)
    dt : float [s]
        Sample time, > 0.
    lag, delay : float [s]
        Of the actuator, >= 0.

    Returns
    -------
    AugmentedStep

    Examples
    --------
    >>> from ldctoolkit import BicycleModel
    >>> step = augmented(*BicycleModel().matrices([20.0, 30.0]), 0.05, lag=0.1, delay=0.12)
    >>> step.A.shape, step.whole, step.past
    ((2, 5, 5), 2, 3)
    """
    if lag > 0:
        n = B.shape[0]
        inside, forced, bend = np.zeros((n, 5, 5)), np.zeros((n, 5)), np.zeros((n, 5))
        inside[:, :4, :4], inside[:, :4, 4], bend[:, :4] = A, B, E
        inside[:, 4, 4], forced[:, 4] = -1.0 / lag, 1.0 / lag
        A, B, E = inside, forced, bend
    whole = math.floor(delay / dt + _WHOLE)
    part = delay - whole * dt
    split, step = part > _WHOLE * dt, discretize(A, B, E, dt)
    young, old = step.B, np.zeros_like(step.B)
    if split:
        late = discretize(A, B, E, dt - part)
        young, old = late.B, np.einsum("nij,nj->ni", late.A, discretize(A, B, E, part).B)
    return AugmentedStep(step.A, young, old, step.E_0, step.E_1, whole, split)
