"""A prepared law as the exported C code takes it: gains as series over speed, and constants."""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.control import Controller, LinearLaw, LinearSteps, Preview, RecordedPath
from ldctoolkit.controllers import (
    _mpc_condensing,
    _nmpc_solver,
    _prediction_model,
    barrier_filter,
    linear_mpc,
    pid,
    predictive,
    pure_pursuit,
    sliding_mode,
    stanley,
)
from ldctoolkit.errors import InputError, LdcError
from ldctoolkit.law_checks import check_controller, check_law
from ldctoolkit.setup import Setup
from ldctoolkit.vehicle.kalman_filter import filter_columns
from ldctoolkit.vehicle.speed_schedule import SPEED_RANGE, chebyshev

UNITS: Final = {
    "F": "rad/m, rad s/m, rad/rad, rad s/rad: feedback on the state", "f_u": "rad/rad: previous command",
    "G_yaw_rate": "rad s/rad: yaw rate of the lane ahead", "G_heading": "rad/rad: heading of the lane ahead",
    "f_i": "rad/(m s): integral of e_y", "f_past": "rad/rad: commands before the previous one",
    "f_wheel": "rad/rad: angle of the wheels", "of_wheel": "rad/rad: angle of the wheels a sample later",
    "distance": "m: preview distance", "e_psi_ss": "rad s/rad: heading error of steady cornering",
    "delta_ss": "rad s/rad: steering angle of steady cornering", "slip": "rad s/rad: side slip of the front wheels",
    "c": "1/s, 1, m/s, m: sliding variable", "drift": "its change over a sample without steering",
    "cB": "m/(s rad): for a unit of steering angle", "cD": "m/rad: for a change of the lane's yaw rate",
    "centre": "of the interval of commands, from the state and two yaw rates", "half_width": "rad: half its width",
    "A": "state after a sample, row by row", "B": "for a command", "K": "LQR gain", "D": "for a change of yaw rate",
    "PD": "P D", "back": "from the costate to the feedforward", "x_ss": "steady state for a unit of yaw rate",
    "impulse": "commands after a unit correction", "project": "blocked moves from the plan",
    "moves": "blocked moves from corrections", "E_0": "for the yaw rate at the start", "E_1": "and at the end",
    "a_y": "lateral acceleration from state, command, yaw rate", "response": "of a_y (twice) and e_y to a command",
    "gain": "Kalman gain, row by row", "model_A": "as A, of the filter", "model_B": "for the younger command",
    "model_E_0": "for the yaw rate before", "model_E_1": "for the yaw rate now", "model_B_old": "for the older command",
    "model_wheel": "for the angle of the wheels", "columns": "numbers of the prediction, in the order of its layout",
    "steady": "steady cornering for a unit of yaw rate: states, steering angle",
}  # fmt: skip
"""Units and meaning of the gains that are scheduled over speed."""


@dataclasses.dataclass(frozen=True)
class LawForm:
    """A law at n speeds."""

    law: str  # Section of the C code
    gains: dict[str, FloatArray]  # (n, k) each
    times: FloatArray  # (p,) [s] Lookahead times
    constants: dict[str, Any] = dataclasses.field(default_factory=dict)
    sent: int = 1  # Commands that it looks back on
    heading: bool = False  # It sees the heading of the lane ahead
    barrier: float = 0.0  # [rad] Limit of the barrier filter around it; 0 for no filter
    mpc: dict[str, Any] | None = None  # Sizes of a linear MPC
    sqp: dict[str, Any] | None = None  # Sizes and tables of another predictive controller
    functions: tuple[Any, ...] = ()  # Its CasADi functions
    conditioned: bool = False  # It has an integral that stops while the assist yields


