"""The sampled loop at one speed: vehicle, steering actuator, camera, law; as matrices.

The plant behind its actuator is that of `ldctoolkit.vehicle.augmented`. The camera's delay and the Kalman filter belong
to the law's side, and so do its earlier commands. Limits are left out: this is the loop at small signals.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray
from ldctoolkit.plant_options import Actuator
from ldctoolkit.review.law_model import LawModel
from ldctoolkit.vehicle.augmented import AugmentedStep, augmented

ComplexArray = npt.NDArray[np.complex128]

_ENTRIES = 4_000_000
"""Numbers of a block of matrices: a long delay makes large ones."""


@dataclasses.dataclass(frozen=True)
class System:
    """A sampled linear system: s+ = A s + B u, y = C s + D u."""

    A: FloatArray  # (k, k)
    B: FloatArray  # (k, p)
    C: FloatArray  # (q, k)
    D: FloatArray  # (q, p)

    def response(self, z: ComplexArray) -> ComplexArray:
        """Transfer function at points z (m,) of the complex plane, (m, q, p)."""
        if not self.A.size:
            return np.broadcast_to(self.D, (z.size, *self.D.shape)).astype(np.complex128)
        k = self.A.shape[0]
        block = max(1, _ENTRIES // k**2)
        parts = [
            np.linalg.solve(z[i : i + block, None, None] * np.eye(k) - self.A, self.B[None].astype(np.complex128))
            for i in range(0, z.size, block)
        ]
        return np.asarray(self.C @ np.concatenate(parts) + self.D)


@dataclasses.dataclass(frozen=True)
class Camera:
    """What stands between the vehicle's state and the law."""

    delay: float  # [samples] Age of e_y and e_psi, which count as linear between samples; rates are true
    age: float  # [samples] Age of the wheel angle that the law and the filter see; linear between samples too
    # (4, 2) or None Gain of the Kalman filter that rebuilds all four states; None for no filter
    gain: FloatArray | None
    step: AugmentedStep  # One sample of the filter's nominal vehicle and actuator, n = 1


def sampled_vehicle(A: FloatArray, B: FloatArray, E: FloatArray, dt: float, actuator: Actuator) -> System:
    """Vehicle behind its actuator, sampled: inputs (command, lane yaw rate), outputs x and the wheel angle."""
    step = augmented(A[None], B[None], E[None], dt, lag=actuator.lag, delay=actuator.delay)
    if actuator.lag == 0:  # the wheel stands where the last command that arrived has put it
        young, old, E_0, E_1 = (np.pad(w, ((0, 0), (0, 1))) for w in (step.B, step.B_old, step.E_0, step.E_1))
        young[:, 4] = 1.0
        inside = np.pad(step.A, ((0, 0), (0, 1), (0, 1)))
        step = AugmentedStep(inside, young, old, E_0, E_1, step.whole, step.split)
    full, command, E_0, E_1 = (matrix[0] for matrix in step.with_commands())
    return System(full, np.stack([command, E_0 + E_1], axis=1), np.eye(5, full.shape[0]), np.zeros((5, 2)))


def controller_side(law: LawModel, camera: Camera) -> System:
    """Camera, filter and law with its earlier commands: inputs (x, wheel angle, lane yaw rate), output the command."""
    d, a = (math.ceil(age - 1e-9) for age in (camera.delay, camera.age))
    kal, own, step = 4 if camera.gain is not None else 0, law.A.shape[0], camera.step
    at_wheel, at_filter = 2 * d, 2 * d + a
    at_law, last = at_filter + kal, at_filter + kal + own
    size = last + 1 + step.whole

    def signal(*terms: tuple[int, float]) -> FloatArray:
        """A signal as weights of the states, then of the inputs (x, wheel, r)."""
        row = np.zeros(size + 6)
        for place, weight in terms:
            row[place] += weight
        return row

    following = np.zeros((size, size + 6))

    def aged(now: FloatArray, place: int, whole: int, age: float) -> FloatArray:
        """What signals (w, size + 6) were `age` samples ago, `whole` rounded up; earlier ones from a state on."""
        width = now.shape[0]
        past = np.vstack([now, *(signal((place + j, 1.0)) for j in range(width * whole))])
        following[place : place + width * whole] = past[: width * whole]
        younger, older = (past[width * j : width * (j + 1)] for j in (max(whole - 1, 0), whole))
        return older + (whole - age) * (younger - older)

    x = np.array([signal((size + i, 1.0)) for i in range(4)])
    r = signal((size + 5, 1.0))
    frame = aged(x[[0, 2]], 0, d, camera.delay)
    wheel = aged(signal((size + 4, 1.0))[None], at_wheel, a, camera.age)[0]
    if camera.gain is None:
        seen = np.array([frame[0], x[1], frame[1], x[3]])
    else:
        predicted = np.array([signal((at_filter + i, 1.0)) for i in range(4)])
        seen = predicted + camera.gain @ (frame - predicted[[0, 2]])
    u = np.vstack([seen, signal((last, 1.0)), r, wheel])
    states = np.array([signal((at_law + i, 1.0)) for i in range(own)]).reshape(own, size + 6)
    delta = law.C @ states + law.D @ u
    commands = [delta, *(signal((last + i, 1.0)) for i in range(step.whole + 1))]

    if kal:
        inputs = [(step.B, commands[step.whole]), (step.B_old, commands[step.whole + 1]), (step.E_0 + step.E_1, r)]
        if step.A.shape[1] > 4:
            inputs.append((step.A[:, :, 4], wheel))
        following[at_filter:at_law] = step.A[0, :4, :4] @ seen + sum(np.outer(w[0, :4], row) for w, row in inputs)
    following[at_law:last] = law.A @ states + law.B @ u
    following[last:] = commands[:-1]
    return System(following[:, :size], following[:, size:], delta[None, :size], delta[None, size:])


@dataclasses.dataclass(frozen=True)
class Loop:
    """The loop, open at the command."""

    open: System  # From the command that the actuator gets to minus the one that the law gives
    closed_A: FloatArray  # (k, k) One sample of the closed loop
    closed_E: FloatArray  # (k,) What a lane yaw rate of 1 rad/s adds

    @classmethod
    def of(cls, vehicle: System, controller: System) -> Loop:
        """Join both sides."""
        k, c = vehicle.A.shape[0], controller.A.shape[0]
        A = np.zeros((k + c, k + c))
        A[:k, :k], A[k:, k:] = vehicle.A, controller.A
        A[k:, :k] = controller.B[:, :5] @ vehicle.C
        B = np.concatenate([vehicle.B[:, 0], np.zeros(c)])
        delta = np.concatenate([controller.D[0, :5] @ vehicle.C, controller.C[0]])
        E = np.concatenate([vehicle.B[:, 1] + vehicle.B[:, 0] * controller.D[0, 5], controller.B[:, 5]])
        opened = System(A, B[:, None], -delta[None, :], np.zeros((1, 1)))
        return cls(opened, A + np.outer(B, delta), E)

    def steady(self) -> FloatArray:
        """State, command and lane yaw rate in a bend once it has settled, per lane yaw rate of 1 rad/s, (6,)."""
        k = self.closed_A.shape[0]
        settled = np.linalg.solve(np.eye(k) - self.closed_A, self.closed_E)
        return np.array([*settled[:4], settled[-1], 1.0])  # the last state is an earlier command
