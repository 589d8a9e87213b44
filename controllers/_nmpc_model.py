"""From the formulation of a predictive controller to CasADi functions of its horizon.

A formulation is a stage cost, limits and dynamics in CasADi expressions (`predictive`). Here they become functions of
numbers alone, so that C code compiled once serves every gain, speed and lane; maps over the samples keep it short.

z is the state of the prediction: e_y, e_y_rate, e_psi, e_psi_rate, the states of the formulation, and the command of
the sample before where it is used. Each sample has a column p of the lane (`LANE`), each scenario a column c of numbers
(`Layout`). A sample is a step of the third-order exponential Runge-Kutta method ETD3RK (S. Cox, P. Matthews,
*Exponential time differencing for stiff systems*, J. Comp. Phys. 176, 2002) about straight driving: with
f = A x + B delta + E r + g, and l(x), l_h(x) the exact linear plant after dt and dt/2,

    g_0 = g(x, r_0),  a = l_h(x) + H_1 g_0,  g_a = g(a, r_h),  b = l(x) + G_1 (2 g_a - g_0),  g_b = g(b, r_1)
    x+  = l(x) + G_1 g_0 + G_2 (4 g_a - 3 g_0 - g_b) + G_3 (4 g_0 - 8 g_a + 4 g_b),

G_1, G_2, G_3 the responses to 1, s and s^2/2 of s = t/dt. What is linear is exact, and stiffness is no trouble.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

import numpy as np

from ldctoolkit.casadi_code import Names, called, checked_expression
from ldctoolkit.errors import InputError, UnknownNameError

from ._prediction_model import PREVIOUS, STATES, VEHICLE, Layout, Vehicle, base_layout

LANE: Final = 4  # numbers of a sample before its reference states: yaw rate at both ends, index, steady angle


@dataclasses.dataclass(frozen=True)
class Structure:
    """What the functions are compiled for: a class, and what decides the form of its expressions."""

    controller: type
    content: str  # Of the class's code
    fixed: tuple[tuple[str, Any], ...]  # Values of whole numbers, switches and words
    gains: tuple[str, ...]  # Gains that are parameters
    zeros: tuple[str, ...]  # Gains of exactly 0, which are numbers in the expressions

    def design(self, values: Any) -> Any:
        """The design with CasADi symbols for its gains."""
        design: Any = object.__new__(self.controller)
        numbers = dict(self.fixed) | dict.fromkeys(self.zeros, 0.0)
        for name, value in [*numbers.items(), *((name, values[i]) for i, name in enumerate(self.gains))]:
            object.__setattr__(design, name, value)
        return design


class SoftRow(NamedTuple):
    """One kind of soft limit: low <= output <= high at every sample, violations v cost w v + w v^2/2."""

    output: int  # Index among the outputs; of jerk that of an acceleration
    soft: int  # Index among the soft limits of the stage
    end: bool  # Of the sample's end, where k is that of the next one
    history: int | None = None  # Of jerk: 0 for just after each command, 1 for each sample's end


class Program(NamedTuple):
    """Functions of one horizon N; Z is (nz, N), U (1, N), P (np, N), c a column."""

    # (z, u, p, c) -> (z after a sample, a_0, a_1) One sample with a command that is known
    predict: Any
    # (z_0, guess, share, previous, P, low, high, low_change, high_change, c) -> (U, Z) Drive the model with commands
    # guess, or, with share = 1, the LQR, moved into the limits
    roll: Any
    # (Z, U, z_0, P, c) -> (J, gap, O) The cost, sum of the absolute gaps, outputs (no, N)
    value: Any
    # (Z, U, z_0, P, c, M) -> (H, g, T, t, J_t, slope, Y, y) The condensed QP: Delta Z = T' Delta U + t, Hessian H of
    # the Lagrangian, gradient g, change J_t of the cost by t alone, largest multiplier; T is (N, nz N). Of the outputs
    # their sensitivity Y (N, no N) and change y (no, N) by t; M (no, N) are their multipliers
    linearise: Any
    # (Z, U, z_0, P, c) -> gradient (1, N) of the cost on the commands, where there are no gaps
    gradient: Any
    # (P, c) -> bounds of delta and of its change (1, N); bounds, weights of v and of v^2/2 of the soft rows (ns, N)
    limits: Any


@dataclasses.dataclass(frozen=True, eq=False)
class Formulation:
    """A structure's expressions as functions; z, u, p, c as in the module's text."""

    structure: Structure
    own: tuple[str, ...]  # States beyond those of the vehicle
    previous: bool  # The command before is a state
    nonlinear_rows: tuple[int, ...]  # Rates that are not linear in x, u and r
    quadratic: bool  # Linear dynamics, a quadratic cost and linear limits: one quadratic program is the whole problem
    affine: bool  # And what the lane does to it is affine: neither Hessian nor limits depend on the lane
    riccati: bool  # The terminal cost is that of the Riccati equation
    layout: Layout
    outputs: int
    soft: tuple[SoftRow, ...]
    linear_part: Any  # (base columns) -> (A, B, E) of the rates at straight driving
    hessian: Any  # (z, u, p, c) -> second derivatives (nz + 1, nz + 1) of the stage cost
    check: Any  # (z, u, p, c) -> numbers that have to be finite; slopes of the stage cost and of the terminal cost
    limit: Any  # (p, c) -> as `Program.limits`, of one sample
    program: Callable[[int], Program]

    @property
    def size(self) -> int:
        """States of z."""
        return len(STATES) + len(self.own) + self.previous

    @property
    def samples(self) -> int:
        """Numbers of a sample's column."""
        return LANE + 2 * self.size


