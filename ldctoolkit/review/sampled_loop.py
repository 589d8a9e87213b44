"""The sampled loop at one speed: vehicle, steering actuator, camera, law; as matrices.

The command, held for a sample, passes a pure delay and a first-order lag before it steers the vehicle. The plant is
sampled exactly, fractions of a sample of delay included (K. J. Astrom, B. Wittenmark, *Computer-Controlled Systems*,
sections on sampling systems with time delays). The camera's delay and the Kalman filter belong to the law's side, and
so does its previous command. Limits are left out: this is the loop at small signals.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray
from ldctoolkit.plant_options import Actuator
from ldctoolkit.review.law_model import LawModel
from ldctoolkit.vehicle.discretization import expm

ComplexArray = npt.NDArray[np.complex128]

_ENTRIES = 4_000_000
"""Numbers of a block of matrices: a long delay makes large ones."""

_WHOLE = 1e-9
"""Parts of a sample of delay that are rounding."""


@dataclasses.dataclass(frozen=True)
class System:
    """A sampled linear system: s+ = A s + B u, y = C s + D u.

    Attributes
    ----------
    A : (k, k)
    B : (k, p)
    C : (q, k)
    D : (q, p)
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray

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
    """What stands between the vehicle's state and the law.

    Attributes
    ----------
    delay : int [samples]
        Age of e_y and e_psi; rates are true.
    gain : (4, 2) or None
        Gain of the Kalman filter that rebuilds all four states; None for no filter.
    A, B, E : (4, 4), (4,), (4,)
        One step of the filter's nominal vehicle.
    """

    delay: int
    gain: FloatArray | None
    A: FloatArray
    B: FloatArray
    E: FloatArray


def sampled_vehicle(A: FloatArray, B: FloatArray, E: FloatArray, dt: float, actuator: Actuator) -> System:
    """Vehicle behind its actuator, sampled: inputs (command, lane yaw rate), outputs x.

    Parameters
    ----------
    A : (4, 4)
    B, E : (4,)
        Continuous-time matrices.
    dt : float [s]
    actuator : Actuator
        Its delay and lag; limits are left out. The lane's yaw rate is held over a sample.

    Returns
    -------
    System
    """
    k = 5 if actuator.lag > 0 else 4
    inside, forced = np.zeros((k, k)), np.zeros((k, 2))
    inside[:4, :4], forced[:4, 1] = A, E
    if actuator.lag > 0:
        inside[:4, 4], inside[4, 4], forced[4, 0] = B, -1.0 / actuator.lag, 1.0 / actuator.lag
    else:
        forced[:4, 0] = B
    whole = math.floor(actuator.delay / dt + _WHOLE)
    part = max(0.0, actuator.delay - whole * dt)
    part = 0.0 if part <= _WHOLE * dt else part
    phi_late, gamma_late = _held(inside, forced, dt - part)
    _, gamma_early = _held(inside, forced, part)
    phi, gamma = _held(inside, forced, dt)
    # commands of the last m samples, the latest first: the wheel gets the older of two before the younger
    m = whole + (part > 0.0)
    full = np.zeros((k + m, k + m))
    inputs = np.zeros((k + m, 2))
    full[:k, :k] = phi
    inputs[:k, 1] = gamma[:, 1]
    _add(full, inputs, k, whole, gamma_late[:, 0])
    if part > 0.0:
        _add(full, inputs, k, whole + 1, phi_late @ gamma_early[:, 0])
    if m:
        inputs[k, 0] = 1.0
        full[k + 1 :, k : k + m - 1] = np.eye(m - 1)
    return System(full, inputs, np.eye(4, k + m), np.zeros((4, 2)))


def _add(full: FloatArray, inputs: FloatArray, k: int, age: int, weight: FloatArray) -> None:
    """Let the command that is `age` samples old act on the first k states."""
    if age == 0:
        inputs[:k, 0] += weight
    else:
        full[:k, k + age - 1] += weight


