"""Controllers from functions that build a `casadi.Opti` problem, by any NLP solver that CasADi has.

State, lane, delay, status and fallback are those of `predictive`, which is faster.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import inspect
import threading
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Final, NamedTuple, final

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.casadi_code import Names, called
from ldctoolkit.control import Controller
from ldctoolkit.declared import gain, option
from ldctoolkit.errors import InputError, UnknownNameError
from ldctoolkit.vehicle.bicycle import Plant

from ._nmpc_model import LANE, Formulation
from ._nmpc_solver import Solution, Workspace
from ._prediction_model import VEHICLE
from .nonlinear_mpc import NonlinearMPC
from .predictive import PlanningLaw, PredictiveState
from .riccati import regulator

_GIVEN: Final = ("opti", "x", "lane", "delta_prev", "vehicle")
_SHARED: Final = ("horizon", "delta_max", "rate_max", "mu")
_ONE_SOLVE: Final = threading.Lock()  # with its statistics
_SILENT: Final[dict[str, dict[str, Any]]] = {
    "ipopt": {"ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.max_iter": 200},  # 3000 where nothing can be found
    "fatrop": {"fatrop.print_level": 0},
    # QRQP keeps nothing of the solve before, other than the usual qpOASES
    "sqpmethod": dict.fromkeys(("print_header", "print_iteration", "print_status"), False)
    | {"qpsol": "qrqp", "qpsol_options": dict.fromkeys(("print_iter", "print_header", "error_on_fail"), False)},
}


def from_opti(
    build: Callable[..., Any], *, solver: str = "ipopt", options: Mapping[str, Any] | None = None
) -> type[Controller]:
    """Make a controller class of a function that builds a `casadi.Opti` problem; usable as a decorator.

    Where the solver fails, the LQR of `vehicle.riccati`, else with weights (1, 0, 1, 0) and 2e4, steers within
    `delta_max` and `rate_max`, else within 0.1 rad and 0.2 rad/s. Raises `UnknownNameError` for an argument of `build`
    that is not known, `InputError` without a horizon; simulations raise for an unknown solver or a wrong problem.

    Parameters
    ----------
    build : callable
        Returns the N commands [rad], N being its gain `horizon`. Takes by name those that it needs of ``opti``; ``x``
        (4), the state where the first command steers; ``delta_prev`` [rad], the command before; ``lane`` with yaw_rate,
        curvature, steady_e_psi (N + 1), steady_delta (N), offset, dt and v, as in `PredictiveController.stage`;
        ``vehicle`` with C_af, C_ar, l_f, l_r, m, I_z, mu, v, dt, ``sample(x, delta, k)``, the state after sample k,
        ``a_y(x, delta, k)``, lateral acceleration beyond the lane's at its start, and ``riccati(q, r)``, the cost
        (4, 4) of the LQR with weights q (4) on x and r on delta. Arguments with defaults are gains: numbers, or what
        `gain` and `option` declare. Floats are parameters of the problem, others values. `horizon`, `delta_max`,
        `rate_max` and `mu` have the ranges of those of `NonlinearMPC`; `delta_max` and `rate_max` also limit what is
        sent, `mu` is that of `vehicle`.
    solver : str
        NLP solver of CasADi, the default of the option of this name.
    options : mapping, optional
        Options of CasADi for this solver.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> @ldc.from_opti
    ... def smooth(opti, x, lane, vehicle, horizon=20, r=2e4):
    ...     U, cost = opti.variable(horizon), 0
    ...     for k in range(horizon):
    ...         cost += x[0] ** 2 + x[2] ** 2 + r * (U[k] - lane.steady_delta[k]) ** 2
    ...         x = vehicle.sample(x, U[k], k)
    ...     opti.minimize(cost + x.T @ vehicle.riccati((1, 0, 1, 0), r) @ x)
    ...     return U
    >>> smooth(r=1e3).solver
    'ipopt'
    """
    name, shared = build.__name__, {declared.name: declared for declared in NonlinearMPC.gains()}
    attributes = {"name": name, "title": name.replace("_", " ").capitalize(), "build": staticmethod(build)}
    attributes |= {"options": {solver: dict(options or {})}, "__doc__": build.__doc__ or f"{name}."}
    attributes["__qualname__"] = build.__qualname__
    chosen = option(solver, choices=None, description="NLP solver of CasADi")
    fields: list[tuple[str, Any, Any]] = [("solver", str, chosen)]
    for key, default in ((p.name, p.default) for p in inspect.signature(build).parameters.values()):
        if key in _GIVEN:
            continue
        if default is inspect.Parameter.empty:
            raise UnknownNameError(f"{name}.{key}", "no such argument", allowed=_GIVEN, hint="a gain has a default")
        if key == "solver" or key in attributes or hasattr(OptiController, key):
            raise InputError(f"{name}.{key}", "reserved for the controller class", hint="rename the argument")
        if isinstance(default, dataclasses.Field):
            field = dataclasses.field(default=default.default, metadata=default.metadata)
            fields.append((key, type(default.default), field))
        elif key in _SHARED:
            same = shared[key]
            field = gain(default, unit=same.unit, lower=same.lower, upper=same.upper, description=same.description)
            fields.append((key, type(same.default), field))
        else:
            fields.append((key, type(default), gain(default, unit="1", description=f"argument of {name}")))
    if "horizon" not in (key for key, *_ in fields):
        raise InputError(f"{name}.horizon", "no such argument", hint="add horizon=20 to those of the function")
    made = dataclasses.make_dataclass(name, fields, bases=(OptiController,), namespace=attributes, frozen=True)
    made.__module__ = build.__module__  # an identity by content; from 3.12 on it would be this module
    return made


@dataclasses.dataclass(frozen=True)
class OptiController(Controller):
    """Base of the classes that `from_opti` makes."""

    build: ClassVar[Callable[..., Any]]
    options: ClassVar[Mapping[str, Mapping[str, Any]]]
    batch: ClassVar[int] = 20
    symmetric: ClassVar[bool] = False  # as in `PredictiveController`
    move_blocks: ClassVar[int] = 0

    def prepare(self, plant: Plant) -> OptiLaw:
        """Build the problem, and gather each scenario's numbers."""
        values = {declared.name: getattr(self, declared.name) for declared in self.gains()}
        nominal = NonlinearMPC(**{key: values[key] for key in _SHARED if key in values}).prepare(plant)
        gains = {key: value for key, value in values.items() if isinstance(value, float)}
        fixed = tuple((key, value) for key, value in values.items() if key not in gains)
        problem = called(f"{self.name}.build", _problem, type(self), fixed, tuple(gains), nominal.form)
        numbers = np.array([*gains.values()])
        others = np.full(problem.weights.numel_in(0) - numbers.size, np.nan)
        *q, r = np.asarray(problem.weights(np.append(others, numbers))).ravel()
        if not np.isfinite([*q, r]).all():
            raise InputError(f"{self.name}.build: vehicle.riccati", value=(*q, r), allowed="weights of gains alone")
        lq, parts = regulator(plant, tuple(q), r), nominal.form.layout.unpack(nominal.columns.T)
        parts["K"][:], parts["P"][:] = lq.K.T, lq.P.reshape(plant.n, nominal.form.size**2).T
        fields = {field.name: getattr(nominal, field.name) for field in dataclasses.fields(PlanningLaw)}
        return OptiLaw(**fields | {"design": self}, problem=problem, gains=numbers)