@functools.lru_cache(maxsize=32)
def formulation(structure: Structure) -> Formulation:
    """The functions of a structure."""
    return _Builder(structure).build()


_RATE: Final = "the rate of a command is u.change / lane.dt"


class _Builder:
    """Symbols and expressions of one formulation."""

    def __init__(self, structure: Structure) -> None:
        import casadi as ca

        self.ca, self.structure = ca, structure
        self.base = base_layout(len(structure.gains))
        self.c_base = ca.SX.sym("c", self.base.size)
        parts = self.base.unpack(self.c_base)
        self.design = structure.design(parts["gains"])
        self.name = self.design.name
        self.numbers = {key: parts["vehicle"][i] for i, key in enumerate(VEHICLE)}
        shown = {key: value for key, value in self.numbers.items() if key != "offset"}
        self.vehicle = Vehicle(f"{self.name}.vehicle", **shown, _linear=parts["linear"])
        self.own = checked_states(self.design)
        self.nx = len(STATES) + len(self.own)
        # what a designer's expressions are made of
        self.x, self.u, self.change, self.prev = (
            ca.SX.sym(s, k) for s, k in (("x", self.nx), ("u", 1), ("change", 1), ("previous", 1))
        )
        self.a, self.jerk, self.r, self.k, self.steady = (
            ca.SX.sym(s) for s in ("a_y", "jerk", "r", "k", "steady_delta")
        )
        self.ref = ca.SX.sym("ref", self.nx)
        self.moving = ca.vertcat(self.x, self.u, self.change, self.prev, self.a, self.jerk)
        self.given = ca.vertcat(self.r, self.k, self.steady, self.ref, self.c_base)

    def build(self) -> Formulation:
        ca, nx = self.ca, self.nx
        rates, a_rate = self._dynamics()
        cost, hard, soft = self._stage()
        terminal = self._terminal()
        parts = [cost, rates, a_rate, *(value for row in soft for value in row[:1])]
        self.previous = bool(ca.depends_on(ca.vertcat(*parts), ca.vertcat(self.prev, self.change)))
        if terminal is not None:
            self.previous |= bool(ca.depends_on(terminal, self.prev))
        self.nz = nz = nx + self.previous
        zeros = [
            (value, ca.DM.zeros(*value.shape)) for value in (self.x, self.u, self.prev, self.r, self.steady, self.ref)
        ]
        straight = [ca.densify(_replaced(ca.jacobian(rates, of), zeros)) for of in (self.x, self.u, self.r)]
        self.rows = self._nonlinear_rows(rates, zeros)
        where = [self.x, self.u, self.prev, self.r, self.steady, self.ref, self.c_base]
        self.rate = ca.Function("rate", where, [rates, a_rate])
        q, exponential = len(self.rows), self.design.integrator == "exponential"
        linear = {"A": nx * nx, "B": nx, "E_0": nx, "E_1": nx} if exponential else {}
        half = {"A_h": nx * nx, "B_h": nx, "E_0h": nx, "E_1h": nx, "A_c": nx * nx, "B_c": nx, "E_c": nx}
        half |= dict.fromkeys(("H_1", "G_1", "G_2", "G_3"), nx * q)
        self.layout = Layout(self.base | linear | (half if q and exponential else {}) | {"P": nz * nz, "K": nz})
        self.c = c = ca.SX.sym("c", self.layout.size)

        # the same in terms of z, u, p, c
        z, p, u = ca.SX.sym("z", nz), ca.SX.sym("p", LANE + 2 * nz), self.u
        f, a_0, a_1 = self._sample(z, p)
        start, end = self._point(z, z, p, a_0, at_end=False), self._point(f, z, p, a_1, at_end=True)
        cost = _replaced(cost, start)
        rows: list[tuple[SoftRow, list[Any]]] = []
        outputs: list[Any] = []
        for expression, low, high, weight, curve, jerk, index in soft:
            sides = (start, end) if jerk or ca.depends_on(expression, self.a) else (end,)
            if not jerk and not ca.depends_on(expression, ca.vertcat(self.x, self.prev, self.a)):
                sides = (start,)  # of the command alone
            for side in sides:
                rows.append(
                    (
                        SoftRow(len(outputs), index, side is end, int(side is end) if jerk else None),
                        [_replaced(v, side) for v in (low, high, weight, curve)],
                    )
                )
                outputs.append((a_0 if side is start else a_1) if jerk else _replaced(expression, side))
        o = ca.densify(ca.vertcat(*outputs)) if outputs else ca.SX(0, 1)
        columns = [ca.vertcat(*(bounds[i] for _, bounds in rows)) if rows else ca.SX(0, 1) for i in range(4)]
        limit = ca.Function("limit", [p, c], [*(_replaced(value, start) for value in hard), *columns])
        off = z - p[LANE + nz :]
        P = ca.reshape(self.layout.unpack(c)["P"], nz, nz)
        final = (
            0.5 * ca.bilin(P, off, off)
            if terminal is None
            else _replaced(terminal, self._point(z, z, p, 0, at_end=True))
        )

        zu = ca.vertcat(z, u)
        H, g = ca.hessian(cost, zu)
        slope = ca.gradient(final, z)
        bent = ca.vertcat(
            *(ca.vec(part) for part in (ca.jacobian(f, zu), H, ca.jacobian(o, zu), ca.hessian(final, z)[0])),
            *([zu] if _kinked(ca.Function("parts", [z, u, p, c], [cost, f, o, final])) else []),
        )
        finite = ca.vertcat(
            *(ca.vec(part) for part in (g, H, f, ca.jacobian(f, zu), o, ca.jacobian(o, zu), final, slope))
        )
        quadratic = not ca.depends_on(bent, zu)
        affine = quadratic and not self.rows
        if affine:
            of_lane = ca.vertcat(p[:2], p[3:])
            first = ca.jacobian(ca.vertcat(g, f, a_0, a_1, o, slope), ca.vertcat(zu, of_lane))
            bounds = _replaced(ca.vertcat(*hard), start)
            affine = not ca.depends_on(ca.vertcat(ca.vec(first), bounds, *columns), ca.vertcat(zu, of_lane))
        return Formulation(
            structure=self.structure, own=self.own, previous=self.previous, nonlinear_rows=self.rows,
            quadratic=quadratic, affine=affine, riccati=terminal is None, layout=self.layout, outputs=len(outputs),
            soft=tuple(row for row, _ in rows), linear_part=ca.Function("linear_part", [self.c_base], straight),
            hessian=ca.Function("hessian", [z, u, p, c], [ca.densify(H)]),
            limit=limit,
            check=ca.Function("check", [z, u, p, c], [ca.densify(finite), ca.densify(ca.vertcat(g, slope))]),
            program=functools.partial(
                build, z=z, u=u, p=p, c=c, f=f, a_0=a_0, a_1=a_1, cost=cost, final=final, o=o, layout=self.layout,
                limit=limit, exact=self.design.hessian == "exact",
            ),
        )  # fmt: skip

    def _names(self, *, of_stage: bool) -> tuple[Names, Names, Names]:
        """x, u and lane of the designer's methods."""
        states = dict(zip((*STATES, *self.own), self.ca.vertsplit(self.x), strict=True))
        seen = {"a_y": self.a, "jerk": self.jerk} if of_stage else {}
        return (
            Names(f"{self.name}.x", **({"wheel": self.prev} | states | seen)),
            Names(f"{self.name}.u", _RATE, delta=self.u, change=self.change),
            Names(
                f"{self.name}.lane", yaw_rate=self.r, curvature=self.r / self.numbers["v"],
                steady_delta=self.steady, steady_e_psi=self.ref[2], offset=self.numbers["offset"],
                dt=self.numbers["dt"], v=self.numbers["v"],
            ),
        )  # fmt: skip

    def _expression(self, path: str, value: Any, *, given: bool = False, absent: Any = None) -> Any:
        """The value, or what stands for None, as a CasADi scalar of known symbols; `given`: of lane, k and gains."""
        allowed = "a number or a CasADi scalar of " + ("lane, k and gains" if given else "x, u, lane, k and gains")
        return checked_expression(
            path,
            absent if value is None else value,
            self.given if given else self.ca.vertcat(self.moving, self.given),
            allowed,
        )

    def _dynamics(self) -> Any:
        """dx/dt, and the lateral acceleration beyond the lane's."""
        ca, path = self.ca, f"{self.name}.dynamics"
        x, u, lane = self._names(of_stage=False)
        given = called(path, self.design.dynamics, x, u, lane, self.vehicle)
        names = (*STATES, *self.own)
        if not isinstance(given, Mapping):
            raise InputError(path, f"returned {type(given).__name__}", allowed="a dictionary of rates by state")
        if missing := [name for name in names if name not in given]:
            raise InputError(f"{path}[{missing[0]!r}]", "no rate of this state", allowed=f"rates of {', '.join(names)}")
        if unknown := [name for name in given if name not in (*names, "a_y")]:
            raise UnknownNameError(f"{path}.{unknown[0]}", "no such state", allowed=(*names, "a_y"))
        values = {name: self._expression(f"{path}[{name!r}]", value) for name, value in given.items()}
        # without an a_y of its own: d^2 e_y/dt^2 is that beyond the lane's, for small heading errors
        both: Any = ca.vertcat(*(values[name] for name in names), values.get("a_y", values["e_y_rate"]))
        both = ca.substitute(both, self.change, self.u - self.prev)
        a_y: Any = both[-1]
        return both[:-1], a_y

    def _stage(self) -> tuple[Any, tuple[Any, ...], list[tuple[Any, ...]]]:
        """Cost; bounds of delta and change; rows (value, low, high, weights of v and v^2/2, whether of jerk, index)."""
        ca, path = self.ca, f"{self.name}.stage"
        stage = called(path, self.design.stage, *self._names(of_stage=True), self.k)
        if not all(hasattr(stage, name) for name in ("cost", "hard", "soft")):
            raise InputError(path, f"returned {type(stage).__name__}", allowed="a Stage")
        for name in ("hard", "soft"):
            if not isinstance(rows := getattr(stage, name), list | tuple):
                raise InputError(f"{path}.{name}", f"of type {type(rows).__name__}", allowed="a list")
        cost = self._expression(f"{path}.cost", stage.cost)
        if ca.depends_on(cost, self.jerk):
            hint = "weigh x.a_y or u.change; limit jerk with Soft"
            raise InputError(f"{path}.cost", "holds x.jerk, a mean over half a second", hint=hint)
        bounds = [ca.SX(-np.inf), ca.SX(np.inf), ca.SX(-np.inf), ca.SX(np.inf)]
        for i, row in enumerate(stage.hard):
            where = f"{path}.hard[{i}]"
            if not (isinstance(row, tuple | list) and len(row) == 3):
                raise InputError(where, f"of type {type(row).__name__}", allowed="a tuple (expression, low, high)")
            value = self._expression(where, row[0])
            sides = ((1, -np.inf), (2, np.inf))
            low, high = (self._expression(f"{where}[{j}]", row[j], given=True, absent=end) for j, end in sides)
            held = [k for k, of in enumerate((self.u, self.change)) if ca.depends_on(value, of)]
            other = ca.depends_on(value, ca.vertcat(self.x, self.prev, self.a, self.jerk))
            if len(held) != 1 or other or ca.depends_on(ca.jacobian(value, self.moving), self.moving):
                hint = "what depends on the state may not be possible to keep: limit it with Soft"
                raise InputError(where, allowed="a hard limit of u.delta or of u.change, linear in it", hint=hint)
            slope = ca.jacobian(value, (self.u, self.change)[held[0]])
            rest = _replaced(value, [(self.u, ca.DM(0)), (self.change, ca.DM(0))])
            ends = (low - rest) / slope, (high - rest) / slope
            k = 2 * held[0]
            rising = ca.simplify(slope > 0)  # not by fmin and fmax of both ends, which drop one that is no number
            bounds[k] = ca.fmax(bounds[k], ca.if_else(rising, *ends))
            bounds[k + 1] = ca.fmin(bounds[k + 1], ca.if_else(rising, *ends[::-1]))
        return (
            cost,
            tuple(bounds),
            [(*row, i) for i, soft in enumerate(stage.soft) for row in self._soft(f"{path}.soft[{i}]", soft)],
        )

    def _soft(self, path: str, soft: Any) -> list[tuple[Any, ...]]:
        ca = self.ca
        if not all(hasattr(soft, name) for name in ("value", "lower", "upper", "weight")):
            raise InputError(path, f"of type {type(soft).__name__}", allowed="Soft(value, lower, upper, weight)")
        value = self._expression(path, soft.value)
        sides = (("lower", -np.inf), ("upper", np.inf))
        low, high = (self._expression(f"{path}.{name}", getattr(soft, name), absent=end) for name, end in sides)
        if low.is_minus_inf() and high.is_inf():
            raise InputError(path, "has no limit", allowed="lower, upper, or both")
        weight = self._expression(f"{path}.weight", soft.weight, given=True)
        if ca.depends_on(ca.vertcat(value, low, high), self.jerk):
            others = ca.vertcat(self.x, self.u, self.change, self.prev, self.a)
            slope = ca.jacobian(value, self.jerk)
            rest = value - slope * self.jerk
            if ca.depends_on(ca.vertcat(slope, ca.simplify(rest)), ca.vertcat(others)) or ca.depends_on(
                ca.vertcat(slope, low, high), self.moving
            ):
                raise InputError(path, allowed="a limit of x.jerk that is linear in it and holds no other state")
            rest = _replaced(value, [(self.jerk, ca.DM(0))])
            ends = (low - rest) / slope, (high - rest) / slope
            return [(self.jerk, ca.fmin(*ends), ca.fmax(*ends), weight * ca.fabs(slope), weight * slope**2, True)]
        if not ca.depends_on(ca.vertcat(low, high), self.moving):
            return [(value, low, high, weight, weight, False)]
        none = ca.SX(np.inf)
        below = (value - low, ca.SX(0), none) if ca.depends_on(low, self.moving) else (value, low, none)
        above = (value - high, -none, ca.SX(0)) if ca.depends_on(high, self.moving) else (value, -none, high)
        rows = ((below, low.is_minus_inf()), (above, high.is_inf()))
        return [(*row, weight, weight, False) for row, is_open in rows if not is_open]

    def _terminal(self) -> Any:
        """The designer's terminal cost; None for that of the Riccati equation."""
        x, _, lane = self._names(of_stage=False)
        path = f"{self.name}.terminal"
        value = called(path, self.design.terminal, x, lane)
        if value is None:
            return None
        value = self._expression(path, value)
        if self.ca.depends_on(value, ca_free := self.ca.vertcat(self.u, self.change)):
            raise InputError(path, f"holds a command: {ca_free}", allowed="an expression of x and lane")
        return value

    def _nonlinear_rows(self, rates: Any, zeros: list[tuple[Any, Any]]) -> tuple[int, ...]:
        """Rates that are not the linear part alone."""
        ca = self.ca
        inputs = ca.vertcat(self.x, self.u, self.r)
        symbols = [*(symbol for symbol, _ in zeros), self.c_base]
        rows = []
        for i in range(self.nx):
            slopes = ca.jacobian(rates[i], inputs)
            constant = ca.Function("constant", [self.c_base], [_replaced(rates[i], zeros)])
            if (
                ca.depends_on(rates[i], ca.vertcat(self.prev, self.steady, self.ref))
                or ca.depends_on(slopes, inputs)
                or _kinked(ca.Function("rate", symbols, [rates[i]]))  # a step has slopes of 0
                or float(constant(np.ones(self.base.size))) != 0.0
            ):
                rows.append(i)
        return tuple(rows)

    def _point(self, z: Any, z_start: Any, p: Any, a: Any, *, at_end: bool) -> list[tuple[Any, Any]]:
        """What stands for each symbol at the start or the end of a sample."""
        nx, ref = self.nx, LANE + (self.nz if at_end else 0)
        prev, before = (z[nx], z_start[nx]) if self.previous else (self.u, self.u)
        return [
            (self.x, z[:nx]), (self.a, a), (self.r, p[1] if at_end else p[0]), (self.k, p[2] + at_end),
            (self.steady, p[3]), (self.ref, p[ref : ref + nx]), (self.prev, prev), (self.change, self.u - before),
            (self.c_base, self.c[: self.base.size]),
        ]  # fmt: skip

    def _sample(self, z: Any, p: Any) -> tuple[Any, Any, Any]:
        """Z after a sample; lateral acceleration just after the command and at the end."""
        ca, nx, u = self.ca, self.nx, self.u
        c, base = self.layout.unpack(self.c), self.c[: self.base.size]
        x, prev, r_0, r_1 = z[:nx], z[nx] if self.previous else u, p[0], p[1]
        r_h, refs = 0.5 * (r_0 + r_1), (p[LANE : LANE + nx], p[LANE + self.nz : LANE + self.nz + nx])

        def rates(x: Any, r: Any, share: float) -> Any:
            ref = (1.0 - share) * refs[0] + share * refs[1]
            return self.rate(x, u, prev, r, p[3], ref, base)

        k_1, a_0 = rates(x, r_0, 0.0)
        if self.design.integrator == "rk4":
            dt = self.numbers["dt"]
            dt = _replaced(dt, [(self.c_base, base)])
            k_2, _ = rates(x + 0.5 * dt * k_1, r_h, 0.5)
            k_3, _ = rates(x + 0.5 * dt * k_2, r_h, 0.5)
            k_4, _ = rates(x + dt * k_3, r_1, 1.0)
            after = x + dt / 6.0 * (k_1 + 2 * k_2 + 2 * k_3 + k_4)
        else:
            q, rows = len(self.rows), list(self.rows)

            def linear(part: str, r_end: Any) -> Any:
                A = ca.reshape(c["A" + part], nx, nx)
                return ca.mtimes(A, x) + c["B" + part] * u + c["E_0" + part[1:]] * r_0 + c["E_1" + part[1:]] * r_end

            after = linear("", r_1)
            if q:
                A_c = ca.reshape(c["A_c"], nx, nx)

                def rest(x: Any, r: Any, share: float) -> Any:
                    value, _ = rates(x, r, share)
                    return (value - (ca.mtimes(A_c, x) + c["B_c"] * u + c["E_c"] * r))[rows]

                H_1, G_1, G_2, G_3 = (ca.reshape(c[name], nx, q) for name in ("H_1", "G_1", "G_2", "G_3"))
                g_0 = rest(x, r_0, 0.0)
                g_a = rest(linear("_h", r_h) + ca.mtimes(H_1, g_0), r_h, 0.5)
                g_b = rest(after + ca.mtimes(G_1, 2 * g_a - g_0), r_1, 1.0)
                after += ca.mtimes(G_1, g_0) + ca.mtimes(G_2, 4 * g_a - 3 * g_0 - g_b)
                after += ca.mtimes(G_3, 4 * (g_0 - 2 * g_a + g_b))
        a_1 = rates(after, r_1, 1.0)[1]
        return ca.vertcat(after, u) if self.previous else after, a_0, a_1


