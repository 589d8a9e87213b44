"""The moment the controller takes over: trigger time, start state, what was scored before (paper, section IV)."""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
import numpy.typing as npt

from ldctoolkit.errors import InputError, nearest, plain
from ldctoolkit.metrics import COMPANION_UNITS, Companions
from ldctoolkit.option_checks import is_number
from ldctoolkit.plant_options import PlantOptions
from ldctoolkit.scenarios import SPEED_FLOOR, Scenarios, slowest_speed
from ldctoolkit.simulation.mismatch import TrueVehicles, true_vehicles
from ldctoolkit.simulation.random_streams import checked_seed
from ldctoolkit.simulation.uncorrected import UncorrectedPath
from ldctoolkit.vehicle import BicycleModel, Plant
from ldctoolkit.vehicle.speed_schedule import SPEED_RANGE

if TYPE_CHECKING:
    from ldctoolkit.simulation.tables import Tables

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
InitialYawRate = Literal["path", "zero"]

SETTLE = 3.0
"""How long [s] the loop goes on after the departure by default, to see whether it settles."""

LONGEST_SETTLE = 60.0

# a remainder shorter than this is rounding of T - t_s, not a step to be driven
_SHORTEST_STEP = 1e-12


@dataclasses.dataclass(frozen=True)
class Takeover:
    """The m triggered of n scenarios at their trigger times, sorted so that the longest control comes first.

    Attributes
    ----------
    scenarios : Scenarios
        All n.
    model : BicycleModel
        The nominal vehicle, which every design is made for.
    options : PlantOptions
        In what the plant differs from the ideal one.
    y_s : float [m]
        Trigger threshold.
    dt : float [s]
        Sample time of the controller.
    seed : int
        Of everything that is drawn.
    settle : int
        Whole samples for which the loop goes on after the departure.
    valid : (n,) bool
        Scenarios that can be driven at all.
    path : UncorrectedPath
        Recorded paths of all n.
    rows : (m,) int
        Which scenarios triggered, in the order used by every array of m.
    t_s : (n,) [s]
        Trigger time, infinite where never triggered.
    S_uncorrected : (n,) [m s]
        Score of the recorded path over the whole departure; NaN where not valid.
    S_before : (n,) [m s]
        Its part before the trigger; all of it where never triggered.
    driven : UncorrectedPath
        The m rows of `path`.
    vehicles : TrueVehicles
        What is driven, m rows.
    start : (m,) [s]
        Trigger times.
    x_0 : (m, 4)
        Start states.
    delta_0 : (m,) [rad]
        Steady steering angle of the recorded path at the trigger: the command before the first.
    full_steps : (m,) int
        Whole steps of dt until the departure ends; descending.
    rest : (m,) [s]
        What remains after them, 0 <= rest < dt.
    plant : Plant
        The nominal vehicle at the trigger speeds: what a design is prepared with.
    """

    scenarios: Scenarios
    model: BicycleModel
    options: PlantOptions
    y_s: float
    dt: float
    seed: int
    settle: int
    valid: npt.NDArray[np.bool_]
    path: UncorrectedPath
    rows: IntArray
    t_s: FloatArray
    S_uncorrected: FloatArray
    S_before: FloatArray
    driven: UncorrectedPath
    vehicles: TrueVehicles
    start: FloatArray
    x_0: FloatArray
    delta_0: FloatArray
    full_steps: IntArray
    rest: FloatArray
    plant: Plant

    @property
    def m(self) -> int:
        """Number of triggered scenarios."""
        return int(self.rows.shape[0])

    @property
    def triggered(self) -> Scenarios:
        """The m scenarios that are driven."""
        return self.driven.scenarios

    @functools.cached_property
    def tables(self) -> Tables:
        """What the compiled loops read; built once for all designs."""
        from ldctoolkit.simulation.tables import Tables

        return Tables.of(self)

    @functools.cached_property
    def recorded(self) -> Companions:
        """Companions of the recorded path, arrays of n; NaN where not valid, 0 for what only a system can cause."""
        T = self.path.scenarios.T
        measured = {
            "deepest": self.path.deepest(T),
            "dtle": -self.path.front_deepest(T, self.model.parameters.l_f),
            "t_back": T,
        }
        columns = {name: measured.get(name, np.zeros(T.size)) for name in COMPANION_UNITS}
        return Companions(**{name: np.where(self.valid, column, np.nan) for name, column in columns.items()})

    @functools.cached_property
    def deepest_before(self) -> FloatArray:
        """Deepest position of the edge before the trigger, (m,) [m]."""
        return self.driven.deepest(self.start)

    @functools.cached_property
    def front_before(self) -> FloatArray:
        """Deepest position of the front axle's edge before the trigger, (m,) [m]."""
        return self.driven.front_deepest(self.start, self.model.parameters.l_f)

    @classmethod
    def build(
        cls,
        scenarios: Scenarios,
        model: BicycleModel,
        *,
        y_s: float,
        dt: float,
        initial_yaw_rate: InitialYawRate = "path",
        options: PlantOptions | None = None,
        seed: int = 0,
        settle: float = SETTLE,
    ) -> Takeover:
        """Prepare scenarios for a trigger threshold; shared by every design with that threshold.

        Parameters
        ----------
        scenarios : Scenarios
            n departures.
        model : BicycleModel
            Vehicle, lane and convention.
        y_s : float [m]
            Trigger threshold, >= 0.
        dt : float [s]
            Sample time of the controller, > 0.
        initial_yaw_rate : {"path", "zero"}
            de_psi/dt at the trigger: that of the recorded path, (d2y/dt2)/v, or zero.
        options : PlantOptions, optional
            The ideal plant by default.
        seed : int
            Of what is drawn for each scenario.
        settle : float [s]
            How long the loop goes on after the departure, 0 to 60, rounded up to whole samples.

        Returns
        -------
        Takeover

        Raises
        ------
        InputError
            For a threshold, step or option outside what is allowed.
        """
        options = PlantOptions() if options is None else options
        y_s, dt, settle = (_number(name, value) for name, value in (("y_s", y_s), ("dt", dt), ("settle", settle)))
        _check(model, options, y_s, dt, settle, initial_yaw_rate)
        seed = checked_seed(seed)
        offset = model.parameters.edge_offset
        whole = UncorrectedPath.of(scenarios, options.residuals, seed)
        valid = drivable(whole)
        # rows that cannot be driven are carried along as a departure that never triggers
        path = whole if valid.all() else UncorrectedPath.of(_harmless(scenarios, valid), options.residuals, seed)
        t_s = path.crossing_time(y_s)
        T = path.scenarios.T
        S_uncorrected = path.area(T) + offset * T
        at_trigger = path.speed(np.minimum(t_s, T))
        valid = valid & np.isfinite(S_uncorrected) & (at_trigger <= SPEED_RANGE[1])
        triggered = valid & (t_s < T - _SHORTEST_STEP)
        t_s = np.where(triggered, t_s, np.inf)
        ended = np.minimum(t_s, T)
        S_before = np.where(triggered, path.area(ended) + offset * ended, S_uncorrected)

        remaining = np.where(triggered, T - np.where(triggered, t_s, 0.0), -1.0)
        full = np.floor(remaining / dt).astype(np.int64)
        order = np.argsort(-full, kind="stable")
        rows = order[: int(triggered.sum())]
        driven, start, full_steps = path.take(rows), t_s[rows], full[rows]
        rest = remaining[rows] - full_steps * dt
        rest = np.where(rest > _SHORTEST_STEP, rest, 0.0)

        v = driven.speed(start)
        rate, bend = driven.lateral_rate(start), driven.lateral_acceleration(start)
        yaw_error = bend / v if initial_yaw_rate == "path" else np.zeros_like(v)
        x_0 = np.column_stack([driven.lateral(start) + offset, rate, np.arctan2(rate, v), yaw_error])
        vehicles = true_vehicles(model.parameters, options.mismatch, options.tyres, driven.scenarios, seed)
        delta_0 = vehicles.steady_state(v, model.convention).delta * (v * driven.curvature(start) + bend / v)
        return cls(
            scenarios=scenarios,
            model=model,
            options=options,
            y_s=y_s,
            dt=dt,
            seed=seed,
            settle=math.ceil(settle / dt - 1e-9),
            valid=valid,
            path=path,
            rows=rows,
            t_s=t_s,
            S_uncorrected=np.where(valid, S_uncorrected, np.nan),
            S_before=np.where(valid, S_before, np.nan),
            driven=driven,
            vehicles=vehicles,
            start=start,
            x_0=x_0,
            delta_0=delta_0,
            full_steps=full_steps,
            rest=rest,
            plant=Plant.build(model, v, dt),
        )


