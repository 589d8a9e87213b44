"""A law as a linear system at straight, centred driving: exactly for linear laws, numerically for all others.

Inputs u = (e_y, de_y/dt, e_psi, de_psi/dt, delta_prev, r, wheel), where r is the lane's yaw rate in a bend of constant
curvature that goes on: every previewed yaw rate is r, every heading change r times its lookahead time. At each sample
delta = C s + D u and s+ = A s + B u.

A `SteeringLaw` is probed with small pulses, up and down, at the second sample of a run that is quiet otherwise: at its
first, a law takes what it sees for what has always been. Half the difference is its pulse response. The first answer
gives D. Where later ones are not zero the law has a memory, and A, B, C are the smallest system with that response
(J.-N. Juang, R. S. Pappa, *An eigensystem realization algorithm for modal parameter identification and model
reduction*, 1985). A law that gives its models (`SteeringLaw.linearised`) is checked with the same pulses.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Iterator
from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import BoolArray, FloatArray
from ldctoolkit.control import Controller, LinearLaw, Preview, RecordedPath, SteeringLaw
from ldctoolkit.errors import LdcError
from ldctoolkit.law_checks import check_law, check_step, raised
from ldctoolkit.plant_options import Actuator, Driver
from ldctoolkit.vehicle import Plant
from ldctoolkit.vehicle.discretization import AugmentedStep, augmented

ComplexArray = npt.NDArray[np.complex128]

_ENTRIES: Final = 4_000_000  # Numbers in a block of matrices: a long delay makes large ones


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
            for i in range(0, max(z.size, 1), block)
        ]
        return np.asarray(self.C @ np.concatenate(parts) + self.D)


@dataclasses.dataclass(frozen=True)
class Camera:
    """Delay and filter between the vehicle's state and the law."""

    delay: float  # [samples] Age of e_y and e_psi, which count as linear between samples; rates are true
    age: float  # [samples] Age of the wheel angle that the law and the filter see; linear between samples too
    gain: FloatArray | None  # (4, 2) Of the Kalman filter that rebuilds all four states; None for no filter
    step: AugmentedStep  # One sample of the filter's nominal vehicle and actuator, n = 1


def held_wheels(driver: Driver) -> tuple[tuple[str, System], ...]:
    """Arms at both ends of their range, from the actuator's angle to that of the wheels, in continuous time.

    Around the angle that the driver means, the assist active and below its limit. Where arms do not touch the wheel, or
    leave nothing to the assist, there is no such loop.
    """
    arms, zero, d = [], np.zeros((1, 1)), driver
    for end in () if d.ideal else d.grip if d.model == "grip" else d.stiffness:
        if d.model == "arms":
            J, b = d.wheel_inertia + d.inertia, d.wheel_damping + d.assist_damping + d.damping
            A = np.array([[0.0, 1.0], [-(d.assist_stiffness + end) / J, -b / J]])
            B, C = np.array([[0.0], [d.assist_stiffness / J]]), np.array([[1.0, 0.0]])
            arms.append((f"(k = {end:g} N m/rad)", System(A, B, C, zero)))
        elif 0.0 < end < 1.0:
            rate = np.array([[1.0 / (end * d.arm_lag)]])
            arms.append((f"(g = {end:g})", System(-rate, (1.0 - end) * rate, np.eye(1), zero)))
    names = ["arms"] if len(dict(arms)) < 2 else ["arms relaxed", "arms tensed"]
    return tuple((f"{name} {size}", system) for name, (size, system) in zip(names, arms, strict=False))