def law_form(law: object, dt: float, name: str) -> LawForm:
    """The form of a prepared law; raises `InputError` for one that has no C code."""
    if isinstance(law, LinearSteps):
        inner = law_form(law.law, dt, name)
        if law.law.f_wheel is None:
            return inner
        sent, gains = max(inner.sent, law.whole + 2), inner.gains | {"of_wheel": law.wheel}
        return dataclasses.replace(inner, gains=gains, constants={"whole": law.whole}, sent=sent)
    if isinstance(law, LinearLaw):
        optional = {"G_heading": law.G_heading, "f_i": law.f_i, "f_past": law.f_past, "f_wheel": law.f_wheel}
        gains, times = {"F": law.F, "f_u": _wide(law.f_u), "G_yaw_rate": law.G_yaw_rate}, law.preview_times
        gains |= {key: _wide(value) for key, value in optional.items() if value is not None}
        if not times.size:  # C has no empty arrays: a look at the lane that weighs nothing
            gains["G_yaw_rate"], times = np.zeros((law.F.shape[0], 1)), np.zeros(1)
            gains.pop("G_heading")
        sent, stops = 1 + (0 if law.f_past is None else law.f_past.shape[1]), law.conditioned and law.f_i is not None
        return LawForm("linear", gains, times, sent=sent, conditioned=stops)
    if isinstance(law, barrier_filter.BarrierLaw):
        inner = law_form(law.inner, dt, law.inner_name)
        gains = {"centre": law.centre, "half_width": _wide(law.half_width)} | inner.gains
        return dataclasses.replace(inner, gains=gains, times=law.preview_times, barrier=law.delta_max)
    if isinstance(law, linear_mpc.MPCLaw):
        return _mpc_form(law)
    if isinstance(law, predictive.PredictiveLaw):
        return _predictive_form(law, name)
    if isinstance(law, pid.PIDLaw | stanley.StanleyLaw | sliding_mode.SlidingModeLaw | pure_pursuit.PurePursuitLaw):
        constants: dict[str, Any] = {gain.name: getattr(law.design, gain.name) for gain in law.design.gains()}
        if isinstance(law, pid.PIDLaw):
            section, names = "pid", ["distance", "e_psi_ss", "delta_ss"]
            constants["share"] = -math.expm1(-dt / law.design.T_t)
        elif isinstance(law, stanley.StanleyLaw):
            section, names, constants["l_f"] = "stanley", ["slip"], law.l_f
        elif isinstance(law, sliding_mode.SlidingModeLaw):
            section, names = "sliding_mode", ["c", "drift", "cB", "cD", "e_psi_ss", "delta_ss"]
        else:
            section, names = "pure_pursuit", []
            constants |= {"L": law.L, "l_r": law.l_r, "step": law.preview_times[1]}
        gains = {key: _wide(getattr(law, key)) for key in names}
        heading, stops = section == "pure_pursuit", bool(constants.get("conditioned"))
        return LawForm(section, gains, law.preview_times, constants, sent=2, heading=heading, conditioned=stops)
    what = "never steers" if isinstance(law, RecordedPath) else f"prepares a {type(law).__name__}, which has no C code"
    allowed = "a law that prepares a LinearLaw, pid, stanley, pure_pursuit, sliding_mode, barrier_filter, an MPC"
    raise InputError("law", f"cannot be exported, it {what}", value=name, allowed=allowed)


def _mpc_form(law: linear_mpc.MPCLaw) -> LawForm:
    c, limits, N, M = law.condensed, law.limits, law.horizon, law.limits.start.size
    n, m = c.B.shape[:2]
    kinds = [_mpc_condensing.SOFT[k] for k in np.flatnonzero(limits.scale)]
    # corrections may count either way: one way at every speed
    signs = np.sign(np.einsum("nii->ni", c.moves))[:, None, :]
    blocked = {"impulse": c.impulse}
    if M < N:  # what is 0 but for rounding follows no series
        blocked = {"project": np.where(np.abs(c.project) < 1e-13, 0.0, c.project), "moves": np.triu(c.moves * signs)}
    soft = {"E_0": c.E_0, "E_1": c.E_1} if kinds or limits.delay else {}
    if kinds:
        soft |= {"a_y": c.a, "response": c.response}
    gains = {
        "A": c.A, "B": c.B, "K": c.K, "D": c.D, "PD": c.PD, "back": c.back, "x_ss": c.x_ss, "delta_ss": c.delta_ss,
        **blocked, **soft,
    }  # fmt: skip
    first = [int(np.argmax(limits.group == k)) for k in np.flatnonzero(limits.scale)]
    sizes = {
        "N": N, "M": M, "m": m, "delay": limits.delay, "window": limits.window, "kinds": kinds, "sides": limits.sides,
        "rows": limits.group.size, "lagging": law.lagging, "age": law.age / law.dt, "first": first,
        "start": limits.start.tolist(), "root": reals(np.sqrt(limits.weight[limits.scale > 0])),
        "iterations": 10 * (M + len(kinds) + limits.group.size),
    }  # fmt: skip
    constants = {"delta_max": limits.delta_max, "rate_step": limits.rate_step, "window_share": limits.share}
    constants |= {f"{kind}_scale": limits.scale[k] for k, kind in enumerate(_mpc_condensing.SOFT)}
    wide = {key: value.reshape(n, -1) for key, value in gains.items()}
    return LawForm("mpc", wide, law.preview_times, constants, sent=limits.delay + 1, mpc=sizes)


