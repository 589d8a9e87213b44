"""Super-twisting sliding mode control of the offset at a point ahead, saturated, with the implicit discretisation.

Let x~ = x - x_ss psi_l' be the deviation from steady cornering at the lane's yaw rate psi_l', and e_s = e_y~ + T_lp v
e_psi~ the offset at a point T_lp v ahead. The sliding variable is s = e_s' + lambda_ e_s, of relative degree one; on
s = 0 the offset decays with the time constant 1/lambda_. The super-twisting algorithm (A. Levant, *Sliding order and
sliding accuracy in sliding mode control*, 1993; Y. Shtessel, C. Edwards, L. Fridman, A. Levant, *Sliding Mode Control
and Observation*, 2014, chapter 4) requires

    ds/dt = u + disturbance,    u = -k_1 |s|^(1/2) sign s + w,    dw/dt = -k_2 sign s,

and delta is the angle that brings u about, in samples without chatter, clipped to +-delta_max, w conditioned on what
remains of u: `docs/reference/laws.md` has the derivation, sources and the effect of the gains.
"""

from __future__ import annotations

import dataclasses
from typing import ClassVar, final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.control import Controller, EventStatus, Preview, SteeringLaw
from ldctoolkit.declared import gain
from ldctoolkit.vehicle.bicycle import Plant


@final
@dataclasses.dataclass(frozen=True)
class SlidingMode(Controller):
    """Super-twisting control of the offset at a point ahead.

    Examples
    --------
    >>> SlidingMode(lambda_=2.0).T_lp
    0.3
    """

    name: ClassVar[str] = "sliding_mode"
    title: ClassVar[str] = "Super-twisting"

    lambda_: float = gain(1.5, unit="1/s", lower=0.0, upper=10.0, description="decay rate on the sliding surface")
    k_1: float = gain(2.0, unit="m^0.5/s^1.5", lower=0.0, upper=100.0, description="gain on the root of s")
    k_2: float = gain(0.5, unit="m/s^3", lower=0.0, upper=100.0, description="rate of the integral part")
    T_lp: float = gain(0.3, unit="s", lower=0.0, upper=5.0, description="preview time of the controlled point")
    delta_max: float = gain(0.1, unit="rad", lower=1e-3, upper=1.0, description="limit of the steering angle")

    def prepare(self, plant: Plant) -> SlidingModeLaw:
        """Work out the sliding variable and the equivalent control at every scenario's speed."""
        n, steady, step = plant.n, plant.steady_state(), plant.step
        preview_distance = self.T_lp * plant.v
        c = np.column_stack([np.full(n, self.lambda_), np.ones(n), self.lambda_ * preview_distance, preview_distance])
        x_ss = np.zeros((n, 4))
        x_ss[:, 2] = steady.e_psi
        # a change of lane yaw rate over one step pushes the deviation from steady cornering by D
        D = 0.5 * step.B * steady.delta[:, None] + step.E_1 - x_ss
        drift = sum(c[:, i, None] * (step.A[:, i] - np.eye(4)[i]) for i in range(4))
        return SlidingModeLaw(
            design=self,
            dt=plant.dt,
            c=c,
            drift=np.asarray(drift, dtype=np.float64),
            cB=np.sum(c * step.B, axis=1),
            cD=np.sum(c * D, axis=1),
            e_psi_ss=steady.e_psi,
            delta_ss=steady.delta,
        )


@final
@dataclasses.dataclass(frozen=True)
class SlidingModeLaw(SteeringLaw):
    """The super-twisting law of n scenarios; its state is w (n,) [m/s^2]."""

    design: SlidingMode
    dt: float  # [s]
    c: FloatArray  # (n, 4) The sliding variable is s = c x~
    drift: FloatArray  # (n, 4) c (A - I), change of s over a step without steering
    # (n,) Change of s for a unit of steering angle, and of change of the lane's yaw rate
    cB: FloatArray
    cD: FloatArray
    # (n,) [rad per rad/s] Steady cornering per unit of lane yaw rate
    e_psi_ss: FloatArray
    delta_ss: FloatArray

    @property
    def preview_times(self) -> FloatArray:
        """Now and the next sample."""
        return np.array([0.0, self.dt])

    def init(self, n: int) -> FloatArray:
        """No disturbance is known yet."""
        return np.zeros(n)

    def take(self, rows: IntArray, state: FloatArray) -> tuple[SlidingModeLaw, FloatArray]:
        """Only some scenarios, each with its w."""
        names = ("c", "drift", "cB", "cD", "e_psi_ss", "delta_ss")
        return dataclasses.replace(self, **{name: getattr(self, name)[rows] for name in names}), state[rows]

    def step(
        self, t: FloatArray, x: FloatArray, preview: Preview, delta_prev: FloatArray, state: FloatArray
    ) -> tuple[FloatArray, FloatArray, npt.NDArray[np.int8]]:
        """One command for each scenario."""
        d, dt = self.design, self.dt
        r, r_next = preview.yaw_rate[:, 0], preview.yaw_rate[:, 1]
        e_psi = x[:, 2] - self.e_psi_ss * r
        s = _row_sum(self.c, x, e_psi)
        # delta at which s stays what it is: the equivalent control
        free = _row_sum(self.drift, x, e_psi) + self.cD * (r_next - r)
        hold = self.delta_ss * (0.5 * (r + r_next)) - free / self.cB
        u = super_twisting(s, state, dt, d.k_1, d.k_2)
        delta = np.clip(hold + dt * u / self.cB, -d.delta_max, d.delta_max)
        applied = (delta - hold) * self.cB / dt
        w = conditioned(state, applied, dt, d.k_2)
        return delta, w, np.full(delta.size, EventStatus.OK, dtype=np.int8)


def _row_sum(weights: FloatArray, x: FloatArray, e_psi: FloatArray) -> FloatArray:
    """Weights (n, 4) times the state with e_psi in its place, term by term in one order."""
    total: FloatArray = (
        weights[:, 0] * x[:, 0] + weights[:, 1] * x[:, 1] + weights[:, 2] * e_psi + weights[:, 3] * x[:, 3]
    )
    return total


def super_twisting(s: FloatArray, w: FloatArray, dt: float, k_1: float, k_2: float) -> FloatArray:
    """The u of the implicit super-twisting algorithm for ds/dt = u."""
    half = 0.5 * dt * k_1
    root = np.sqrt(half * half + np.maximum(np.abs(s) - dt * dt * k_2, 0.0)) - half
    y = np.copysign(root * root, s)
    return np.asarray(w - np.clip(s / dt, -dt * k_2, dt * k_2) + (y - s) / dt, dtype=np.float64)


def conditioned(w: FloatArray, u: FloatArray, dt: float, k_2: float) -> FloatArray:
    """The next integral part, given the u that came about."""
    return np.asarray(w + np.clip(0.5 * (u - w), -dt * k_2, dt * k_2), dtype=np.float64)