def _kinked(function: Any) -> bool:
    """Whether a function has steps or kinks, which derivatives do not show, in other inputs than its last."""
    import casadi as ca

    kinks = (ca.OP_FABS, ca.OP_SIGN, ca.OP_FMIN, ca.OP_FMAX, ca.OP_FLOOR, ca.OP_CEIL, ca.OP_LT, ca.OP_LE, ca.OP_EQ,
             ca.OP_NE, ca.OP_IF_ELSE_ZERO, ca.OP_FMOD, ca.OP_REMAINDER, ca.OP_COPYSIGN)  # fmt: skip
    moves: dict[int, bool] = {}  # Whether a result depends on them
    for k in range(function.n_instructions()):
        operation, inputs = function.instruction_id(k), function.instruction_input(k)
        if operation == ca.OP_OUTPUT:
            continue
        here = inputs[0] < function.n_in() - 1 if operation == ca.OP_INPUT else any(moves[i] for i in inputs)
        if here and operation in kinks:
            return True
        moves[function.instruction_output(k)[0]] = here
    return False


def _replaced(expression: Any, values: list[tuple[Any, Any]]) -> Any:
    """The expression with values for symbols, all at once."""
    import casadi as ca

    shaped = [ca.SX(value) if not isinstance(value, ca.SX) else value for _, value in values]
    return ca.substitute([expression], [symbol for symbol, _ in values], shaped)[0]


