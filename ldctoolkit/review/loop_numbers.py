"""Numbers of the linear loop over a range of speeds: poles, margins, bandwidth, conditioning, offset in a bend."""

import contextlib
import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import BoolArray, FloatArray
from ldctoolkit.control import Controller
from ldctoolkit.errors import LdcError
from ldctoolkit.plant_options import PlantOptions
from ldctoolkit.review.law_model import (
    KINK,
    Camera,
    ComplexArray,
    LinearView,
    Loop,
    System,
    controller_side,
    linear_view,
    pulse_answers,
    sampled_vehicle,
)
from ldctoolkit.setup import Setup
from ldctoolkit.vehicle import BicycleModel, Plant

_STABLE: Final = 1.0 - 1e-6  # Largest |z| of a stable pole: the vehicle's two integrators come out as 1 only to 1e-8
_RINGING: Final = 0.5  # Smallest |z| of a pole whose damping counts: faster ones have decayed within two samples

_FREQUENCIES: Final = 1000
_LOWEST: Final = 1e-3  # [rad/s]
_BEYOND: Final = 100.0  # Nyquist frequencies up to which the bandwidth is searched


class Poles(NamedTuple):
    """Summary of the closed loop's poles."""

    stable: bool  # All decay
    radius: float  # Largest |z|
    damping: float  # Smallest damping ratio
    slowest: float  # [s] Longest time constant


def poles(closed_A: FloatArray, dt: float) -> Poles:
    """Poles of s+ = A s, as the continuous ones that they sample."""
    z = np.linalg.eigvals(closed_A)
    radius = float(np.abs(z).max())
    s = np.log(z[np.abs(z) >= _RINGING].astype(complex)) / dt
    s = s[np.abs(s) > 0.0]
    damping = float((-s.real / np.abs(s)).min(initial=1.0))
    slowest = -dt / math.log(radius) if 0.0 < radius < 1.0 else (math.inf if radius else 0.0)
    return Poles(radius <= _STABLE, radius, damping, round(slowest, 12))


class Margins(NamedTuple):
    """Stability margins of a loop, infinite where nothing of that kind makes it unstable."""

    gain: float  # [dB] How much the gain may grow
    gain_reduction: float  # [dB] How much it may shrink, > 0
    phase: float  # [rad]
    delay: float  # [s] How much later the command may come
    disk: float  # Balanced disk margin
    crossover: float  # [rad/s] Highest frequency at which the sampled loop's gain is 1; NaN where there is none


def margins(open_loop: System, dt: float) -> Margins:
    """Margins of a stable loop with negative feedback.

    L is evaluated from 0.001 rad/s to the Nyquist frequency, where it is real, and between points of that grid where it
    crosses the unit circle or the negative real axis. The disk margin is the minimum of 2 |1 + L|/|1 - L|.
    """
    from scipy.optimize.elementwise import find_minimum, find_root

    def loop(w: FloatArray) -> ComplexArray:
        return np.asarray(open_loop.response(np.exp(1j * w * dt))[:, 0, 0])

    def crossings(of: Callable[[ComplexArray], FloatArray]) -> tuple[FloatArray, ComplexArray]:
        """Frequencies at which a function of L changes its sign, and L there."""
        i = np.flatnonzero(np.diff(np.sign(of(L))))
        w = find_root(lambda w: of(loop(w)), (omega[i], omega[i + 1])).x if i.size else np.zeros(0)
        w = w[np.isfinite(w)]  # a change of sign that is rounding has no root
        return w, loop(w)

    def disk(L: ComplexArray) -> FloatArray:
        return np.asarray(2.0 * np.abs(1.0 + L) / np.abs(1.0 - L))

    nyquist = math.pi / dt
    omega = np.geomspace(min(_LOWEST, 1e-3 * nyquist), nyquist, _FREQUENCIES)
    L = loop(omega)
    if not np.abs(L).max() > 1e-12:
        return Margins(math.inf, math.inf, math.inf, math.inf, 2.0, math.nan)
    L[-1] = L[-1].real
    real = np.append(crossings(np.imag)[1].real, L[-1].real)
    factors = -20.0 * np.log10(-real[real < 0.0])
    w_c, at = crossings(lambda L: np.abs(L) - 1.0)
    phases = np.angle(-at)
    i = min(max(int(disk(L).argmin()), 1), L.size - 2)
    lowest = find_minimum(lambda w: disk(loop(w)), tuple(omega[i - 1 : i + 2, None])).f_x[0]
    return Margins(
        gain=float(factors[factors > 0].min(initial=math.inf)),
        gain_reduction=float((-factors[factors <= 0]).min(initial=math.inf)),
        phase=float(np.abs(phases).min(initial=math.inf)),
        delay=float((np.mod(phases, 2.0 * math.pi) / w_c).min(initial=math.inf)),
        disk=float(np.fmin(lowest, disk(L).min())),
        crossover=float(w_c.max()) if w_c.size else math.nan,
    )