def drivable(path: UncorrectedPath) -> npt.NDArray[np.bool_]:
    """Scenarios whose numbers are finite and have their signs, and whose speed stays where the plant and gains are."""
    p = path.scenarios
    finite = np.isfinite(p.matrix()).all(axis=1)
    with np.errstate(invalid="ignore"):
        sound = finite & (p.T > 0) & (p.d_y >= 0) & (p.sigma_y >= 0) & (p.sigma_v >= 0)
        slowest = slowest_speed(p.v_mean, p.a_mean, p.T)
        fast = sound & (slowest >= SPEED_FLOOR) & (2.0 * p.v_mean - slowest <= SPEED_RANGE[1])
    if path.modes_v.shape[1] and fast.any():
        rows = np.flatnonzero(fast)
        some = path.take(rows)
        fast[rows] = some.slowest_speed(np.zeros(rows.size), some.scenarios.T) >= SPEED_FLOOR
    return np.asarray(fast, dtype=bool)


def _harmless(scenarios: Scenarios, valid: npt.NDArray[np.bool_]) -> Scenarios:
    """The same with a flat departure in place of the rows that cannot be driven."""
    flat = {"T": 1.0, "v_mean": 20.0}
    columns = {
        field.name: np.where(valid, getattr(scenarios, field.name), flat.get(field.name, 0.0))
        for field in dataclasses.fields(scenarios)
        if field.name not in ("side", "index")
    }
    return dataclasses.replace(scenarios, **columns)