def checked_states(design: Any) -> tuple[str, ...]:
    """States of a formulation beyond those of the vehicle."""
    path, states = f"{design.name}.states", design.states
    if not (isinstance(states, tuple) and all(isinstance(s, str) and s.isidentifier() for s in states)):
        raise InputError(path, value=states, allowed="a tuple of names")
    for name in states:
        if name in (*STATES, "a_y", "jerk", PREVIOUS) or states.count(name) > 1:
            raise InputError(path, value=name, allowed="other names than those of the vehicle's states, each once")
    return states


# ----------------------------------------------------------------------------------------------- functions of a horizon


def build(
    N: int, *, z: Any, u: Any, p: Any, c: Any, f: Any, a_0: Any, a_1: Any, cost: Any, final: Any, o: Any,
    layout: Layout, limit: Any, exact: bool,
) -> Program:  # fmt: skip
    """The functions for horizon N, not compiled."""
    import casadi as ca

    predict = ca.Function("predict", [z, u, p, c], [f, a_0, a_1])
    P, c_all = ca.MX.sym("P", p.numel(), N), ca.MX.sym("c", c.numel())
    limits = ca.Function(
        "limits", [P, c_all], [ca.densify(v) for v in limit.map("limit_all", "serial", N, [1], [])(P, c_all)]
    )
    return Program(
        predict, _roll(ca, N, z, u, p, c, f, layout), *_plan(ca, N, z, u, p, c, f, cost, final, o, exact), limits
    )


