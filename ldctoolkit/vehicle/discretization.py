"""Exact discretisation of many small linear systems at once.

Between samples delta is constant (zero-order hold) and the lane's yaw rate is a straight line (first-order hold, exact
here because curvature is linear in time). The integral of the first state over the step is carried along, so that
scores are integrals and not sums. Everything comes out of one matrix exponential of the augmented system (C. Van Loan,
*Computing integrals involving the matrix exponential*, IEEE TAC 23(3), 1978).
"""

import dataclasses
import math

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray
from ldctoolkit.errors import InputError

_WHOLE = 1e-7  # parts of a sample of delay that are rounding


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
        """The same with the commands on their way as states: s = (xi, delta_(k-1), ..., delta_(k-m)).

        A (n, j + m, j + m), B, E_0 and E_1 (n, j + m): s+ = A s + B delta_k + E_0 r + E_1 r+.
        """
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
    """Sample n vehicles dx/dt = A x + B wheel + E r behind their actuator."""
    if lag > 0:
        n, j = B.shape
        inside, forced, bend = np.zeros((n, j + 1, j + 1)), np.zeros((n, j + 1)), np.zeros((n, j + 1))
        inside[:, :j, :j], inside[:, :j, j], bend[:, :j] = A, B, E
        inside[:, j, j], forced[:, j] = -1.0 / lag, 1.0 / lag
        A, B, E = inside, forced, bend
    whole = math.floor(delay / dt + _WHOLE)
    part = delay - whole * dt
    split, step = part > _WHOLE * dt, discretize(A, B, E, dt)
    young, old = step.B, np.zeros_like(step.B)
    if split:
        young = discretize(A, B, E, dt - part).B
        old = step.B - young  # a command that holds all along is both
    return AugmentedStep(step.A, young, old, step.E_0, step.E_1, whole, split)


# numerator coefficients of the [13/13] Pade approximant of exp and its validity radius (Higham, SIMAX 26(4), 2005)
_PADE = (
    64764752532480000.0, 32382376266240000.0, 7771770303897600.0, 1187353796428800.0, 129060195264000.0,
    10559470521600.0, 670442572800.0, 33522128640.0, 1323241920.0, 40840800.0, 960960.0, 16380.0, 182.0, 1.0,
)  # fmt: skip
_PADE_RADIUS = 5.371920351148152


@dataclasses.dataclass(frozen=True)
class Discretization:
    """One step of n systems: x+ = A x + B delta + E_0 r + E_1 r+, and the integral of x[0] over the step."""

    A: FloatArray  # (n, 4, 4)
    B: FloatArray  # (n, 4)
    E_0: FloatArray  # (n, 4) Weights of the lane's yaw rate at the start and at the end of the step
    E_1: FloatArray  # (n, 4) Weights of the lane's yaw rate at the start and at the end of the step
    area_x: FloatArray  # (n, 4)
    # (n,) The integral of x[0] over the step is area_x . x + area_delta delta + area_r_0 r + area_r_1 r+.
    area_delta: FloatArray
    area_r_0: FloatArray
    area_r_1: FloatArray


def discretize(A: FloatArray, B: FloatArray, E: FloatArray, dt: npt.ArrayLike) -> Discretization:
    """Discretise n systems dx/dt = A x + B delta + E r exactly, A (n, 4, 4), B and E (n, 4), over steps dt [s] >= 0,
    one for all or (n,). Raises `InputError` if a step is negative or not finite.

    Examples
    --------
    >>> import numpy as np
    >>> step = discretize(np.zeros((1, 4, 4)), np.ones((1, 4)), np.zeros((1, 4)), 0.5)
    >>> step.B
    array([[0.5, 0.5, 0.5, 0.5]])
    """
    n, states = B.shape
    step = np.broadcast_to(np.asarray(dt, dtype=float), (n,)).copy()
    bad = ~(np.isfinite(step) & (step >= 0))
    if bad.any():
        i = int(np.argmax(bad))
        raise InputError(f"dt[{i}]", "s", value=float(step[i]), allowed="a finite step >= 0")
    # z = (integral of x[0], x, delta, r, r+ - r); the last rises from 0, so r(s) = r + (r+ - r) s/dt
    size = states + 4
    delta, rate, rise = states + 1, states + 2, states + 3
    M = np.zeros((n, size, size))
    M[:, 0, 1] = step
    M[:, 1 : states + 1, 1 : states + 1] = A * step[:, None, None]
    M[:, 1 : states + 1, delta] = B * step[:, None]
    M[:, 1 : states + 1, rate] = E * step[:, None]
    M[:, rate, rise] = 1.0  # over the unit step s/dt
    phi = expm(M)
    x = slice(1, states + 1)
    return Discretization(
        A=phi[:, x, x],
        B=phi[:, x, delta],
        E_0=phi[:, x, rate] - phi[:, x, rise],
        E_1=phi[:, x, rise].copy(),
        area_x=phi[:, 0, x],
        area_delta=phi[:, 0, delta],
        area_r_0=phi[:, 0, rate] - phi[:, 0, rise],
        area_r_1=phi[:, 0, rise],
    )


def expm(M: FloatArray) -> FloatArray:
    """Matrix exponential of a stack, (n, k, k), by scaling, [13/13] Pade and squaring.

    Every matrix is scaled by its own norm, so that a result does not depend on what else is in the stack.
    """
    if M.shape[0] == 0:
        return M.copy()
    norm = np.abs(M).sum(axis=1).max(axis=1)
    squarings = np.maximum(np.ceil(np.log2(np.maximum(norm, 1e-300) / _PADE_RADIUS)), 0.0).astype(int)
    X = M / (2.0**squarings)[:, None, None]
    b = _PADE
    unit = np.eye(M.shape[-1])
    X2 = X @ X
    X4 = X2 @ X2
    X6 = X4 @ X2
    U = X @ (X6 @ (b[13] * X6 + b[11] * X4 + b[9] * X2) + b[7] * X6 + b[5] * X4 + b[3] * X2 + b[1] * unit)
    V = X6 @ (b[12] * X6 + b[10] * X4 + b[8] * X2) + b[6] * X6 + b[4] * X4 + b[2] * X2 + b[0] * unit
    result = np.linalg.solve(V - U, V + U)
    for done in range(int(squarings.max())):
        rows = squarings > done
        result[rows] = result[rows] @ result[rows]
    return result
