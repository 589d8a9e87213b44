"""Pure pursuit: the arc from the rear axle through a goal point on the lane's centre line.

Source: R. C. Coulter, *Implementation of the Pure Pursuit Path Tracking Algorithm* (CMU-RI-TR-92-01, 1992). An arc that
leaves the rear axle along the vehicle's heading and meets a goal point at distance D and angle alpha to the left has
the curvature 2 sin(alpha)/D, and a vehicle with wheel base L drives it at

    delta = atan(2 L sin(alpha)/D),    clipped to +-delta_max. Positive to the left (ISO 8855), radians.

The goal point lies on the centre line at l_d = max(l_min, T_lp v) ahead of the rear axle, measured along the lane;
D is the straight distance to it. The lane ahead is drawn from the previewed heading with small angles, as in the error
dynamics: it is s long and integral of v dpsi_l to the left at s metres ahead.
"""

from __future__ import annotations

import dataclasses
import math
from typing import ClassVar, final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.control import Controller, EventStatus, Preview, SteeringLaw
from ldctoolkit.declared import gain
from ldctoolkit.errors import InputError
from ldctoolkit.vehicle.bicycle import Plant

_STEP = 0.1  # s between two looks at the lane


@final
@dataclasses.dataclass(frozen=True)
class PurePursuit(Controller):
    """Pure pursuit of a point on the lane's centre line.

    Examples
    --------
    >>> PurePursuit(T_lp=1.5).l_min
    8.0
    """

    name: ClassVar[str] = "pure_pursuit"
    title: ClassVar[str] = "Pure pursuit"

    T_lp: float = gain(1.2, unit="s", lower=0.0, upper=10.0, description="lookahead time")
    l_min: float = gain(8.0, unit="m", lower=1.0, upper=100.0, description="least lookahead distance")
    delta_max: float = gain(0.1, unit="rad", lower=1e-3, upper=1.0, description="limit of the steering angle")

    def prepare(self, plant: Plant) -> PurePursuitLaw:
        """Place the goal points and work out how the lane's position there follows from the preview.

        Raises `InputError` if l_min does not reach beyond the centre of gravity.
        """
        p = plant.model.parameters
        if self.l_min <= p.l_r:
            raise InputError("pure_pursuit.l_min", "m", value=self.l_min, allowed=f"more than l_r = {p.l_r:g} m")
        distance = np.maximum(self.l_min, self.T_lp * plant.v) - p.l_r
        of_heading, of_yaw_rate = _integral(distance / plant.v)
        return PurePursuitLaw(
            design=self,
            L=p.l_f + p.l_r,
            l_r=p.l_r,
            distance=distance,
            of_heading=plant.v[:, None] * of_heading,
            of_yaw_rate=plant.v[:, None] * of_yaw_rate,
        )


def _integral(T: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Weights (n, p) of heading and yaw rate at 0, _STEP, ... in the integral of the heading from 0 to T (n,).

    Of the cubic Hermite interpolant, up to and within the interval that T falls into.
    """
    cells = max(1, math.ceil(float(T.max(initial=0.0)) / _STEP))
    heading, yaw_rate = np.zeros((T.size, cells + 1)), np.zeros((T.size, cells + 1))
    for j in range(cells):
        u = np.clip(T / _STEP - j, 0.0, 1.0)
        heading[:, j] += _STEP * u * (1.0 + u * u * (0.5 * u - 1.0))
        heading[:, j + 1] += _STEP * u * u * u * (1.0 - 0.5 * u)
        yaw_rate[:, j] += _STEP**2 * u * u * (0.5 + u * (0.25 * u - 2.0 / 3.0))
        yaw_rate[:, j + 1] += _STEP**2 * u * u * u * (0.25 * u - 1.0 / 3.0)
    return heading, yaw_rate


@final
@dataclasses.dataclass(frozen=True)
class PurePursuitLaw(SteeringLaw):
    """Pure pursuit of n scenarios; it has no state."""

    design: PurePursuit
    # [m] Wheel base, distance from the centre of gravity to the rear axle
    L: float
    l_r: float
    distance: FloatArray  # (n,) [m] The goal point's distance along the lane from the centre of gravity
    of_heading: FloatArray  # (n, p) [m/rad]
    of_yaw_rate: FloatArray  # (n, p) [m per rad/s] Weights of the preview in the goal point's lateral position

    @property
    def preview_times(self) -> FloatArray:
        """Every 0.1 s as far as the goal point that is the longest time away."""
        return np.asarray(_STEP * np.arange(self.of_heading.shape[1]), dtype=np.float64)

    def init(self, n: int) -> None:
        """No state."""

    def take(self, rows: IntArray, state: None) -> tuple[PurePursuitLaw, None]:
        """Only some scenarios."""
        names = ("distance", "of_heading", "of_yaw_rate")
        return dataclasses.replace(self, **{name: getattr(self, name)[rows] for name in names}), None

    def lane_offset(self, preview: Preview) -> FloatArray:
        """Lateral position (n,) [m] of the goal point against the lane's tangent beside the centre of gravity."""
        y = np.zeros(self.distance.size)
        # one time after the other: the sum must not depend on how many times other scenarios need
        for j in range(self.of_heading.shape[1]):
            y += self.of_heading[:, j] * preview.heading[:, j]
            y += self.of_yaw_rate[:, j] * preview.yaw_rate[:, j]
        return y

    def step(
        self, t: FloatArray, x: FloatArray, preview: Preview, delta_prev: FloatArray, state: None
    ) -> tuple[FloatArray, None, npt.NDArray[np.int8]]:
        """One command for each scenario."""
        e_psi = x[:, 2] + 0.0  # contiguous: sine and cosine take the same route whatever the number of scenarios
        sin, cos = np.sin(e_psi), np.cos(e_psi)
        along = self.distance + self.l_r * cos  # from the rear axle to the goal, along and across the lane
        across = self.lane_offset(preview) - x[:, 0] + self.l_r * sin
        to_left = cos * across - sin * along  # D sin(alpha)
        unlimited = np.arctan(2.0 * self.L * to_left / (along * along + across * across))
        delta = np.clip(unlimited, -self.design.delta_max, self.design.delta_max)
        return delta, None, np.full(delta.size, EventStatus.OK, dtype=np.int8)