def _roll(ca: Any, N: int, z: Any, u: Any, p: Any, c: Any, f: Any, layout: Layout) -> Any:
    nz = z.numel()
    step = ca.Function("sample_f", [z, u, p, c], [f])
    guess, share, previous = (ca.SX.sym(name) for name in ("guess", "share", "previous"))
    low, high, low_change, high_change = (ca.SX.sym(name) for name in ("low", "high", "low_change", "high_change"))
    lqr = p[3] - ca.dot(layout.unpack(c)["K"], z - p[LANE : LANE + nz])
    within_limits = ca.fmin(ca.fmax((1 - share) * guess + share * lqr, low), high)
    command = ca.fmin(ca.fmax(within_limits, previous + low_change), previous + high_change)
    after = ca.vertcat(step(z, command, p, c), command)
    state = ca.vertcat(z, previous)
    single = ca.Function("roll_one", [state, guess, share, p, low, high, low_change, high_change, c], [after])
    drive = single.mapaccum("roll_all", N)

    z_0, delta_prev, share, guess = (
        ca.MX.sym("z_0", nz),
        ca.MX.sym("previous"),
        ca.MX.sym("share"),
        ca.MX.sym("guess", 1, N),
    )
    bounds = [ca.MX.sym(name, 1, N) for name in ("low", "high", "low_change", "high_change")]
    P, c = ca.MX.sym("P", p.numel(), N), ca.MX.sym("c", c.numel())
    path = drive(ca.vertcat(z_0, delta_prev), guess, share * ca.MX.ones(1, N), P, *bounds, ca.repmat(c, 1, N))
    return ca.Function("roll", [z_0, guess, share, delta_prev, P, *bounds, c], [path[nz, :], path[:nz, :]])


