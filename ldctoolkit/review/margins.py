"""Poles, stability margins and bandwidth of a sampled loop, from python-control."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray
from ldctoolkit.review.sampled_loop import Loop, System

_STABLE: Final = 1.0 - 1e-6
"""Largest |z| of a pole that counts as stable: the vehicle's two integrators come out as 1 only to 1e-8."""

_RINGING: Final = 0.5
"""Smallest |z| of a pole whose damping is looked at: faster ones are gone within two samples."""

_FREQUENCIES: Final = 1000
_LOWEST: Final = 1e-3  # [rad/s]
_BEYOND: Final = 100.0  # Nyquist frequencies up to which the bandwidth is looked for


@dataclasses.dataclass(frozen=True)
class Poles:
    """The closed loop's poles in short."""

    stable: bool  # All decay
    radius: float  # Largest |z|
    damping: float  # Smallest damping ratio
    slowest: float  # [s] Longest time constant


def poles(closed_A: FloatArray, dt: float) -> Poles:
    """Poles of s+ = A s, as the continuous ones that they sample."""
    import control

    k = closed_A.shape[0]
    z = control.ss(closed_A, np.zeros((k, 1)), np.zeros((1, k)), 0.0, dt).poles()
    radius = float(np.abs(z).max())
    s = np.log(z[np.abs(z) >= _RINGING].astype(complex)) / dt
    s = s[np.abs(s) > 0.0]
    damping = float((-s.real / np.abs(s)).min(initial=1.0))
    slowest = -dt / math.log(radius) if 0.0 < radius < 1.0 else (math.inf if radius else 0.0)
    return Poles(radius <= _STABLE, radius, damping, round(slowest, 12))


@dataclasses.dataclass(frozen=True)
class Margins:
    """Stability margins of a loop, infinite where nothing of that kind makes it unstable."""

    gain: float  # [dB] How much the gain may grow
    gain_reduction: float  # [dB] How much it may shrink, > 0
    phase: float  # [rad]
    delay: float  # [s] How much later the command may come
    disk: float  # Balanced disk margin
    crossover: float  # [rad/s] Highest frequency at which the sampled loop's gain is 1; NaN where there is none


