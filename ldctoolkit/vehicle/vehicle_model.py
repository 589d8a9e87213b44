"""A vehicle of the designer's: states and derivatives that are driven in place of the single track.

Actuator, camera, filter, trigger and scores around it are the toolkit's; laws are designed on the single track of the
setup's `VehicleParameters`, which `VehicleModel.single_track` fits. A model in CasADi is compiled with its Runge-Kutta
step; a model in NumPy works on arrays over scenarios; a simulator advances its own state.
"""

from __future__ import annotations

import abc
import dataclasses
import functools
import hashlib
import pickle
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Final

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.casadi_code import Names, called, checked_expression, compiled
from ldctoolkit.code_content import content_of, modules_of, pickled_by_value
from ldctoolkit.errors import CheckedArguments, InputError, UnknownNameError, expect
from ldctoolkit.vehicle.bicycle import VehicleParameters, checked_speeds, error_dynamics_matrices

ERROR_STATES: Final = ("e_y", "e_y_rate", "e_psi", "e_psi_rate")
POINT: Final = ("v", "v_rate", "yaw_rate", "delta")
"""Numbers of a moment: speed and its rate, the lane's yaw rate, angle of the wheels."""

_FREQUENCIES: Final = 2.0 * np.pi * np.array([1e-3, 0.5, 1.0, 1.5, 2.0])  # [rad/s] of the fitted steering response
SHORTEST: Final = 1e-5  # [s] of steps
TOGETHER: Final = 32  # Scenarios that one call of compiled code advances


@dataclasses.dataclass(frozen=True)
class RecordedTurn:
    """m recorded paths at the moments when they are taken over, arrays (m,)."""

    e_y: FloatArray  # [m]
    e_y_rate: FloatArray  # [m/s]
    e_y_acceleration: FloatArray  # [m/s^2]
    e_psi_rate: FloatArray  # [rad/s]
    v: FloatArray  # [m/s]
    v_rate: FloatArray  # [m/s^2]
    yaw_rate: FloatArray  # [rad/s] Of the lane
    # [rad] Of the single track's steady turn, from which a search may start
    e_psi: FloatArray
    delta: FloatArray

    def take(self, rows: IntArray | BoolArray) -> RecordedTurn:
        """Only some of them."""
        return RecordedTurn(*(getattr(self, field.name)[rows] for field in dataclasses.fields(self)))