def sampled_vehicle(
    A: FloatArray, B: FloatArray, E: FloatArray, dt: float, actuator: Actuator, arms: System | None = None
) -> System:
    """Vehicle behind its actuator, sampled: inputs (command, lane yaw rate), outputs x and the wheel angle."""
    if arms is not None:
        k, E = len(arms.A), np.append(E, np.zeros(len(arms.A)))
        A = np.block([[A, np.outer(B, arms.C[0])], [np.zeros((k, 4)), arms.A]])
        B = np.append(np.zeros(4), arms.B[:, 0])
    step = augmented(A[None], B[None], E[None], dt, lag=actuator.lag, delay=actuator.delay)
    if actuator.lag == 0 and arms is None:  # the wheel stands where the last command that arrived has put it
        young, old, E_0, E_1 = (np.pad(w, ((0, 0), (0, 1))) for w in (step.B, step.B_old, step.E_0, step.E_1))
        young[:, 4] = 1.0
        inside = np.pad(step.A, ((0, 0), (0, 1), (0, 1)))
        step = AugmentedStep(inside, young, old, E_0, E_1, step.whole, step.split)
    full, command, E_0, E_1 = (matrix[0] for matrix in step.with_commands())
    seen = np.eye(5, full.shape[0])
    if arms is not None:
        seen[4, 4 : 4 + len(arms.A)] = arms.C[0]
    return System(full, np.stack([command, E_0 + E_1], axis=1), seen, np.zeros((5, 2)))


def controller_side(law: LawModel, camera: Camera) -> System:
    """Camera, filter and law with its earlier commands: inputs (x, wheel angle, lane yaw rate), output the command."""
    d, a = (math.ceil(age - 1e-9) for age in (camera.delay, camera.age))
    n_filter, n_law, step = 4 if camera.gain is not None else 0, law.A.shape[0], camera.step
    at_wheel, at_filter = 2 * d, 2 * d + a
    at_law, last = at_filter + n_filter, at_filter + n_filter + n_law
    size = last + 1 + step.whole

    def signal(*terms: tuple[int, float]) -> FloatArray:
        """A signal as weights of the states, then of the inputs (x, wheel, r)."""
        row = np.zeros(size + 6)
        for state, weight in terms:
            row[state] += weight
        return row

    following = np.zeros((size, size + 6))

    def aged(now: FloatArray, first: int, whole: int, age: float) -> FloatArray:
        """Signals (w, size + 6) `age` samples ago, `whole` rounded up; earlier ones are states from `first` on."""
        width = now.shape[0]
        past = np.vstack([now, *(signal((first + j, 1.0)) for j in range(width * whole))])
        following[first : first + width * whole] = past[: width * whole]
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
    states = np.array([signal((at_law + i, 1.0)) for i in range(n_law)]).reshape(n_law, size + 6)
    delta = law.C @ states + law.D @ u
    commands = [delta, *(signal((last + i, 1.0)) for i in range(step.whole + 1))]

    if n_filter:
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
        """The loop of a vehicle and the controller side."""
        k, c = vehicle.A.shape[0], controller.A.shape[0]
        A = np.zeros((k + c, k + c))
        A[:k, :k], A[k:, k:] = vehicle.A, controller.A
        A[k:, :k] = controller.B[:, :5] @ vehicle.C
        B = np.concatenate([vehicle.B[:, 0], np.zeros(c)])
        delta = np.concatenate([controller.D[0, :5] @ vehicle.C, controller.C[0]])
        E = np.concatenate([vehicle.B[:, 1] + vehicle.B[:, 0] * controller.D[0, 5], controller.B[:, 5]])
        open_loop = System(A, B[:, None], -delta[None, :], np.zeros((1, 1)))
        return cls(open_loop, A + np.outer(B, delta), E)

    def steady(self) -> FloatArray:
        """Inputs of the law in a bend once it has settled, per lane yaw rate of 1 rad/s, (7,)."""
        k = self.closed_A.shape[0]
        settled = np.linalg.solve(np.eye(k) - self.closed_A, self.closed_E)
        return np.array([*settled[:4], settled[-1], 1.0, settled[-1]])  # the last state is an earlier command


@contextlib.contextmanager
def guarded(name: str, call: str) -> Iterator[None]:
    """Turn what a law raises into an `LdcError`; errors of the toolkit pass as they are."""
    try:
        yield
    except (LdcError, KeyboardInterrupt, GeneratorExit):
        raise
    except BaseException as error:  # a controller may be third-party code, and may call sys.exit
        raise LdcError(f"controller {name!r}", f"{call} raised {raised(error)}") from error


PULSE: Final = np.array([1e-3, 1e-3, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4])
"""Size of the pulses in m, m/s, rad, rad/s, rad, rad/s, rad: small enough for limits not to bind."""