def _predictive_form(law: predictive.PredictiveLaw, name: str) -> LawForm:
    form, N, moves = law.form, law.horizon, _mpc_condensing.block_starts(law.horizon, law.design.move_blocks)
    nx, window, functions = law.steady.shape[1] - 1, _mpc_condensing.jerk_window(law.plant.dt)[0], _functions(form, N)
    angles = [4 + i for i, own in enumerate(form.own) if own == "wheel"]
    sqp: dict[str, Any] = {
        "N": N, "M": moves.size, "nz": form.size, "nx": nx, "nc": form.layout.size, "own": len(form.own),
        "delay": law.delay, "window": window, "outputs": form.outputs, "kinds": len(form.soft),
        "most": law.most, "programs": law.most or _nmpc_solver.MAX_ITERATIONS,
        "iterations": 4 * (3 * moves.size + N * len(form.soft)), "quadratic": form.quadratic and not form.soft,
        "nonlinear": bool(form.nonlinear_rows), "wheel": sum(angles), "angles": [*angles, *[nx] * form.previous],
        "age": c_number(law.plant.age / law.plant.dt) if law.plant.age else "", "blocks": moves.size < N,
        "first": moves.tolist(), "move_of": (np.searchsorted(moves, np.arange(N), side="right") - 1).tolist(),
        "initial": _initial(law, name),
        **{key.lower(): getattr(_prediction_model, key) for key in ("SHAPE", "GRAVITY", "SATURATED", "TURNED")},
        "functions": [function.name() for function in functions], "work": max(f.sz_w() for f in functions),
        "terms": 1, "output_of": "", "share_of": "",
    }  # fmt: skip
    if law.rows is not None:
        weights, past = law.rows.rows.reshape(-1, form.outputs, N), law.rows.before
        # the outputs of a sample are side by side
        weights = np.concatenate([weights.transpose(0, 2, 1).reshape(len(past), -1), past], axis=1)
        terms = int((weights != 0.0).sum(axis=1).max())
        places = np.argsort(weights == 0.0, axis=1, kind="stable")[:, :terms]
        shares = np.take_along_axis(weights, places, axis=1)
        sqp |= {"terms": terms, "output_of": _rows(places), "share_of": _rows(shares)}
    parts = form.layout.unpack(law.columns.T).values()
    columns = np.concatenate([_without_rounding(part, 1e-15) for part in parts])
    gains = {"columns": columns.T, "steady": _without_rounding(law.steady.T, 1e-12).T}
    return LawForm("predictive", gains, law.preview_times, sent=law.delay + 1, sqp=sqp, functions=functions)


def _rows(values: npt.NDArray[Any]) -> str:
    """Rows of a table of C, each with a comma behind it."""
    lines = (", ".join(c_number(x) if isinstance(x, float) else str(x) for x in row) for row in values.tolist())
    return "".join(f"{{ {line} }},\n    " for line in lines)


def _without_rounding(part: FloatArray, share: float) -> FloatArray:
    """Columns (k, n) without what is 0 but for rounding, which follows no series."""
    return np.where(np.abs(part) < share * np.abs(part).max(axis=0, initial=0.0), 0.0, part)


@functools.lru_cache(maxsize=8)
def _functions(form: Any, N: int) -> tuple[Any, ...]:
    """Functions of one sample, dense."""
    import casadi as ca

    program = form.program(N)
    functions = [program.predict, form.limit]
    for parent, name in (
        (program.roll, "roll_one"), (program.value, "value_one"), (program.value, "end"),
        (program.linearise, "slopes_one"), (program.linearise, "bend_one"),
    ):  # fmt: skip
        functions.append(parent.find_function(name))
    result = []
    for function in functions:
        inputs = function.sx_in()
        outputs = [ca.densify(value) for value in function.call(inputs)]
        result.append(ca.Function(f"ldc_{function.name()}", inputs, outputs))
    return tuple(result)


def generated(functions: tuple[Any, ...]) -> str:
    """CasADi's C code of functions."""
    import casadi as ca

    generator = ca.CodeGenerator(
        "ldc_predictions", {"with_export": False, "casadi_int": "int", "casadi_real": "double"}
    )
    for function in functions:
        generator.add(function)
    return str(generator.dump())