@dataclasses.dataclass(frozen=True)
class VehicleModel(CheckedArguments, abc.ABC):
    """A vehicle of the designer's: a frozen dataclass with `derivatives`, or with `advance`.

    Lengths in m, angles in rad, s. Departures to the right are driven mirrored: positive is towards the line that is
    crossed. The speed `v` is given, not a state. Fields are numbers, texts or tuples of them; with the class's code
    they identify a model. Raises `InputError` for a class or a field that is not as described here.

    Attributes
    ----------
    states : tuple of str
        Names of the states beyond e_y, e_y_rate, e_psi, e_psi_rate.
    symbolic : bool
        Whether `derivatives` and `a_y` take CasADi symbols, as by default; if not, arrays (n,).
    longest_step : float [s]
        Of the Runge-Kutta method and of `advance`. With `derivatives`, steps are at most a quarter of the fastest time
        constant at the start, too.

    Examples
    --------
    >>> import dataclasses
    >>> import ldctoolkit as ldc
    >>> @dataclasses.dataclass(frozen=True)
    ... class Kinematic(ldc.VehicleModel):
    ...     symbolic, states = False, ("yaw",)
    ...     wheelbase: float = 2.9
    ...     lag: float = 0.15
    ...
    ...     def derivatives(self, x, delta, v, v_rate, lane):
    ...         yaw = (v * delta / self.wheelbase - x.yaw) / self.lag
    ...         return {"yaw": yaw, "e_psi_rate": 20.0 * (x.yaw - self.yaw_rate(x, lane)),
    ...                 "e_y_rate": self.e_y_acceleration(x, v, v_rate, lane, v * x.yaw)}
    >>> outcome = ldc.simulate(ldc.LQR(), ldc.load_model("reference").sample(5, 5, seed=1), y_s=0.1,
    ...                        setup=ldc.Setup(vehicle_model=Kinematic()))
    >>> bool(outcome.mean_reduction > 0.0)
    True
    """

    states: ClassVar[tuple[str, ...]] = ()
    symbolic: ClassVar[bool] = True
    longest_step: ClassVar[float] = 0.03

    content: str = dataclasses.field(init=False, repr=False, default="")  # Of the class's code

    def __post_init__(self) -> None:
        name = type(self).__name__
        if not type(self).__dict__.get("__dataclass_params__", None) or not self.__dataclass_params__.frozen:  # type: ignore[attr-defined]
            raise InputError(name, "not a frozen dataclass", hint="write @dataclasses.dataclass(frozen=True) above it")
        if not (self.advances or type(self).derivatives is not VehicleModel.derivatives):
            raise InputError(name, "has neither derivatives nor advance", hint="define one of the two")
        if not (isinstance(self.states, tuple) and all(isinstance(s, str) and s.isidentifier() for s in self.states)):
            raise InputError(f"{name}.states", value=self.states, allowed="a tuple of names")
        if not (isinstance(self.longest_step, int | float) and SHORTEST <= self.longest_step <= 1.0):
            raise InputError(f"{name}.longest_step", value=self.longest_step, allowed=f"{SHORTEST:g} to 1 s")
        for state in self.states:
            if state in (*ERROR_STATES, "delta") or self.states.count(state) > 1:
                raise InputError(f"{name}.states", value=state, allowed=f"each once, and none of {ERROR_STATES}")
        for field in dataclasses.fields(self):
            if not _plain(value := getattr(self, field.name)):
                hint = "a table is a tuple of tuples, or a constant beside the class"
                raise InputError(f"{name}.{field.name}", value=value, allowed="numbers, texts, tuples", hint=hint)
        object.__setattr__(self, "content", self.code())

    def code(self) -> str:
        """What identifies the model beside its fields: the content of the class's code."""
        return content_of(type(self))

    @property
    def identity(self) -> str:
        """Sixteen hexadecimal digits of the class, its code and the fields."""
        values = [type(self).__qualname__, *(getattr(self, field.name) for field in dataclasses.fields(self))]
        return hashlib.sha256(repr(values).encode()).hexdigest()[:16]

    @property
    def advances(self) -> bool:
        """Whether the model advances its own states."""
        return type(self).advance is not VehicleModel.advance

    # ---------------------------------------------------------------------------------------- what a designer defines

    def derivatives(self, x: Any, delta: Any, v: Any, v_rate: Any, lane: Any) -> Mapping[str, Any]:
        """Time derivatives by name: of e_y_rate, of e_psi_rate, and of every one of `states`.

        Parameters
        ----------
        x : e_y [m], e_y_rate [m/s], e_psi [rad], e_psi_rate [rad/s], and `states`
            As attributes; CasADi symbols, or arrays (n,).
        delta : [rad]
            Angle of the front wheels.
        v, v_rate : [m/s], [m/s^2]
            Speed along the vehicle, and its rate.
        lane : yaw_rate [rad/s], curvature [1/m]
            Yaw rate of the lane where the vehicle is, v times curvature.
        """
        raise NotImplementedError

    def a_y(self, x: Any, delta: Any, v: Any, v_rate: Any, lane: Any) -> Any:
        """Lateral acceleration of the centre of gravity [m/s^2]; here, that which belongs to the rate of e_y_rate."""
        rate = self.derivatives(x, delta, v, v_rate, lane)["e_y_rate"]
        cos = _functions_of(v, x.e_psi).cos(x.e_psi)
        return (rate - self.e_y_acceleration(x, v, v_rate, lane, 0.0)) / cos

    def initial(self, turn: RecordedTurn) -> Mapping[str, Any]:
        """Where the m scenarios start, by name: e_psi, e_psi_rate, delta and `states`, arrays (m,).

        Here, the steady turn of the recorded path. A state that is far from 0 needs a first guess:
        ``return self.steady_turn(turn, omega=turn.v / self.R)``. A name that is left out is the single track's, or 0.
        """
        return {} if self.advances else self.steady_turn(turn)

    def begin(self, turn: RecordedTurn) -> Any:  # noqa: ARG002
        """What `advance` works on, made once a run: for instance an instance of a simulator for each of m scenarios.

        Parameters
        ----------
        turn : RecordedTurn
            With e_psi, e_psi_rate and delta as `initial` gave them.
        """
        return None

    def advance(self, memory: Any, rows: IntArray, x: Any, road: Any, h: FloatArray) -> Mapping[str, Any]:
        """States after a step, in place of `derivatives`: e_y, e_y_rate, e_psi, e_psi_rate and `states`, arrays (k,).

        Called for scenarios that go on, in order and in one thread; `error_state` makes the first four of v_y and yaw
        rate. A model that advances itself defines `a_y` too, for instance as one of its states.

        Parameters
        ----------
        memory : object
            What `begin` returned.
        rows : (k,) int
            Which of the m scenarios.
        x : e_y, e_y_rate, e_psi, e_psi_rate, and `states`
            States at the start of the step, arrays (k,).
        road : tuple of three
            The moments at the start, the middle and the end of the step, with arrays (k,) v [m/s], v_rate [m/s^2],
            yaw_rate [rad/s] and curvature [1/m] of the lane, delta [rad] of the wheels.
        h : (k,) [s]
            Length of the step, which may differ.
        """
        raise NotImplementedError

    # ------------------------------------------------------------------------------------------- what it is written in

    def v_y(self, x: Any, v: Any) -> Any:
        """Lateral velocity of the vehicle in its own frame [m/s]: de_y/dt = v sin e_psi + v_y cos e_psi."""
        wave = _functions_of(v, x.e_psi)
        return (x.e_y_rate - v * wave.sin(x.e_psi)) / wave.cos(x.e_psi)

    def yaw_rate(self, x: Any, lane: Any) -> Any:
        """Yaw rate of the vehicle [rad/s]."""
        return x.e_psi_rate + lane.yaw_rate

    def e_y_acceleration(self, x: Any, v: Any, v_rate: Any, lane: Any, a_y: Any) -> Any:
        """Rate of e_y_rate [m/s^2] that belongs to a lateral acceleration, the lateral forces over the mass [m/s^2]."""
        wave = _functions_of(v, x.e_psi)
        sin, cos = wave.sin(x.e_psi), wave.cos(x.e_psi)
        turning = x.e_psi_rate * (v * cos - self.v_y(x, v) * sin)
        return v_rate * sin + turning + (a_y - v * self.yaw_rate(x, lane)) * cos

    def error_state(self, x: Any, road: Any, h: Any, v_y: Any, yaw_rate: Any) -> dict[str, Any]:
        """The first four states after a step at whose end lateral velocity and yaw rate are these; for `advance`."""
        rate = yaw_rate - road[2].yaw_rate
        e_psi = x.e_psi + 0.5 * h * (x.e_psi_rate + rate)
        e_y_rate = road[2].v * np.sin(e_psi) + v_y * np.cos(e_psi)
        e_y = x.e_y + 0.5 * h * (x.e_y_rate + e_y_rate)
        return {"e_y": e_y, "e_y_rate": e_y_rate, "e_psi": e_psi, "e_psi_rate": rate}

    def steady_turn(self, turn: RecordedTurn, **guess: Any) -> dict[str, FloatArray]:
        """e_psi, delta and states at which the path has its lateral acceleration and nothing else changes, by Newton.

        Beyond its largest lateral acceleration, where there is none, e_psi and delta are the single track's.

        Parameters
        ----------
        turn : RecordedTurn
        **guess : number or (m,)
            First values of `states`, 0 by default, or of e_psi and delta.
        """
        eq, m = equations(self), turn.v.size
        names = ("e_psi", "delta", *self.states)
        if unknown := [name for name in guess if name not in names]:
            raise UnknownNameError(f"{eq.name}.steady_turn.{unknown[0]}", "no such state", allowed=names)
        first = {"e_psi": turn.e_psi, "delta": turn.delta} | dict.fromkeys(self.states, 0.0) | {**guess}
        z = np.column_stack([np.broadcast_to(np.asarray(first[name], dtype=float), m) for name in names])

        def missing(z: FloatArray, at: RecordedTurn) -> FloatArray:
            """Rates that should be 0: of e_y_rate beyond the path's, of e_psi_rate, of the states."""
            x = np.column_stack([at.e_y, at.e_y_rate, z[:, 0], at.e_psi_rate, z[:, 2:]])
            rates = eq.rates(x, np.column_stack([at.v, at.v_rate, at.yaw_rate, z[:, 1]]))
            return np.column_stack([rates[:, 1] - at.e_y_acceleration, rates[:, 3:]])

        start = z.copy()
        lost = ~_newton(functools.partial(missing, at=turn), z)
        if lost.any():  # no such turn: that of the single track, with states that do not change in it
            at, fixed = turn.take(lost), np.column_stack([turn.e_psi, turn.delta])[lost]
            z[lost, :2], own = fixed, start[lost, 2:]
            if own.size:
                settled = _newton(lambda own: missing(np.column_stack([fixed, own]), at)[:, 2:], own)
                z[lost, 2:] = np.where(settled[:, None], own, np.nan)
        return dict(zip(names, z.T.copy(), strict=True))

    def single_track(
        self, like: VehicleParameters, speeds: tuple[float, ...] = (15.0, 25.0, 35.0)
    ) -> VehicleParameters:
        """Parameters of the single track whose steering response is nearest to this vehicle's, to design laws on.

        Cornering stiffnesses and yaw inertia are fitted to the response from delta to yaw rate and lateral velocity,
        steady and up to 2 Hz; mass, axles and widths are kept.

        Parameters
        ----------
        like : VehicleParameters
            What is kept, and where the search starts.
        speeds : tuple of float [m/s]
        """
        from scipy.optimize import least_squares

        expect("like", like, VehicleParameters)
        eq, v = equations(self), checked_speeds(speeds)
        zero = np.zeros_like(v)
        if self.advances:
            raise InputError(eq.name, "advances itself", hint="single_track() takes a model with derivatives")
        x, delta = eq.start(RecordedTurn(zero, zero, zero, zero, v, zero, zero, zero, zero))
        slopes = eq.jacobian(x, np.column_stack([v, zero, zero, delta]))

        def response(A: FloatArray, B: FloatArray) -> FloatArray:
            """From the wheel angle to the yaw rate, and to the lateral acceleration, at every speed and frequency."""
            s = 1j * _FREQUENCIES[:, None, None, None]
            G = np.linalg.solve(s * np.eye(A.shape[-1]) - A, np.broadcast_to(B[..., None], (len(s), *B.shape, 1)))
            return np.stack([G[:, :, 3, 0], s[:, :, 0, 0] * G[:, :, 1, 0]])

        wanted = response(slopes[:, :, :-1], slopes[:, :, -1])

        def off(logarithms: FloatArray) -> FloatArray:
            A, B, _ = error_dynamics_matrices(fitted(logarithms), v, "consistent")
            error = ((response(A, B) - wanted) / np.abs(wanted)).ravel()
            return np.concatenate([error.real, error.imag])

        def fitted(logarithms: FloatArray) -> VehicleParameters:
            values = np.exp(logarithms).tolist()
            return dataclasses.replace(like, **dict(zip(("C_af", "C_ar", "I_z"), values, strict=True)))

        return fitted(least_squares(off, np.log([like.C_af, like.C_ar, like.I_z]), x_scale=0.1).x)

    def __deepcopy__(self, memory: Any) -> VehicleModel:
        return self

    def __reduce__(self) -> tuple[Any, ...]:  # by value: a worker has what is loaded here, whatever its files say
        return _received, (pickled_by_value((type(self), dict(vars(self))), modules_of(type(self))),)