LARGER: Final = 30.0  # A law is linear if its answers to pulses so many times larger are
_SAMPLES: Final = 17  # Samples of a pulse response
_MEMORY: Final = 1e-4  # Part of the first answer below which a later one is rounding
_ORDER: Final = 1e-3  # Part of the largest singular value below which another one is no state
_ANSWER: Final = 1e-4  # [rad] Largest answer of a law that gives its models to a small pulse
KINK: Final = 0.02  # Part of the largest answer that an answer to a small pulse may differ by from a linear law's


@dataclasses.dataclass(frozen=True)
class LawModel:
    """A law as a linear system at one speed."""

    A: FloatArray  # (k, k)
    B: FloatArray  # (k, 7)
    C: FloatArray  # (k,)
    D: FloatArray  # (7,)


@dataclasses.dataclass(frozen=True)
class LinearView:
    """A law at n speeds as linear systems, and the error of that."""

    models: tuple[LawModel, ...]  # n
    exact: bool  # The law is linear by its type
    quiet: BoolArray  # (n,) Its command at straight, centred driving is zero
    finite: BoolArray  # (n,) All its answers are numbers
    nonlinearity: FloatArray  # (n,) Largest relative difference between answers to small pulses and to `LARGER` ones
    unexplained: FloatArray  # (n,) Error of the model's pulse response, relative to the response's largest value
    kink: FloatArray  # (n,) Largest difference of an answer to a small pulse from the model's, relative to the largest

    @property
    def order(self) -> int:
        """Largest number of states of the law's memory."""
        return max(len(model.A) for model in self.models)


def linear_view(controller: Controller, plant: Plant, *, probe: bool = True) -> LinearView | None:
    """A design as linear systems at the plant's n speeds; None for one that leaves the recorded path alone.

    Without `probe` also for a law that neither is linear nor gives its models, and pulses only check its first answer.
    """
    law = _checked_law(controller, plant)
    if isinstance(law, RecordedPath):
        return None
    if isinstance(law, LinearLaw):
        return exact_view(law, plant)
    with guarded(controller.name, "linearised"):
        given = law.linearised()
    if given is None and not probe:
        return None
    models = None if given is None else tuple(LawModel(*model) for model in given)
    return _probed(controller, plant, models, _SAMPLES if probe else 1)


def _checked_law(controller: Controller, plant: Plant) -> LinearLaw | SteeringLaw | RecordedPath:
    with guarded(controller.name, "prepare"):
        law = controller.prepare(plant)
    with guarded(controller.name, "preview_times"):
        return check_law(law, plant.n, controller.name)


def exact_view(law: LinearLaw, plant: Plant) -> LinearView:
    """A linear law as linear systems at the plant's n speeds, without error."""
    n = plant.n
    bend = law.G_yaw_rate.sum(axis=1) + law.G_heading @ law.preview_times
    D = np.column_stack([law.F, law.f_u, bend, np.zeros(n) if law.f_wheel is None else law.f_wheel])
    f_i = np.zeros((n, 0)) if law.f_i is None or not law.f_i.any() else law.f_i[:, None]
    C = f_i if law.f_past is None else np.append(f_i, law.f_past, axis=1)
    # the integral, then earlier commands, each the one after it a sample later
    k, z = C.shape[1], f_i.shape[1]
    A, B = np.eye(k, k=-1), np.zeros((k, 7))
    A[:z, :z], A[z : z + 1, :z], B[:z, 0], B[z : z + 1, 4] = 1.0, 0.0, plant.dt, 1.0
    models = tuple(LawModel(A, B, C[i], D[i]) for i in range(n))
    finite = np.isfinite(D).all(axis=1) & np.isfinite(C).all(axis=1)
    return LinearView(models, True, np.ones(n, dtype=np.bool_), finite, *np.zeros((3, n)))