def _initial(law: predictive.PredictiveLaw, name: str) -> str:
    """States of the class at the departure: rows of a constant, and weights of state and steering angle."""
    probes = np.concatenate([np.zeros((1, 5)), np.eye(5), np.sin(np.arange(1.0, 16.0)).reshape(3, 5)])
    own = np.full((len(probes), len(law.form.own)), np.nan)
    law.see_own(own, probes[:, :4], Preview(np.zeros((len(probes), 0)), np.zeros((len(probes), 0))), probes[:, 4])
    rows = np.concatenate([own[:1], own[1:6] - own[0]])
    if not np.allclose(own[6:], rows[0] + probes[6:] @ rows[1:], rtol=1e-9, atol=1e-12):
        raise InputError("law", "cannot be exported, its initial() is not linear in x and delta", value=name)
    return _rows(rows.T)


def _wide(values: FloatArray) -> FloatArray:
    """Values of one column as (n, 1)."""
    return values if values.ndim == 2 else values[:, None]


def reals(values: FloatArray) -> str:
    """Numbers as C writes them, in its working precision."""
    return ", ".join(f"LDC_W({c_number(value)})" for value in values.tolist())


def c_number(value: float) -> str:
    """A number as C writes a floating constant; what single precision takes for 0 is 0."""
    text = repr(float(value)) if abs(value) > 1e-30 else "0.0"
    return text if "." in text or "e" not in text else text.replace("e", ".0e")


@dataclasses.dataclass(frozen=True)
class Gains:
    """The gains of a design at speeds (n,), side by side (n, k); the filter's too where the setup has one."""

    controller: Controller
    setup: Setup

    def form(self, v: FloatArray) -> LawForm:
        """The law at these speeds."""
        plant = self.setup.plant(v)
        law = check_law(check_controller(self.controller).prepare(plant), plant.n, self.controller.name)
        return law_form(law, self.setup.dt, self.controller.name)

    def blocks(self, v: FloatArray) -> dict[str, FloatArray]:
        """Every gain by its name."""
        gains, sensors = dict(self.form(v).gains), self.setup.options.sensors
        if sensors.kalman is not None:
            columns = filter_columns(self.setup.plant(v), sensors.kalman, max(1, round(sensors.period / self.setup.dt)))
            names = ("gain", "model_A", "model_B", "model_E_0", "model_E_1", "model_B_old", "model_wheel")
            gains |= dict(zip(names, np.split(columns, (8, 24, 28, 32, 36, 40), axis=1), strict=True))
        return gains

    def __call__(self, v: FloatArray) -> FloatArray:
        """As `chebyshev` takes it."""
        return np.concatenate(list(self.blocks(v).values()), axis=1)


_NO_PIECES: Final = (np.zeros(0), np.zeros((0, 0, 0)))
_TERMS: Final = 17  # Of a piece, at most
_SHARE: Final = 1e-9  # Largest error of a table, as a share of the largest value of its gain


def _fitted(gains: Gains, kinked: IntArray, low: FloatArray, high: FloatArray) -> tuple[FloatArray, ...]:
    """Chebyshev series on m intervals of speed, (m, terms, k), and samples: speeds (m, s) and gains (m, s, k)."""
    nodes = np.cos(np.pi * (2 * np.arange(_TERMS) + 1) / (2 * _TERMS))
    share = 0.5 * (1.0 + np.append(nodes, np.cos(np.pi * np.arange(_TERMS + 1) / _TERMS)))  # the ends too
    v = np.clip(low[:, None] + (high - low)[:, None] * share, low[:, None], high[:, None])
    values = gains(v.ravel())[:, kinked].reshape(*v.shape, -1)
    weights = np.polynomial.chebyshev.chebvander(nodes, _TERMS - 1) * (2.0 / _TERMS)
    weights[:, 0] /= 2.0
    return np.einsum("ij,mik->mjk", weights, values[:, :_TERMS]), v, values


def _value(series: FloatArray, low: float, high: float, v: FloatArray) -> FloatArray:
    """Values of Chebyshev series over [low, high] at speeds v."""
    z = 2.0 * (v - low) / max(high - low, 1e-300) - 1.0
    return np.asarray(np.polynomial.chebyshev.chebval(z, series).T)