def _number(name: str, value: object) -> float:
    given = plain(value)
    if not is_number(given):
        raise InputError(f"{name}: {given!r}; allowed: a finite number")
    return float(given)


def _check(
    model: BicycleModel, options: PlantOptions, y_s: float, dt: float, settle: float, initial_yaw_rate: str
) -> None:
    if not y_s >= 0:
        raise InputError(f"y_s: {y_s!r} m; allowed: a finite number >= 0")
    if not dt > 0:
        raise InputError(f"dt: {dt!r} s; allowed: a finite number > 0")
    if not 0 <= settle <= LONGEST_SETTLE:
        raise InputError(f"settle: {settle!r} s; allowed: 0 to {LONGEST_SETTLE:g}")
    if not isinstance(options, PlantOptions):
        raise InputError(f"options: {options!r}; allowed: PlantOptions(...)")
    if initial_yaw_rate not in get_args(InitialYawRate):
        raise InputError(
            f"initial_yaw_rate: {initial_yaw_rate!r}; {nearest(str(initial_yaw_rate), get_args(InitialYawRate))}"
        )
    options.sensors.in_samples(dt)
    if model.convention != "consistent" and not options.tyres.ideal:
        raise InputError(
            f"convention: {model.convention!r} with tyres.model {options.tyres.model!r}; the printed matrix is linear; "
            "allowed: 'consistent'"
        )