class _Problem(NamedTuple):
    """Functions of p: state, command before, lane, column of numbers, gains."""

    solver: Any
    bounds: Any  # p -> of the constraints
    commands: Any  # (variables, p) -> U
    weights: Any  # p -> (q, r) of the LQR
    start: FloatArray  # Variables without a plan before


@functools.lru_cache(maxsize=32)
def _problem(kind: type[OptiController], fixed: Any, gains: tuple[str, ...], form: Formulation) -> _Problem:
    import casadi as ca

    opti: Any = ca.Opti()
    values, path = dict(fixed), f"{kind.name}.build"
    N, solver = values["horizon"], values.pop("solver")
    if not ca.has_nlpsol(solver):
        plugins = (name.removeprefix("Nlpsol::") for name in ca.CasadiMeta.plugins().split(";") if "Nlpsol" in name)
        raise InputError(f"{kind.name}.solver", value=solver, allowed=[*filter(ca.has_nlpsol, plugins)])
    sizes = [form.size, 1, form.samples * N, form.layout.size, len(gains)]
    p = opti.parameter(sum(sizes))
    x, delta_prev, lane, c, symbols = ca.vertsplit(p, [0, *np.cumsum(sizes)])
    P: Any = ca.reshape(lane, -1, N)
    column, predict = form.layout.unpack(c), form.program(1).predict
    weights = [ca.MX([1.0, 0.0, 1.0, 0.0, 2e4])]
    numbers = {key: column["vehicle"][i] for i, key in enumerate(VEHICLE)}
    nodes = ca.horzcat(P, ca.vertcat(P[1, -1], P[1:LANE, -1], P[LANE + form.size :, -1], P[LANE + form.size :, -1]))

    def riccati(q: Any, r: Any) -> Any:
        weights.append(ca.vertcat(*q, r))
        return ca.reshape(column["P"], form.size, form.size)

    def refused(*_: Any) -> None:
        raise InputError(path, "sets or calls a solver", hint="give it to from_opti: solver=..., options={...}")

    opti.solver = opti.solve = opti.solve_limited = refused
    given = {
        "opti": opti, "x": x, "delta_prev": delta_prev,
        "lane": Names(
            f"{kind.name}.lane", yaw_rate=nodes[0, :].T, curvature=nodes[0, :].T / numbers["v"], v=numbers["v"],
            steady_e_psi=nodes[LANE + 2, :].T, steady_delta=P[3, :].T, offset=numbers.pop("offset"), dt=numbers["dt"],
        ),
        "vehicle": Names(
            f"{kind.name}.vehicle", **numbers, riccati=riccati,
            sample=lambda x, delta, k: predict(x, delta, P[:, k], c)[0],
            a_y=lambda x, delta, k: predict(x, delta, P[:, k], c)[1],
        ),
    }  # fmt: skip
    values |= {key: symbols[i] for i, key in enumerate(gains)}
    U = kind.build(**values, **{key: given[key] for key in inspect.signature(kind.build).parameters if key in given})
    U = ca.vertcat(*U) if isinstance(U, list | tuple) else U
    if not (isinstance(U, ca.MX) and U.numel() == N):
        returned = f"returned {type(U).__name__}{getattr(U, 'shape', '')}"
        raise InputError(path, returned, allowed=f"the {N} commands, an expression of CasADi or a list")
    opti.set_value(p, 0.0)
    own = [symbol for symbol in ca.symvar(opti.p) if symbol.name() != p.name()]
    known = [opti.debug.value(symbol, opti.initial()) for symbol in own]
    if not all(np.isfinite(value).all() for value in known):
        raise InputError(path, "has a parameter without a value", hint="use opti.set_value, or make it a gain")
    parts = ca.substitute([opti.f, opti.g, ca.vec(U), opti.lbg, opti.ubg], own, [*map(ca.MX, known)])
    bounds = ca.Function("bounds", [p], parts[3:])
    low, high = (np.asarray(bound).ravel() for bound in bounds(np.linspace(1.0, 2.0, p.numel())))
    asked: dict[str, Any] = dict.fromkeys(("print_time", "error_on_fail", "show_eval_warnings"), False)
    asked |= {"expand": True, "equality": (low == high).tolist()}
    asked |= _SILENT.get(solver, {}) | dict(kind.options.get(solver, {}))
    problem: Any = {"x": opti.x, "p": p, "f": parts[0], "g": parts[1]}
    return _Problem(
        ca.nlpsol("solve", solver, problem, asked), bounds,
        ca.Function("commands", [opti.x, p], [parts[2]]), ca.Function("weights", [p], [weights[-1]]),
        np.asarray(opti.debug.value(opti.x, opti.initial()), dtype=float).ravel(),
    )  # fmt: skip