def bandwidth(
    A: FloatArray, B: FloatArray, lag: float, controller: System, dt: float, arms: System | None = None
) -> float:
    """Highest frequency [rad/s] at which the loop's gain is 1 before it is sampled; 0 where it is below 1."""
    nyquist = math.pi / dt
    omega = np.geomspace(min(_LOWEST, 1e-3 * nyquist), _BEYOND * nyquist, 2 * _FREQUENCIES)
    x = np.linalg.solve(1j * omega[:, None, None] * np.eye(4) - A, np.asarray(B, dtype=complex)[None, :, None])[..., 0]
    # beyond the Nyquist frequency a sampled law repeats itself
    below, place = np.unique(np.minimum(omega, nyquist), return_inverse=True)
    K = controller.response(np.exp(1j * below * dt))[place, 0, :5]
    gain = np.abs(np.einsum("mi,mi->m", K[:, :4], x) + K[:, 4]) / np.abs(1.0 + 1j * omega * lag)
    gain *= 1.0 if arms is None else np.abs(arms.response(np.asarray(1j * omega, dtype=np.complex128))[:, 0, 0])
    above = np.flatnonzero(gain >= 1.0)
    if not above.size:
        return 0.0
    i = int(above[-1])
    if i + 1 == omega.size:
        return float(omega[-1])
    # straight in logarithms between two points that lie 0.6 % apart
    low, high = math.log(gain[i]), math.log(max(gain[i + 1], 1e-300))
    return float(omega[i] * (omega[i + 1] / omega[i]) ** (low / (low - high)))


_GRID: Final = 300  # Frequencies of `quick_margins`: enough for one per cent


def quick_margins(loops: Sequence[Loop], dt: float) -> tuple[FloatArray, FloatArray]:
    """Gain and phase margin of loops of one size: those of `margins` to one per cent, in a hundredth of the time."""
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
    # where the gain of L (s, m) is 1
    size, angle = np.log(np.maximum(np.abs(L), 1e-300)), np.unwrap(np.angle(-L), axis=1)
    crossing = size[:, :-1] * size[:, 1:] < 0
    part = np.divide(size[:, :-1], size[:, :-1] - size[:, 1:], out=np.zeros_like(size[:, 1:]), where=crossing)
    at = np.abs(np.angle(np.exp(1j * (angle[:, :-1] + part * (angle[:, 1:] - angle[:, :-1])))))
    phase[stable] = np.where(crossing, at, np.inf).min(axis=1)
    # where L crosses the negative real axis
    im, re = L.imag, L.real
    crossing = (im[:, :-1] * im[:, 1:] < 0) & (re[:, :-1] + re[:, 1:] < 0)
    part = np.divide(im[:, :-1], im[:, :-1] - im[:, 1:], out=np.zeros_like(im[:, 1:]), where=crossing)
    at = np.where(crossing, -(re[:, :-1] + part * (re[:, 1:] - re[:, :-1])), 0.0)
    at = np.column_stack([at, -re[:, -1:]])  # L is real at the Nyquist frequency
    factors = np.divide(1.0, at, out=np.full_like(at, np.inf), where=at > 0)
    gain[stable] = np.where(factors > 1.0, factors, np.inf).min(axis=1)
    return gain, phase


_WEIGHTS = ("q_y", "q_y_rate", "q_psi", "q_psi_rate")


def hessian_condition(controller: Controller, plant: Plant) -> FloatArray:
    """Condition number at each of n speeds, (n,); NaN for a design that is no MPC."""
    declared = {g.name for g in controller.gains()}
    if not declared >= {"horizon", "r_delta", "delta_max", *_WEIGHTS}:
        return np.full(plant.n, np.nan)
    Q = np.diag([float(getattr(controller, name)) for name in _WEIGHTS])
    horizon, r = int(getattr(controller, "horizon")), float(getattr(controller, "r_delta"))  # noqa: B009
    return np.array([_condition(plant.step.A[i], plant.step.B[i], Q, r, horizon) for i in range(plant.n)])