def _in_pieces(gains: Gains, kinked: IntArray, size: FloatArray, what: str) -> tuple[FloatArray, FloatArray]:
    """Knots (p + 1,) [m/s] and series over v between them (p, terms, k); kinks and steps are found by bisection."""

    def gap(series: FloatArray, v: FloatArray, values: FloatArray, low: float, high: float) -> float:
        difference = _value(series, low, high, v.ravel()) - values.reshape(-1, kinked.size)
        return float((np.abs(difference) / size).max())

    low = np.arange(*SPEED_RANGE)
    high = np.append(np.nextafter(low[1:], 0.0), SPEED_RANGE[1])
    most, accepted = 2 * low.size, []
    while low.size:  # until at the latest an interval is a single number: both sides of a step are exact
        fits = (*_fitted(gains, kinked, low, high), low, high)
        # close to each kink
        good = np.array([gap(*interval) <= 2e-3 * _SHARE for interval in zip(*fits, strict=True)])
        accepted.append([part[good] for part in fits])
        low, high = low[~good], high[~good]
        if low.size > most:
            raise LdcError(what, "change too sharply with speed to be exported")
        middle = np.maximum(0.5 * (low + high), np.nextafter(low, np.inf))
        low, high = np.append(low, middle), np.append(np.nextafter(middle, 0.0), high)
    order = np.argsort(np.concatenate([low for *_, low, _ in accepted]))
    every, v, values, low, high = (np.concatenate(parts)[order] for parts in zip(*accepted, strict=True))
    knots, pieces, i = [], [], 0
    while i < low.size:  # as many neighbours as one series follows are one piece
        piece, end, most = every[i], i + 1, low.size
        while end < most:
            j = (end + most + 1) // 2
            joined = _fitted(gains, kinked, low[i : i + 1], high[j - 1 : j])[0][0]
            if gap(joined, v[i:j], values[i:j], low[i], high[j - 1]) <= 0.1 * _SHARE:
                piece, end = joined, j
            else:
                most = j - 1
        knots.append(low[i])
        pieces.append(piece)
        i = end
    return np.array([*knots, SPEED_RANGE[1]]), _trimmed(np.array(pieces))


def _trimmed(series: FloatArray) -> FloatArray:
    """Without coefficients (p, terms, k) that are nothing but rounding, and without terms that have no other."""
    significant = np.abs(series) > 1e-13 * np.abs(series).max(axis=(0, 1))
    terms = int(np.flatnonzero(significant.any(axis=(0, 2))).max(initial=0)) + 1
    return np.where(significant, series, 0.0)[:, :terms]


@dataclasses.dataclass(frozen=True)
class Schedule:
    """Gains over speed, a column for each: series of Chebyshev polynomials over log v, or, where these do not converge
    because of kinks and steps, over v in pieces.
    """

    form: LawForm  # At the fastest speed
    sizes: dict[str, int]  # Columns of each gain
    coefficients: FloatArray  # (terms, k)
    error: float  # Largest against the exact gains, as a share of the largest value of each
    kinked: IntArray  # (j,) Columns in pieces
    knots: FloatArray  # (p + 1,) [m/s]
    pieces: FloatArray  # (p, terms, j)

    @classmethod
    def of(cls, controller: Controller, setup: Setup) -> Schedule:
        """Raises `InputError` for a law that has no C code, `LdcError` for gains that no table follows."""
        gains = Gains(controller, setup)
        ends = np.array(SPEED_RANGE)  # a pursuit looks ahead furthest at one of them
        form = gains.form(ends)
        sizes = {name: values.shape[1] for name, values in gains.blocks(ends).items()}
        if not sizes:
            return cls(form, sizes, np.zeros((0, 0)), 0.0, np.zeros(0, dtype=np.int64), *_NO_PIECES)
        what = f"gains of {controller.name!r}"
        v = np.geomspace(*SPEED_RANGE, 997)
        exact, (series, smooth) = gains(v), chebyshev(gains)
        size = np.maximum(np.abs(exact).max(axis=0), 1e-300)
        fitted = _value(series, -1.0, 1.0, np.linspace(-1.0, 1.0, v.size))
        rough = ~smooth | (np.abs(fitted - exact).max(axis=0) > _SHARE * size)
        kinked = np.flatnonzero(rough)
        knots, pieces = _in_pieces(gains, kinked, size[kinked], what) if kinked.size else _NO_PIECES
        for piece, low, high in zip(pieces, knots[:-1], knots[1:], strict=True):
            inside = (v >= low) & (v <= high)
            fitted[np.ix_(inside, kinked)] = _value(piece, low, high, v[inside])
        error = float((np.abs(fitted - exact) / size).max())
        if error > _SHARE:
            raise LdcError(what, "change too sharply with speed to be exported")
        for name in ("G_heading", "f_i", "f_past", "f_wheel"):  # what is 0 at every speed needs no code
            columns = np.repeat(list(sizes), list(sizes.values())) == name
            if columns.any() and not series[:, columns].any():
                series, rough = series[:, ~columns], rough[~columns]
                del sizes[name]
        form = dataclasses.replace(form, heading=form.heading or "G_heading" in sizes)
        series = _trimmed(np.where(rough, 0.0, series)[None])[0]
        return cls(form, sizes, series, error, np.flatnonzero(rough), knots, pieces)