@dataclasses.dataclass(frozen=True)
class OptiState(PredictiveState):
    """With the last variables and multipliers of each scenario."""

    w: FloatArray
    lam: FloatArray


@final
@dataclasses.dataclass(frozen=True)
class OptiLaw(PlanningLaw):
    """The problems of n scenarios."""

    problem: _Problem
    gains: FloatArray

    @property
    def limited(self) -> tuple[bool, bool]:
        """Those that are gains of the design."""
        return hasattr(self.design, "delta_max"), hasattr(self.design, "rate_max")

    def init(self, n: int) -> OptiState:
        """No plan yet."""
        sizes = self.problem.start.size, self.problem.bounds.numel_out(0)
        return OptiState(**vars(super().init(n)), w=np.tile(self.problem.start, (n, 1)), lam=np.zeros((n, sizes[1])))

    def _solve(self, work: Workspace, history: Any, soft: Any, state: OptiState, after: OptiState, i: int) -> Solution:
        """From the scenario's last plan; if that fails, from the start that the designer gave."""
        p = np.concatenate([work.z_0, work.delta_prev, work.P.ravel(), work.c, self.gains])
        problem, starts, iterations, solved = self.problem, [(self.problem.start, 0.0)], 0, False
        found: dict[str, Any] = {"x": problem.start, "lam_g": 0.0, "f": np.nan}
        if state.has_plan[i]:
            starts.insert(0, (state.w[i], state.lam[i]))
        low, high = problem.bounds(p)
        for start, lam in starts:
            with _ONE_SOLVE, contextlib.suppress(RuntimeError):  # which a solver inside the solver may raise
                found = problem.solver(x0=start, lam_g0=lam, p=p, lbg=low, ubg=high)
                stats = problem.solver.stats()
                solved, iterations = bool(stats["success"]), iterations + int(stats.get("iter_count", 0))
            if solved:
                break
        after.w[i], after.lam[i] = np.asarray(found["x"]).ravel(), np.asarray(found["lam_g"]).ravel()
        U = np.asarray(problem.commands(found["x"], p)).ravel()
        return Solution(U, work.Z, solved and bool(np.isfinite(U).all()), iterations, np.nan, float(found["f"]))