def _condition(A: FloatArray, B: FloatArray, Q: FloatArray, r: float, horizon: int) -> float:
    """Condition number of the condensed Hessian of an MPC with these weights."""
    import control

    try:
        _, P, _ = control.dlqr(A, B[:, None], Q, np.array([[r]]))
    except (np.linalg.LinAlgError, control.ControlArgument, ValueError) as error:
        raise LdcError("condensed Hessian", f"no terminal cost: {error}") from error
    columns = [B]
    for _ in range(horizon - 1):
        columns.append(A @ columns[-1])
    impulse = np.array(columns)  # x_(k+1) after a unit command at sample 0
    Gamma = np.zeros((horizon, 4, horizon))
    for j in range(horizon):
        Gamma[j:, :, j] = impulse[: horizon - j]
    weighted = Gamma.copy()
    weighted[:-1] = np.einsum("ij,kjm->kim", Q, Gamma[:-1])
    weighted[-1] = P @ Gamma[-1]
    H = np.einsum("kia,kib->ab", Gamma, weighted) + r * np.eye(horizon)
    return float(np.linalg.cond(0.5 * (H + H.T)))


BEND_ERROR: Final = 0.05  # Largest relative error of the linearisation in a bend up to which its offset counts
MISMATCH: Final = 0.2  # Relative error of the cornering stiffness of each axle, up and down


@dataclasses.dataclass(frozen=True)
class LoopNumbers:
    """Numbers of the linear loop at n speeds; margins and bends are NaN where the closed loop is unstable."""

    v: FloatArray  # (n,) [m/s]
    bend: FloatArray  # (n,) [rad/s] Lane yaw rate of the steady bend
    stable: BoolArray  # (n,)
    radius: FloatArray  # (n,) Largest |z| of the closed loop's poles
    damping: FloatArray  # (n,) Smallest damping ratio
    slowest: FloatArray  # (n,) [s] Longest time constant
    gain_margin: FloatArray  # (n,) [dB] Factor by which the gain may grow
    gain_reduction_margin: FloatArray  # (n,) [dB] Factor by which the gain may shrink
    phase_margin: FloatArray  # (n,) [rad]
    delay_margin: FloatArray  # (n,) [s]
    disk_margin: FloatArray  # (n,)
    crossover: FloatArray  # (n,) [rad/s] Highest frequency at which the sampled loop's gain is 1
    bandwidth: FloatArray  # (n,) [rad/s] The same before sampling
    e_y_bend: FloatArray  # (n,) [m] Steady e_y in a bend, on the nominal vehicle
    # (n,) [m] The same with other cornering stiffness, the worst of the four corners; infinite where one is unstable
    e_y_bend_mismatched: FloatArray
    # (n,) Of a law without memory, how far its command in the steady bend is from that of its linearisation, relative
    # to the latter's largest term; 0 for linear laws. Above `BEND_ERROR` there is no offset in a bend: it is NaN.
    bend_error: FloatArray
    hessian_condition: FloatArray  # (n,) Condition number of the condensed Hessian; NaN for a law that is no MPC


def loop_numbers(
    controller: Controller, view: LinearView, plant: Plant, options: PlantOptions, bend: FloatArray,
    arms: System | None = None,
) -> LoopNumbers:  # fmt: skip
    """The numbers of the loop at every speed of a plant; behind `arms` without those of bends and the Hessian."""
    dt, actuator = plant.dt, options.actuator
    A, B, E = plant.model.matrices(plant.v)
    cameras = _cameras(plant, options)
    p = plant.model.parameters
    low, high = 1.0 - MISMATCH, 1.0 + MISMATCH
    tyres = [dataclasses.replace(p, C_af=p.C_af * f, C_ar=p.C_ar * r) for f in (low, high) for r in (low, high)]
    mismatched = [BicycleModel(parameters, plant.model.convention).matrices(plant.v) for parameters in tyres]
    rows = []
    inputs = np.zeros((2, plant.n, 7))  # in the bend: of the nominal vehicle, of the worst other one
    for i, law in enumerate(view.models):
        side = controller_side(law, cameras[i])
        loop = Loop.of(sampled_vehicle(A[i], B[i], E[i], dt, actuator, arms), side)
        z, m, offsets = poles(loop.closed_A, dt), Margins(*[math.nan] * 6), [math.nan] * 2
        if z.stable:
            m = margins(loop.open, dt)
        if z.stable and arms is None:
            worst = _worst([(a[i], b[i], e[i]) for a, b, e in mismatched], side, dt, options)
            inputs[0, i] = loop.steady() * bend[i]
            inputs[1, i] = 0.0 if worst is None else worst * bend[i]
            offsets = [inputs[0, i, 0], math.inf if worst is None else inputs[1, i, 0]]
        rows.append([*z, *m, bandwidth(A[i], B[i], actuator.lag, side, dt, arms), *offsets])
    stable, *columns = np.array(rows, dtype=float).T
    if arms is not None:
        return LoopNumbers(plant.v.copy(), bend, stable.astype(bool), *columns, *np.full((2, plant.n), math.nan))
    errors = _errors(controller, view, plant, inputs)
    for column, error in zip(columns[-2:], errors, strict=True):
        column[(error > BEND_ERROR) & np.isfinite(column)] = math.nan
    columns += [errors.max(axis=0), hessian_condition(controller, plant)]
    return LoopNumbers(plant.v.copy(), bend, stable.astype(bool), *columns)