@functools.lru_cache(maxsize=32)
def _received(sent: bytes) -> VehicleModel:
    kind, values = pickle.loads(sent)
    model: VehicleModel = object.__new__(kind)
    for name, value in values.items():
        object.__setattr__(model, name, value)
    return model


def _plain(value: Any) -> bool:
    return all(map(_plain, value)) if isinstance(value, tuple) else isinstance(value, bool | int | float | str | None)


def _functions_of(*values: Any) -> Any:
    """NumPy for arrays, CasADi for its symbols."""
    if all(isinstance(value, np.ndarray | float | int) for value in values):
        return np
    import casadi

    return casadi


# ------------------------------------------------------------------------------------------------ functions of numbers


class Equations:
    """A model's derivatives, acceleration and Runge-Kutta step as functions of arrays."""

    def __init__(self, model: VehicleModel) -> None:
        self.model, self.name = model, type(model).__name__
        self.names = (*ERROR_STATES, *model.states)
        self.symbolic = model.symbolic and not model.advances
        if self.symbolic:
            import casadi as ca

            N = len(self.names)
            x, p, e, own = (ca.SX.sym(*word) for word in (("x", N), ("p", 4), ("e", 17), ("own", N - 4)))
            parts = ca.vertsplit(x), ca.vertsplit(p)
            self._known = ca.vertcat(x, p)
            self._rates = ca.Function("rates", [x, p], [ca.vertcat(*self._derivatives(*parts))])
            self._a_y = ca.Function("a_y", [x, p], [self._acceleration(*parts)])
            whole, points = ca.vertcat(e[:4], own), [e[5 + 4 * k : 9 + 4 * k] for k in range(3)]
            after, area = _runge_kutta(self._rates, whole, e[4], points)
            after = ca.densify(after)
            step = ca.Function("step", [e, own], [ca.densify(ca.vertcat(after[:4], area)), after[4:]])
            a_y = ca.Function("a_y_start", [e, own], [ca.densify(self._a_y(whole, points[0]))])
            several = (f.map(f"{f.name()}_several", "serial", TOGETHER, [], []) for f in (step, a_y))
            self._rates, *self.compiled = compiled((self._rates, *several), f"vehicle_{self.name}")

    def _derivatives(self, x: Any, p: Any) -> list[Any]:
        """Rates of all states from their symbols or arrays, and those of a moment."""
        path = f"{self.name}.derivatives"
        given = self._called(path, self.model.derivatives, x, p)
        wanted = ("e_y_rate", "e_psi_rate", *self.model.states)
        values = self._values(path, given, wanted, x)
        return [x[1], values["e_y_rate"], x[3], *(values[name] for name in wanted[1:])]

    def _acceleration(self, x: Any, p: Any) -> Any:
        path = f"{self.name}.a_y"
        return self._values(path, {"a_y": self._called(path, self.model.a_y, x, p)}, ("a_y",), x)["a_y"]

    def _called(self, path: str, method: Callable[..., Any], x: Any, p: Any) -> Any:
        """What a designer's method returns for x, delta, v, v_rate, lane; arrays are read-only to it."""
        x, p = [*x], [*p, p[2] / p[0]]
        for array in (*x, *p):
            if isinstance(array, np.ndarray):
                array.flags.writeable = False
        v, v_rate, yaw_rate, delta, curvature = p
        lane = Names(f"{self.name}.lane", yaw_rate=yaw_rate, curvature=curvature)
        names = Names(f"{self.name}.x", **dict(zip(self.names, x, strict=True)))
        more = {} if self.symbolic else {"hint": "x, delta, v, v_rate and lane are arrays (n,), not to be changed"}
        return called(path, method, names, delta, v, v_rate, lane, **more)

    def _values(self, path: str, given: Any, names: tuple[str, ...], like: Any) -> dict[str, Any]:
        """What a method gave, by name: symbols, or arrays like those of the states; else one sentence."""
        if not isinstance(given, Mapping):
            raise InputError(path, f"returned {type(given).__name__}", allowed="a dictionary of values by name")
        if missing := [name for name in names if name not in given]:
            raise InputError(f"{path}[{missing[0]!r}]", "missing")
        if unknown := [name for name in given if name not in names]:
            raise UnknownNameError(f"{path}.{unknown[0]}", "no such name", allowed=names)
        where = {name: f"{path}[{name!r}]" if len(names) > 1 else path for name in names}
        if self.symbolic and not isinstance(like[0], np.ndarray):
            allowed = "a number or a CasADi scalar of x, delta, v, v_rate and lane"
            return {name: checked_expression(where[name], given[name], self._known, allowed) for name in names}
        values = {}
        for name in names:
            try:
                array = np.asarray(given[name]).astype(np.float64, casting="same_kind")
                values[name] = np.broadcast_to(array, like[0].shape)
            except (TypeError, ValueError):
                value = getattr(given[name], "shape", type(given[name]).__name__)
                allowed = f"an array {like[0].shape} of real numbers"
                raise InputError(where[name], value=value, allowed=allowed) from None
        return values

    def rates(self, x: FloatArray, p: FloatArray) -> FloatArray:
        """Time derivatives (n, N) of states (n, N) at moments (n, 4), see `POINT`."""
        if self.symbolic:
            return np.ascontiguousarray(np.asarray(self._rates(x.T, p.T)).T) if len(x) else x.copy()
        with np.errstate(all="ignore"):
            return np.stack(self._derivatives([*x.T.copy()], [*p.T.copy()]), axis=1)

    def a_y(self, x: FloatArray, p: FloatArray) -> FloatArray:
        """Lateral acceleration (n,) [m/s^2]."""
        if self.symbolic:
            return np.asarray(self._a_y(x.T, p.T)).ravel()
        with np.errstate(all="ignore"):
            return np.array(self._acceleration([*x.T.copy()], [*p.T.copy()]))

    def step(self, e: FloatArray, own: FloatArray) -> tuple[FloatArray, FloatArray]:
        """A Runge-Kutta step from rows e (n, 17): four states, length, three moments; own states (n, N - 4).

        The four states after it and the integral of e_y (n, 5), the own states (n, N - 4).
        """

        def rate(x: FloatArray, p: FloatArray) -> FloatArray:
            return np.stack(self._derivatives([*x], [*p]))

        x, points = np.concatenate([e[:, :4], own], axis=1).T.copy(), e[:, 5:].T.reshape(3, 4, -1).copy()
        with np.errstate(all="ignore"):
            after, area = _runge_kutta(rate, x, e[:, 4].copy(), [*points])
        return np.column_stack([after[:4].T, area]), after[4:].T

    def advance(self, memory: Any, rows: IntArray, e: FloatArray, own: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The same as `step` by the model's own step, of scenarios `rows`."""
        path, h, road = f"{self.name}.advance", e[:, 4], []
        for v, v_rate, yaw_rate, delta in e[:, 5:].T.reshape(3, len(POINT), -1).copy():
            moment = {"v": v, "v_rate": v_rate, "yaw_rate": yaw_rate, "curvature": yaw_rate / v, "delta": delta}
            road.append(Names("road", **moment))
        x = Names("x", **dict(zip(self.names, np.concatenate([e[:, :4], own], axis=1).T.copy(), strict=True)))
        given = called(path, self.model.advance, memory, rows, x, tuple(road), h.copy(), hint="")
        after = np.stack([*self._values(path, given, self.names, (h,)).values()], axis=1)
        area = 0.5 * h * (e[:, 0] + after[:, 0]) + h**2 / 12.0 * (e[:, 1] - after[:, 1])
        return np.column_stack([after[:, :4], area]), after[:, 4:]

    def jacobian(self, x: FloatArray, p: FloatArray) -> FloatArray:
        """Derivatives of the rates on the states and on the wheel angle, (n, N, N + 1), by central differences."""
        z = np.concatenate([x, p[:, 3:]], axis=1)
        return _slopes(lambda z: self.rates(z[:, :-1], np.concatenate([p[:, :3], z[:, -1:]], axis=1)), z)

    def start(self, turn: RecordedTurn) -> tuple[FloatArray, FloatArray]:
        """States (m, N) and wheel angle (m,) with which m recorded paths are taken over."""
        path, allowed = f"{self.name}.initial", ("e_psi", "e_psi_rate", "delta", *self.model.states)
        given = called(path, self.model.initial, turn, hint="")
        if not isinstance(given, Mapping):
            raise InputError(path, f"returned {type(given).__name__}", allowed="a dictionary of arrays by name")
        zero = dict.fromkeys(self.model.states, 0.0)
        first = {"e_psi": turn.e_psi, "e_psi_rate": turn.e_psi_rate, "delta": turn.delta} | zero | {**given}
        values = {k: np.array(value) for k, value in self._values(path, first, allowed, (turn.v,)).items()}
        delta = values.pop("delta")
        x = np.column_stack([turn.e_y, turn.e_y_rate, *values.values()])
        bad = ~(np.isfinite(x).all(axis=1) & np.isfinite(delta))
        if not bad.any() and not self.model.advances:
            p = np.column_stack([turn.v, turn.v_rate, turn.yaw_rate, delta])
            bad = ~np.isfinite(self.rates(x, p)).all(axis=1)
            path = f"{self.name}.derivatives"
        if bad.any():
            at = f"at {turn.v[bad][0]:.3g} m/s in the recorded turn of {turn.e_y_acceleration[bad][0]:.2g} m/s^2"
            hint = f"a first guess may help: return self.steady_turn(turn, {[*self.model.states, 'delta'][0]}=...)"
            raise InputError(path, f"not finite {at}", allowed="finite numbers", hint=hint)
        return x, delta

    def fastest(self, x: FloatArray, p: FloatArray) -> FloatArray:
        """Largest eigenvalue or diagonal entry of the Jacobian by size, (n,) [1/s]."""
        A = self.jacobian(x, p)[:, :, :-1]
        if (bad := ~np.isfinite(A).all(axis=(1, 2))).any():
            at = f"near e_y = {x[bad][0, 0]:.3g} m, {p[bad][0, 0]:.3g} m/s"
            raise InputError(f"{self.name}.derivatives", f"not finite {at}", allowed="finite numbers")
        both = np.column_stack([np.linalg.eigvals(A), np.diagonal(A, axis1=1, axis2=2)])
        rates: FloatArray = np.abs(both).max(axis=1, initial=0.0)
        if (stiff := rates > FASTEST).any():
            at, allowed = f"at {p[stiff][0, 0]:.3g} m/s", f"at least {1.0 / FASTEST:g} s"
            hint = "what is faster may follow at once: write it as an equation, not as a state"
            value = f"a time constant of {1.0 / rates[stiff][0]:.2g} s {at}"
            raise InputError(f"{self.name}.derivatives", value=value, allowed=allowed, hint=hint)
        return rates


FASTEST: Final = 5e3  # [1/s] of a model that is integrated by the Runge-Kutta method


@functools.lru_cache(maxsize=32)
def equations(model: VehicleModel) -> Equations:
    """The functions of a model, made once."""
    return Equations(model)


def _runge_kutta(rate: Callable[[Any, Any], Any], x: Any, h: Any, points: list[Any]) -> tuple[Any, Any]:
    """States after a step with moments at its start, middle and end, and the integral of e_y, as in the compiled loop.

    k_1 = f(t, x), k_2 = f(t + h/2, x + h/2 k_1), k_3 = f(t + h/2, x + h/2 k_2), k_4 = f(t + h, x + h k_3),
    x+ = x + h/6 (k_1 + 2 k_2 + 2 k_3 + k_4).
    """
    k_1 = rate(x, points[0])
    x_2 = x + 0.5 * h * k_1
    k_2 = rate(x_2, points[1])
    x_3 = x + 0.5 * h * k_2
    k_3 = rate(x_3, points[1])
    k_4 = rate(x + h * k_3, points[2])
    return x + h / 6.0 * (k_1 + 2.0 * (k_2 + k_3) + k_4), h * (x[0] + h / 6.0 * (x[1] + x_2[1] + x_3[1]))


def _slopes(function: Callable[[FloatArray], FloatArray], z: FloatArray) -> FloatArray:
    """Derivatives (n, k, j) of values (n, k) on arguments (n, j), by central differences."""
    columns = []
    for j in range(z.shape[1]):
        step = np.zeros_like(z)
        step[:, j] = 1e-6 * np.maximum(1.0, np.abs(z[:, j]))
        columns.append((function(z + step) - function(z - step)) / (2.0 * step[:, j, None]))
    return np.stack(columns, axis=2)


_ROUNDS: Final = 25  # Newton steps
_SHORTER: Final = 5  # Times that one is halved at most
_LARGEST_TURN: Final = 0.1  # [rad] change of e_psi and delta in a step


def _newton(missing: Callable[[FloatArray], FloatArray], z: FloatArray) -> BoolArray:
    """Move z (m, j) to where the values `missing` (m, j) are 0; which rows were found, (m,)."""
    done = np.zeros(len(z), dtype=np.bool_)
    slopes = off = np.zeros((len(z), 0))
    with np.errstate(all="ignore"):
        for _ in range(_ROUNDS):
            slopes, off = _slopes(missing, z), missing(z)
            usable = np.asarray(np.isfinite(slopes).all(axis=(1, 2)) & np.isfinite(off).all(axis=1))
            inverse = np.linalg.pinv(np.where(usable[:, None, None], slopes, 0.0))
            step = (inverse @ np.where(usable[:, None], -off, 0.0)[:, :, None])[:, :, 0]
            length = np.abs(step).sum(axis=1)
            step /= np.maximum(1.0, np.abs(step[:, :2]).max(axis=1, initial=0.0) / _LARGEST_TURN)[:, None]
            for _ in range(_SHORTER):  # where the step after it would be no shorter
                after = np.abs(inverse @ missing(z + step)[:, :, None]).sum(axis=(1, 2))
                worse = ~done & (length > 1e-9) & ~(after <= length)
                if not worse.any():
                    break
                step[worse] *= 0.5
            z += np.where(done[:, None], 0.0, step)
            done |= usable & (np.abs(step) <= 1e-10 * (1.0 + np.abs(z))).all(axis=1)
            if done.all():
                break
        return np.asarray(done & (np.abs(missing(z)) <= 1e-6 * np.abs(slopes).max(axis=2) + 1e-9).all(axis=1))