def _held(A: FloatArray, B: FloatArray, time: float) -> tuple[FloatArray, FloatArray]:
    """Transition over a time with the inputs held."""
    k, p = B.shape
    M = np.zeros((1, k + p, k + p))
    M[0, :k, :k], M[0, :k, k:] = A * time, B * time
    X = expm(M)[0]
    return X[:k, :k], X[:k, k:]


def controller_side(law: LawModel, camera: Camera) -> System:
    """Camera, filter and law with its previous command: inputs (x, lane yaw rate), output the command.

    Parameters
    ----------
    law : LawModel
    camera : Camera

    Returns
    -------
    System
    """
    d, kal, own = camera.delay, 4 if camera.gain is not None else 0, law.A.shape[0]
    size = 2 * d + kal + own + 1
    at_filter, at_law, last = 2 * d, 2 * d + kal, size - 1

    def signal(*terms: tuple[int, float]) -> FloatArray:
        """A signal as weights of the states, then of the inputs (x, r)."""
        row = np.zeros(size + 5)
        for place, weight in terms:
            row[place] += weight
        return row

    x = np.array([signal((size + i, 1.0)) for i in range(4)])
    r = signal((size + 4, 1.0))
    frame = np.array([signal((2 * d - 2, 1.0)), signal((2 * d - 1, 1.0))]) if d else x[[0, 2]]
    if camera.gain is None:
        seen = np.array([frame[0], x[1], frame[1], x[3]])
    else:
        predicted = np.array([signal((at_filter + i, 1.0)) for i in range(4)])
        seen = predicted + camera.gain @ (frame - predicted[[0, 2]])
    previous = signal((last, 1.0))
    u = np.vstack([seen, previous, r])
    states = np.array([signal((at_law + i, 1.0)) for i in range(own)]).reshape(own, size + 5)
    delta = law.C @ states + law.D @ u

    following = np.zeros((size, size + 5))
    if d:
        following[:2] = x[[0, 2]]
        for place in range(2, 2 * d):
            following[place] = signal((place - 2, 1.0))
    if kal:
        following[at_filter:at_law] = camera.A @ seen + np.outer(camera.B, delta) + np.outer(camera.E, r)
    following[at_law:last] = law.A @ states + law.B @ u
    following[last] = delta
    return System(following[:, :size], following[:, size:], delta[None, :size], delta[None, size:])


@dataclasses.dataclass(frozen=True)
class Loop:
    """The loop, open at the command.

    Attributes
    ----------
    open : System
        From the command that the actuator gets to minus the one that the law gives.
    closed_A : (k, k)
        One sample of the closed loop.
    closed_E : (k,)
        What a lane yaw rate of 1 rad/s adds.
    """

    open: System
    closed_A: FloatArray
    closed_E: FloatArray

    @classmethod
    def of(cls, vehicle: System, controller: System) -> Loop:
        """Join both sides."""
        k, c = vehicle.A.shape[0], controller.A.shape[0]
        A = np.zeros((k + c, k + c))
        A[:k, :k], A[k:, k:] = vehicle.A, controller.A
        A[k:, :k] = controller.B[:, :4] @ vehicle.C
        B = np.concatenate([vehicle.B[:, 0], np.zeros(c)])
        delta = np.concatenate([controller.D[0, :4] @ vehicle.C, controller.C[0]])
        E = np.concatenate([vehicle.B[:, 1] + vehicle.B[:, 0] * controller.D[0, 4], controller.B[:, 4]])
        opened = System(A, B[:, None], -delta[None, :], np.zeros((1, 1)))
        return cls(opened, A + np.outer(B, delta), E)

    def steady(self) -> FloatArray:
        """State, command and lane yaw rate in a bend once it has settled, per lane yaw rate of 1 rad/s, (6,)."""
        k = self.closed_A.shape[0]
        settled = np.linalg.solve(np.eye(k) - self.closed_A, self.closed_E)
        return np.array([*settled[:4], settled[-1], 1.0])  # the last state is the command before