def _worst(
    vehicles: list[tuple[FloatArray, FloatArray, FloatArray]], side: System, dt: float, options: PlantOptions
) -> FloatArray | None:
    """What the law sees per lane yaw rate where the steady offset is largest; None if one vehicle is unstable."""
    seen = []
    for A, B, E in vehicles:
        loop = Loop.of(sampled_vehicle(A, B, E, dt, options.actuator), side)
        if not poles(loop.closed_A, dt).stable:
            return None
        seen.append(loop.steady())
    return max(seen, key=lambda u: abs(float(u[0])))


def _errors(controller: Controller, view: LinearView, plant: Plant, inputs: FloatArray) -> FloatArray:
    """Relative errors (q, n) of a law's linear commands at inputs (q, n, 7); 0 where it has a memory."""
    without = np.array([not model.A.size for model in view.models])
    if view.exact or not without.any():
        return np.zeros(inputs.shape[:2])
    terms = inputs * np.array([model.D for model in view.models])
    error = np.abs(pulse_answers(controller, plant, inputs, 1)[0] - terms.sum(axis=2))
    error = np.where(np.isnan(error), math.inf, error)
    return np.where(without, error / np.maximum(np.abs(terms).max(axis=2), 1e-9), 0.0)


def _cameras(plant: Plant, options: PlantOptions) -> list[Camera]:
    """The camera at each speed, its frames as old as they are on average; its filter knows what the law knows."""
    sensors, gains = options.sensors, [None] * plant.n
    if sensors.kalman is not None:
        from ldctoolkit.vehicle.kalman_filter import filter_gain

        gains = list(filter_gain(plant, sensors.kalman, 1))
    held, matrices = sensors.age(plant.dt, held=True), ("A", "B", "B_old", "E_0", "E_1")
    steps = [
        dataclasses.replace(plant.augmented, **{name: getattr(plant.augmented, name)[i : i + 1] for name in matrices})
        for i in range(plant.n)
    ]
    return [Camera(held / plant.dt, plant.age / plant.dt, *both) for both in zip(gains, steps, strict=True)]


def design_margins(controllers: Sequence[Controller], setup: Setup, v: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Gain and phase margin over speed of many designs on one plant.

    Parameters
    ----------
    controllers : sequence of Controller
        d designs.
    setup : Setup
        Vehicle, plant options, clock, and what the designs know of the plant.
    v : (k,) [m/s]

    Returns
    -------
    gain : (d, k)
        Factor by which the gain may grow; 0 where the loop is unstable. NaN for a law that neither is linear nor gives
        its linear part at straight driving, has a kink there, leaves the recorded path alone, or raises.
    phase : (d, k) [rad]
        The same.

    Examples
    --------
    >>> from ldctoolkit import LQR, Setup
    >>> gain, phase = design_margins([LQR(r_delta=1000.0)], Setup(), [20.0])
    >>> gain.round(1), np.degrees(phase).round()
    (array([[14.3]]), array([[61.]]))
    """
    plant, options = setup.plant(np.asarray(v, dtype=np.float64)), setup.options
    matrices = zip(*plant.model.matrices(plant.v), strict=True)
    vehicles = [sampled_vehicle(A, B, E, plant.dt, options.actuator) for A, B, E in matrices]
    cameras = _cameras(plant, options)
    gain, phase = np.full((2, len(controllers), plant.n), np.nan)
    for row, controller in enumerate(controllers):
        with contextlib.suppress(Exception):  # a controller may be third-party code; to run it shows what is wrong
            view = linear_view(controller, plant, probe=False)
            if view is not None and (view.kink <= KINK).all():
                sides = map(controller_side, view.models, cameras)
                gain[row], phase[row] = quick_margins(list(map(Loop.of, vehicles, sides)), plant.dt)
    return gain, phase