def margins(opened: System, dt: float) -> Margins:
    """Margins of a stable loop with negative feedback.

    Parameters
    ----------
    opened : System
        L, one input, one output.
    dt : float [s]

    Returns
    -------
    Margins

    Notes
    -----
    L is evaluated from 0.001 rad/s to the Nyquist frequency. `control.stability_margins` finds the crossovers there;
    its way through polynomials loses its digits to the double integrator and to a delay's many states. L is real at the
    Nyquist frequency, which that routine cannot see as a crossing; it is added here.
    """
    import control

    nyquist = math.pi / dt
    omega = np.geomspace(min(_LOWEST, 1e-3 * nyquist), nyquist, _FREQUENCIES)
    L = opened.response(np.exp(1j * omega * dt))[:, 0, 0]
    if not np.abs(L).max() > 1e-12:
        return Margins(math.inf, math.inf, math.inf, math.inf, 2.0, math.nan)
    factors, phases, _, _, crossovers, _ = control.stability_margins(control.FRD(L, omega, smooth=True), returnall=True)
    factors = np.append(factors, 1.0 / abs(L[-1])) if L[-1].real < 0 else factors
    factors = 20.0 * np.log10(factors[np.isfinite(factors) & (factors > 0)])
    phases = np.radians(phases)
    system = control.ss(opened.A, opened.B, opened.C, opened.D, dt)
    disk = control.disk_margins(system, omega[:: _FREQUENCIES // 250], skew=0.0)[0]
    return Margins(
        gain=float(factors[factors > 0].min(initial=math.inf)),
        gain_reduction=float((-factors[factors <= 0]).min(initial=math.inf)),
        phase=float(np.abs(phases).min(initial=math.inf)),
        delay=float((np.mod(phases, 2.0 * math.pi) / crossovers).min(initial=math.inf)),
        disk=float(disk),
        crossover=float(crossovers.max()) if crossovers.size else math.nan,
    )


def bandwidth(A: FloatArray, B: FloatArray, lag: float, controller: System, dt: float) -> float:
    """Highest frequency at which the loop's gain is 1 before it is sampled [rad/s]; 0 where it is below 1 throughout.

    Parameters
    ----------
    A : (4, 4)
    B : (4,)
        Continuous-time matrices of the vehicle.
    lag : float [s]
        Of the actuator.
    controller : System
        The law's side.
    dt : float [s]

    Returns
    -------
    float
        Sampling folds a loop back below the Nyquist frequency, so that its own crossover cannot tell that it is
        sampled too slowly. The gain of the vehicle in continuous time can, with the law's own at that frequency,
        or at Nyquist's beyond it.
    """
    nyquist = math.pi / dt
    omega = np.geomspace(min(_LOWEST, 1e-3 * nyquist), _BEYOND * nyquist, 2 * _FREQUENCIES)
    own = np.minimum(omega, nyquist)  # beyond, a sampled law only repeats itself
    x = np.linalg.solve(1j * omega[:, None, None] * np.eye(4) - A, np.asarray(B, dtype=complex)[None, :, None])[..., 0]
    K = controller.response(np.exp(1j * own * dt))[:, 0, :5]
    gain = np.abs(np.einsum("mi,mi->m", K[:, :4], x) + K[:, 4]) / np.abs(1.0 + 1j * omega * lag)
    above = np.flatnonzero(gain >= 1.0)
    if not above.size:
        return 0.0
    i = int(above[-1])
    if i + 1 == omega.size:
        return float(omega[-1])
    # straight in logarithms between two points that lie 0.6 % apart
    low, high = math.log(gain[i]), math.log(max(gain[i + 1], 1e-300))
    return float(omega[i] * (omega[i + 1] / omega[i]) ** (low / (low - high)))


_GRID: Final = 300
"""Frequencies of `quick_margins`: its margins are those of `margins` to one per cent."""


def quick_margins(loops: Sequence[Loop], dt: float) -> tuple[FloatArray, FloatArray]:
    """Gain and phase margin of loops of one size, as `margins` has them, in a hundredth of the time."""
    closed = np.stack([loop.closed_A for loop in loops])
    stable = np.asarray(np.isfinite(closed).all(axis=(1, 2)))
    stable[stable] = np.abs(np.linalg.eigvals(closed[stable])).max(axis=1) <= _STABLE
    gain, phase = np.zeros(len(loops)), np.zeros(len(loops))
    if not stable.any():
        return gain, phase
    nyquist = math.pi / dt
    omega = np.geomspace(1e-3 * nyquist, nyquist, _GRID)
    A, B, C = (np.stack([getattr(loop.open, name) for loop in loops])[stable] for name in ("A", "B", "C"))
    inside = np.exp(1j * omega * dt)[None, :, None, None] * np.eye(A.shape[-1]) - A[:, None]
    states = np.linalg.solve(inside, np.broadcast_to(B[:, None] + 0j, (*inside.shape[:2], *B.shape[1:])))
    L = (C[:, None] @ states)[..., 0, 0]
    gain[stable], phase[stable] = _gain_margin(L), _phase_margin(L)
    return gain, phase


def _gain_margin(L: npt.NDArray[np.complex128]) -> FloatArray:
    """Where L (s, m) crosses the negative real axis."""
    im, re = L.imag, L.real
    crossing = (im[:, :-1] * im[:, 1:] < 0) & (re[:, :-1] + re[:, 1:] < 0)
    part = np.divide(im[:, :-1], im[:, :-1] - im[:, 1:], out=np.zeros_like(im[:, 1:]), where=crossing)
    at = np.where(crossing, -(re[:, :-1] + part * (re[:, 1:] - re[:, :-1])), 0.0)
    at = np.column_stack([at, -re[:, -1:]])  # L is real at the Nyquist frequency
    factors = np.divide(1.0, at, out=np.full_like(at, np.inf), where=at > 0)
    return np.asarray(np.where(factors > 1.0, factors, np.inf).min(axis=1))


def _phase_margin(L: npt.NDArray[np.complex128]) -> FloatArray:
    """Where the gain of L (s, m) is 1."""
    size, angle = np.log(np.maximum(np.abs(L), 1e-300)), np.unwrap(np.angle(-L), axis=1)
    crossing = size[:, :-1] * size[:, 1:] < 0
    part = np.divide(size[:, :-1], size[:, :-1] - size[:, 1:], out=np.zeros_like(size[:, 1:]), where=crossing)
    at = np.abs(np.angle(np.exp(1j * (angle[:, :-1] + part * (angle[:, 1:] - angle[:, :-1])))))
    return np.asarray(np.where(crossing, at, np.inf).min(axis=1))