def _probed(controller: Controller, plant: Plant, given: tuple[LawModel, ...] | None, samples: int) -> LinearView:
    """The models that a law gives, or those of its pulse responses, and what the pulses say of them."""
    n = plant.n
    # one row a speed for each pulse: quiet, then (seven inputs) x (up, down) x (small, larger)
    signs = np.concatenate([np.eye(7), -np.eye(7)])
    pulses = np.concatenate([np.zeros((1, 7)), signs * PULSE, LARGER * signs * PULSE])
    size = np.ones(n)
    if given is not None:  # no limit that is far for smaller signals counts
        size = np.minimum(1.0, _ANSWER / np.maximum([np.abs(model.D * PULSE).max() for model in given], 1e-300))
    answers = pulse_answers(controller, plant, pulses[:, None] * size[:, None], samples)
    finite = np.isfinite(answers).all(axis=(0, 1))
    answers = np.where(finite, answers, 0.0)
    small, large = (0.5 * (answers[:, i : i + 7] - answers[:, i + 7 : i + 14]) / size for i in (1, 15))
    largest = np.maximum(np.abs(small).max(axis=(0, 1)), 1e-300)
    nonlinearity = np.abs(large / LARGER - small).max(axis=(0, 1)) / largest
    models = given or tuple(_with_memory(small[:, :, i]) for i in range(n))
    predicted = np.stack([_pulse_response(model, samples) for model in models], axis=2)
    up, down = ((answers[0, i : i + 7] - answers[0, 0]) / size for i in (1, 8))
    return LinearView(
        models=models,
        exact=False,
        quiet=np.asarray(np.abs(answers[:, 0]).max(axis=0) <= 1e-9),
        finite=np.asarray(finite, dtype=np.bool_),
        nonlinearity=np.asarray(nonlinearity, dtype=np.float64),
        unexplained=np.asarray(np.abs(predicted - small).max(axis=(0, 1)) / largest),
        kink=np.maximum(np.abs(up - predicted[0]), np.abs(down + predicted[0])).max(axis=0) / largest,
    )


def _pulse_response(model: LawModel, samples: int) -> FloatArray:
    """Commands (samples, 7) of a model after pulses of the size `PULSE`."""
    response, state = [model.D * PULSE], model.B * PULSE
    for _ in range(samples - 1):
        response.append(model.C @ state)
        state = model.A @ state
    return np.array(response)


def pulse_answers(controller: Controller, plant: Plant, inputs: FloatArray, samples: int) -> FloatArray:
    """Commands (samples, q, n) of a `SteeringLaw`: of a sample with inputs (q, n, 7), and of later ones with zeros."""
    q, n, name = inputs.shape[0], plant.n, controller.name
    law = _checked_law(controller, plant.at(np.tile(plant.v, q)))
    if not isinstance(law, SteeringLaw):
        raise LdcError(f"controller {name!r}", "prepare gives laws of different kinds for other speeds")
    pulse = inputs.reshape(q * n, 7)
    with guarded(name, "preview_times"):
        times = np.asarray(law.preview_times, dtype=np.float64)
    with guarded(name, "init"):
        state = law.init(q * n)
    answers = np.zeros((samples + 1, q, n))
    for k in range(samples + 1):  # the first is quiet
        u = pulse.copy() if k == 1 else np.zeros_like(pulse)
        preview = Preview(np.tile(u[:, 5:6], (1, times.size)), u[:, 5:6] * times, u[:, 6])
        with guarded(name, "step"):
            result = law.step(np.full(q * n, k * plant.dt), u[:, :4].copy(), preview, u[:, 4].copy(), state)
        delta, state, _ = check_step(result, q * n, name)
        answers[k] = delta.reshape(q, n)
    return answers[1:]


def _with_memory(response: FloatArray) -> LawModel:
    """The smallest system with a pulse response (samples, 7) to pulses of the size `PULSE`."""
    D, later = response[0] / PULSE, response[1:]
    if not np.abs(later).max() > _MEMORY * np.abs(response).max():
        return LawModel(np.zeros((0, 0)), np.zeros((0, 7)), np.zeros(0), D)
    half = later.shape[0] // 2
    hankel = np.array([later[i : i + half].ravel() for i in range(half)])
    shifted = np.array([later[i + 1 : i + 1 + half].ravel() for i in range(half)])
    U, s, Vt = np.linalg.svd(hankel, full_matrices=False)
    k = int((s > _ORDER * s[0]).sum())
    root = np.sqrt(s[:k])
    A = (U[:, :k] / root).T @ shifted @ (Vt[:k] / root[:, None]).T
    return LawModel(A, root[:, None] * Vt[:k, :7] / PULSE, U[0, :k] * root, D)