def _plan(
    ca: Any, N: int, z: Any, u: Any, p: Any, c: Any, f: Any, cost: Any, final: Any, o: Any, exact: bool
) -> tuple[Any, Any, Any]:
    nz, no = z.numel(), o.numel()
    zu = ca.vertcat(z, u)
    after = ca.SX.sym("after", nz)
    gap = f - after
    value_one = ca.Function("value_one", [z, u, after, p, c], [cost, ca.norm_1(gap), o])
    slopes_one = ca.Function(
        "slopes_one", [z, u, after, p, c],
        [ca.densify(v) for v in (gap, ca.jacobian(f, z), ca.jacobian(f, u), ca.gradient(cost, z), ca.gradient(cost, u),
                                 ca.jacobian(o, z).T, ca.jacobian(o, u))],
    )  # fmt: skip
    values = value_one.map("value_all", "serial", N, [4], [0, 1])
    slopes = slopes_one.map("slopes_all", "serial", N, [4], [])
    curved, sloped = ca.hessian(final, z)
    end = ca.Function("end", [z, p, c], [final, ca.densify(sloped), ca.densify(curved)])

    # multipliers, backwards
    multiplier, A, pull = ca.SX.sym("l", nz), ca.SX.sym("A", nz, nz), ca.SX.sym("pull", nz)
    back_one = ca.Function("back_one", [multiplier, A, pull], [ca.mtimes(A.T, multiplier) + pull])
    m, o_x = ca.SX.sym("m", no), ca.SX.sym("o_x", nz, no)
    press = ca.Function("press_one", [o_x, m], [ca.mtimes(o_x, m)])
    lagrangian = cost + (ca.dot(multiplier, f) + ca.dot(m, o) if exact else 0)
    bend_one = ca.Function("bend_one", [z, u, p, c, multiplier, m], [ca.densify(ca.hessian(lagrangian, zu)[0])])
    bends = bend_one.map("bend_all", "serial", N, [3], [])

    # condensing: rows of T are the states' sensitivities to one command
    T, t, B, d, e = ca.SX.sym("T", N, nz), ca.SX.sym("t", nz), ca.SX.sym("B", nz), ca.SX.sym("d", nz), ca.SX.sym("e", N)
    forward_one = ca.Function(
        "forward_one", [T, t, A, B, d, e], [ca.mtimes(T, A.T) + ca.mtimes(e, B.T), ca.mtimes(A, t) + d]
    )  # fmt: skip
    forward = forward_one.mapaccum("forward_all", N, 2)
    W, h = ca.SX.sym("W", nz, nz), ca.SX.sym("h", nz)
    weigh_one = ca.Function("weigh_one", [T, W, t, h], [ca.mtimes(T, W), ca.mtimes(W, t), ca.mtimes(T, h)])
    weigh = weigh_one.map("weigh_all", "serial", N, [], [])
    row_one = ca.Function("row_one", [T, h], [ca.mtimes(T, h)])
    rows = row_one.map("row_all", "serial", N, [], [])

    Z, U, z_0 = ca.MX.sym("Z", nz, N), ca.MX.sym("U", 1, N), ca.MX.sym("z_0", nz)
    P, c, M = ca.MX.sym("P", p.numel(), N), ca.MX.sym("c", c.numel()), ca.MX.sym("M", no, N)
    before = ca.horzcat(z_0, Z[:, :-1])
    problem, names = [Z, U, z_0, P, c], ["Z", "U", "z_0", "P", "c"]
    stage_costs, gaps, values_out = values(before, U, Z, P, c)
    V, V_z, V_zz = end(Z[:, N - 1], P[:, N - 1], c)
    value = ca.Function("value", problem, [stage_costs + V, gaps, ca.densify(values_out)], names, ["J", "gap", "O"])

    d, A, B, pull, push, o_z, o_u = slopes(before, U, Z, P, c)
    # o_z is (nz, no N): gradient of the outputs' terms on the state at each sample's start
    pulled = pull + press.map("press_all", "serial", N, [], [])(o_z, M) if no else pull
    multipliers = V_z
    if N > 1:
        flip = list(range(N - 1, 0, -1))
        back = back_one.mapaccum("back_all", N - 1)
        columns = [nz * k + i for k in flip for i in range(nz)]
        multipliers = ca.horzcat(V_z, back(V_z, A[:, columns], pulled[:, flip]))[:, list(range(N - 1, -1, -1))]
    L = bends(before, U, P, c, multipliers, M)

    eye = ca.MX(ca.DM.eye(N))
    T, t = forward(ca.MX.zeros(N, nz), ca.MX.zeros(nz), A, B, d, eye)
    s = nz + 1
    # of z_1 .. z_N, N columns each: curvature, its mixed part with the command of the same sample
    W = ca.horzcat(L[:nz, [k for j in range(1, N) for k in range(s * j, s * j + nz)]], V_zz)
    cross = ca.horzcat(L[:nz, [s * j + nz for j in range(1, N)]], ca.MX.zeros(nz, 1))
    TW, Wt, mixed = weigh(T, W, t, cross)  # mixed: column j-1 is for u_j
    mixed = ca.horzcat(ca.MX.zeros(N, 1), mixed[:, : N - 1])
    H = ca.mtimes(TW, T.T) + mixed + mixed.T + ca.diag(L[nz, [s * j + nz for j in range(N)]])
    on_states = ca.horzcat(pull[:, 1:], V_z)
    g = ca.mtimes(T, ca.reshape(on_states + Wt, nz * N, 1)) + push.T
    g += ca.vertcat(0, ca.sum1(cross * t)[: N - 1].T) if N > 1 else 0
    J_t = ca.dot(on_states, t) + 0.5 * ca.dot(t, Wt)
    t_before = ca.horzcat(ca.MX.zeros(nz, 1), t[:, :-1])
    T_before = ca.horzcat(ca.MX.zeros(N, nz), T[:, :-nz])
    Y, y = [], []
    for i in range(no):
        of = [no * j + i for j in range(N)]
        Y.append(rows(T_before, o_z[:, of]) + ca.diag(o_u[i, :]))
        y.append(ca.sum1(o_z[:, of] * t_before))
    outputs = [H, g, T, t, J_t, ca.norm_inf(ca.vec(multipliers)), ca.horzcat(*Y), ca.horzcat(*y)]
    outputs = outputs if no else [*outputs[:6], ca.MX(0, 0), ca.MX(0, 0)]
    linearise = ca.Function(
        "linearise", [*problem, M], [ca.densify(v) for v in outputs],
        [*names, "M"], ["H", "g", "T", "t", "J_t", "slope", "Y", "y"],
    )  # fmt: skip
    plain = (
        ca.substitute(push + ca.sum1(B * multipliers), M, ca.MX.zeros(no, N)) if no else push + ca.sum1(B * multipliers)
    )
    gradient = ca.Function("gradient", problem, [ca.densify(plain)], names, ["g"])
    return value, linearise, gradient
