"""A ranking on other plants: scores, ranks, failures, paired differences, and stability margins over speed."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import statistics
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.clusters import cluster_error, several, with_tails_of_t
from ldctoolkit.control import EventStatus
from ldctoolkit.departures import LEFT
from ldctoolkit.plant_options import Actuator, Driver, KalmanFilter, Mismatch, PlantOptions, Residuals, Sensors, Tyres
from ldctoolkit.review import SPEEDS, design_margins
from ldctoolkit.scenarios import Scenarios
from ldctoolkit.setup import Setup
from ldctoolkit.simulation import Takeover, Window
from ldctoolkit.vehicle import Convention, VehicleModel

from .design import Design, is_paper_design
from .measures import drive_on_plants, first_of_each_side, on_model, trigger_speeds
from .ranking.design_metrics import beyond_friction, masked_mean, masked_quantile
from .ranking.inference import SAME, degrees_of_freedom, error_parts, half_widths, lengths, row_means, spread_is_known
from .ranking.verdict import Light, OtherPlants, design_name
from .results import status_among
from .standards import VEHICLES
from .storage.folder_files import read_fields, write_fields
from .storage.store import ROBUSTNESS
from .text import percent

if TYPE_CHECKING:
    from .ranking.finalists import RankedDesigns
    from .ranking.ranking import Ranking
    from .results import StudyResults


REAL: Final = PlantOptions(
    speed="profile",
    actuator=Actuator(rate_max=0.33, lag=0.1, delay=0.05),
    mismatch=Mismatch(m=(1.0, 1.3), I_z=(1.0, 1.3), C_af=(0.8, 1.2), C_ar=(0.8, 1.2)),
    tyres=Tyres(model="magic_formula", mu=0.9),
    sensors=Sensors(e_y_noise=0.03, e_psi_noise=0.003, delay=0.1, curvature_noise=2e-4, kalman=KalmanFilter()),
)
"""The plant of the catalog's study `reality`, which gives the reason for each value."""

ANGLE: Final = 0.1  # limit of the steering angle [rad]: about 90 deg at a steering wheel with a ratio of 16
FRICTION: Final = 0.5  # of a wet road or a gravel road
CAMERA_PERIOD: Final = 1 / 15  # [s] of a slow lane camera


@dataclasses.dataclass(frozen=True)
class OtherPlant:
    """A variation of the study's plant."""

    name: str  # Letters and dashes
    title: str  # A short text
    what: str  # The difference, with values and units
    options: PlantOptions
    adds: bool = True  # Whether it is harder than the study's plant; False if it is easier
    model: VehicleModel | None = None  # What is driven in place of the single track

    def setup(self, study: Setup) -> Setup:
        """The study's setup on this plant."""
        if self.model is None or self.model == study.vehicle_model:
            return dataclasses.replace(study, options=self.options, vehicle_model=self.model)
        return on_model(study, self.model)


def other_plants(options: PlantOptions) -> tuple[OtherPlant, ...]:
    """The variations of a study's plant: first the harder ones, then those with other drivers, then the easier ones."""
    seen, plants = [options], []
    for adds, rows in ((True, _harder(options)), (False, _drivers(options)), (False, _easier(options))):
        for name, title, what, changes in rows:
            changed = dataclasses.replace(options, **changes)
            if changed not in seen:
                seen.append(changed)
                plants.append(OtherPlant(name, title, what, changed, adds))
    return tuple(plants)


def impossible(plant: OtherPlant, convention: Convention, has_residuals: bool) -> str:
    """Why a plant cannot be simulated; empty where it can."""
    if convention != "consistent" and not plant.options.tyres.ideal:
        return "the matrix as printed is linear and has no saturating tyres"
    if not plant.options.residuals.ideal and not has_residuals:
        return "the departures have no residuals"
    return ""


_Row = tuple[str, str, str, dict[str, Any]]  # name, title, description, and the changed plant options
_VEHICLES: Final = {
    "heavy": ("Heavier vehicle", "mass and yaw inertia"),
    "light": ("Lighter vehicle", "mass and yaw inertia"),
    "soft": ("Softer tyres", "cornering stiffness of both axles"),
    "stiff": ("Stiffer tyres", "cornering stiffness of both axles"),
}
_ERRORS: Final = [f.name for f in dataclasses.fields(Sensors) if f.name not in ("period", "delay", "kalman")]


def _harder(options: PlantOptions) -> Iterator[_Row]:
    """Rows of plants that are harder than the study's."""
    actuator, real = options.actuator, REAL.actuator

    def with_changes(**changes: float | None) -> dict[str, Any]:
        return {"actuator": dataclasses.replace(actuator, **changes)}  # type: ignore[arg-type]

    if not actuator.delay:
        what = f"{real.delay:g} s from command to actuator"
        yield "delay", "Actuator delay", what, with_changes(delay=real.delay)
    if not actuator.lag:
        yield "lag", "Actuator lag", f"time constant of {real.lag:g} s", with_changes(lag=real.lag)
    if doubled := {
        name: min(2.0 * getattr(actuator, name), 10.0) for name in ("lag", "delay") if getattr(actuator, name)
    }:
        what = ", ".join(f"{name} of the actuator {value:g} s" for name, value in doubled.items())
        yield "slow-actuator", f"{' and '.join(doubled)} doubled".capitalize(), what, with_changes(**doubled)
    if actuator.rate_max is None and actuator.delta_max is None:
        what = f"at most {ANGLE:g} rad and {real.rate_max:g} rad/s at the front wheels"
        yield "limits", "Steering limits", what, with_changes(rate_max=real.rate_max, delta_max=ANGLE)
    for name, factors in VEHICLES.items():
        ends = [end for field in factors for end in getattr(options.mismatch, field)]
        if set(ends) == {1.0} or name in ("heavy", "soft"):
            factor = next(iter(factors.values()))
            factor = max(factor, 1.1 * max(ends)) if factor > 1.0 else min(factor, 0.9 * min(ends))  # beyond the range
            title, what = _VEHICLES[name]
            mismatch = dataclasses.replace(options.mismatch, **dict.fromkeys(factors, (factor, factor)))
            yield name, title, f"{what} times {factor:g}; the laws are not told", {"mismatch": mismatch}
    if options.tyres.ideal:
        what = f"magic formula, friction coefficient {REAL.tyres.mu:g}"
        yield "tyres", "Saturating tyres", what, {"tyres": REAL.tyres}
    mu = FRICTION if options.tyres.ideal or options.tyres.mu > FRICTION else 0.5 * options.tyres.mu
    tyres = dataclasses.replace(options.tyres, model="magic_formula", mu=mu)
    yield "friction", f"Friction {mu:g}", f"magic formula, friction coefficient {mu:g}", {"tyres": tyres}
    yield from _worse_camera(options.sensors)
    if options.speed == "frozen":
        what = "the speed follows the departure, it is not frozen at the trigger"
        yield "speed", "Speed profile", what, {"speed": "profile"}
    if options.residuals.ideal:
        what = "the recorded path and speed leave their fitted curves"
        yield "residuals", "Path residuals", what, {"residuals": Residuals(y=True, v=True)}
    if options.ideal:
        what = "the plant of the catalog\u2019s study reality: actuator, mismatch, tyres, camera with filter, speed"
        yield "together", "Many at once", what, vars(REAL)


def _worse_camera(sensors: Sensors) -> Iterator[_Row]:
    real = REAL.sensors

    def with_changes(**changes: Any) -> dict[str, Any]:
        return {"sensors": dataclasses.replace(sensors, **changes)}

    noise = {} if any(getattr(sensors, name) for name in _ERRORS) else {name: getattr(real, name) for name in _ERRORS}
    if noise:
        what = (
            f"standard deviations of {real.e_y_noise:g} m, {real.e_psi_noise:g} rad, and {real.curvature_noise:g} 1/m "
            "in the curvature"
        )
        yield "noise", "Camera noise", what, with_changes(**noise)
    delay, doubled = min(2.0 * sensors.delay, 10.0) or real.delay, " doubled" if sensors.delay else ""
    yield "camera-delay", f"Camera delay{doubled}", f"{delay:g} s from image to measurement", with_changes(delay=delay)
    slow = max(sensors.period, CAMERA_PERIOD)
    if sensors.period < slow:
        yield "camera-rate", "15 Hz camera", "15 frames a second", with_changes(period=slow)
    what = f"every second frame of a camera of {1.0 / slow:.3g} Hz is lost"
    yield "lost-frames", "Lost frames", what, with_changes(period=min(2.0 * slow, 10.0))
    if sensors.kalman is None:
        # without noise the estimates of a filter are nearly exact
        what = "it gives no rates: a Kalman filter estimates them from its numbers, with noise"
        yield "filter", "Camera with filter", what, with_changes(kalman=real.kalman, **noise)


DRIVER: Final = "driver-"  # begins the names of plants with one kind of driver
DRIVERS: Final = {
    "recorded": "steers on along the recorded path",
    "straight": "holds the wheel as it was at the trigger",
    "follows": "gives way after the reaction time",
    "against": "means to leave the lane",
    "returns": "corrects after the reaction time",
}
LEAVES: Final = "against"  # the departure is wanted: a small S is no merit of a design, and does not order designs


def _drivers(options: PlantOptions) -> Iterator[_Row]:
    """Rows of plants whose drivers are of one kind; none where nobody holds the wheel of the study's plant."""
    if not options.driver.ideal:
        yield f"{DRIVER}nobody", "Driver: nobody", "hands off the wheel", {"driver": Driver()}
        for name, what in DRIVERS.items():
            shares: dict[str, Any] = {intent: float(intent == name) for intent in DRIVERS}
            driver = dataclasses.replace(options.driver, **shares)
            yield f"{DRIVER}{name}", f"Driver: {name}", what, {"driver": driver}


def _easier(options: PlantOptions) -> Iterator[_Row]:
    """Rows of plants that lack one of the study's difficulties each."""
    sensors = options.sensors
    exact = dataclasses.replace(sensors, **{name: getattr(Sensors(), name) for name in _ERRORS})
    prompt, no_filter = dataclasses.replace(sensors, delay=0.0, period=0.0), dataclasses.replace(sensors, kalman=None)
    yield "no-actuator", "Without actuator", "the steering angle follows the command at once", {"actuator": Actuator()}
    nominal = {"tyres": Tyres(), "mismatch": Mismatch()}
    yield "nominal", "Nominal vehicle", "the vehicle is as the laws know it, with linear tyres", nominal
    yield "no-noise", "Without camera noise", "the camera has no errors", {"sensors": exact}
    yield "no-camera-delay", "Without camera delay", "a frame at every sample, without delay", {"sensors": prompt}
    yield "no-filter", "Without Kalman filter", "laws see the true rates", {"sensors": no_filter}
    yield "no-residuals", "Without residuals", "path and speed are the fitted curves", {"residuals": Residuals()}
    yield "ideal", "Ideal plant", "none of the options of the study\u2019s plant", vars(PlantOptions())


MOST: Final = 10  # designs that steer; the baseline does not count, because it costs nothing
SLOW_BATCH: Final = 100  # laws with smaller batches are too slow to be simulated on a dozen more plants


@dataclasses.dataclass(frozen=True)
class ChosenDesigns:
    """The designs that are simulated on other plants, and those that are left out."""

    # (d,) The reference first: the winner, or the first of the ranking if there is no winner. The others follow in the
    # order of the ranking
    designs: tuple[Design, ...]
    # (d,) Whether each design is ranked: those that miss a requirement are not, unless all of them do
    contends: tuple[bool, ...]
    slow: tuple[str, ...]  # Registry names of laws that take too long
    # Labels of designs whose law crashed or timed out in the study: they are not run in this process
    unsafe: tuple[str, ...]
    more: int  # Designs beyond `MOST` that were left out


def chosen_designs(ranking: Ranking) -> ChosenDesigns:
    """Winner, baseline, the paper's Table I, and the best design of each law."""
    designs, best = ranking.designs, 0 if ranking.winner is None else ranking.winner
    best_of_law = {designs[best].law: best}
    for i, design in enumerate(designs):
        best_of_law.setdefault(design.law, i)
    baseline = [] if ranking.baseline is None else [ranking.baseline]
    paper = [i for i, design in enumerate(designs) if is_paper_design(design)]
    candidates = list(dict.fromkeys([best, *baseline, *paper, *sorted(best_of_law.values())]))
    slow = dict.fromkeys(designs[i].law for i in candidates if designs[i].batch < SLOW_BATCH)
    unsafe = [i for i in candidates if ranking.metrics.crashed[i] or ranking.metrics.timed_out[i]]
    quick = [i for i in candidates if designs[i].law not in slow and i not in unsafe]
    steering = [i for i in quick if not designs[i].is_baseline]
    driven = {i for i in quick if designs[i].is_baseline} | set(steering[:MOST])
    order = sorted(driven, key=lambda i: (i != best, i))
    return ChosenDesigns(
        designs=tuple(designs[i] for i in order),
        contends=tuple(bool(ranking.rank[i]) or not ranking.ranked for i in order),
        slow=tuple(slow),
        unsafe=tuple(designs[i].label for i in unsafe),
        more=len(steering[MOST:]),
    )


def lower_ends(
    old: FloatArray, new: FloatArray, side: IntArray, confidence: float, cluster: IntArray | None = None
) -> FloatArray:
    """Lower ends of the intervals of new minus old means, of k rows on the same n scenarios, (k,) [m s].

    NaN where so few scenarios changed that equal signs may come about by chance, or a side shows no spread.
    """
    change = new - old
    changed = (np.abs(change) > SAME).sum(axis=1)
    z = statistics.NormalDist().inv_cdf(0.5 * (1.0 + confidence))
    df: FloatArray | int = degrees_of_freedom(side)
    error = lengths(error_parts(change, side))
    if (cluster := several(cluster)) is not None:
        clustered = cluster_error(change - row_means(change)[:, None], cluster)
        df, error = clustered.df, clustered.error
    half = half_widths(with_tails_of_t(z, df), error)
    fewest = 1.0 + math.log2(1.0 / (1.0 - confidence))
    unknown = (changed > 0) & ((changed < fewest) | (not spread_is_known(side)))
    return np.asarray(row_means(change) - np.where(changed == 0, 0.0, np.where(unknown, np.nan, half)))


_FORMAT: Final = 4  # raise it with every change of the numbers or of the file


PER_SIDE: Final = 50
"""Most scenarios of each side: differences are paired, so that few suffice, and a report may take only seconds."""

POINTS: Final = 7  # speeds of the margins
CONFIDENCE: Final = 0.95  # of each single interval


@dataclasses.dataclass(frozen=True)
class Robustness(OtherPlants):
    """d designs on p plants; the first plant is that of the study, the first design the reference."""

    key: str  # Identifies the inputs; see `RobustnessTask.key`
    contends: BoolArray  # (d,) Whether the design is ranked here; see `ChosenDesigns`
    slow: tuple[str, ...]  # Laws that were left out because they are too slow
    unsafe: tuple[str, ...]  # Labels of designs that were left out because their law crashed or timed out
    more: int  # Further designs that were left out
    differences: tuple[str, ...]  # (p,) Differences from the study's plant
    left_out: tuple[tuple[str, str], ...]  # Titles of plants that cannot be simulated, with reasons
    # Scenarios of each side
    left: int
    right: int
    # (2, p, d) [m s] Ends of the intervals of mean S, and of `difference`; NaN where too few scenarios differ
    S_ends: FloatArray
    difference_ends: FloatArray
    # (4, p, d) Over the interventions, NaN without a driver: mean and 95 % quantile of the driver's peak torque [N m],
    # mean time against the driver [s], share that was overridden
    felt: FloatArray
    raised: tuple[tuple[int, int, str], ...]  # Positions of plant and design, and the error, of laws that raised
    v: FloatArray  # (k,) [m/s] Speeds of the margins
    # (d, k) Gain margin on the study's plant as a factor: 0 where the loop is unstable, NaN where there is none
    gain: FloatArray
    phase: FloatArray  # (d, k) [rad] Phase margin, with the same exceptions

    @property
    def n(self) -> int:
        """Number of scenarios."""
        return self.left + self.right

    @property
    def difference(self) -> FloatArray:
        """Paired difference of mean S to the reference, (p, d) [m s]: above 0 where the design is worse."""
        return self.S - self.S[:, :1]

    def rival(self, p: int) -> int | None:
        """The ranked design with the smallest S on a plant apart from the reference; None if an S is not known."""
        S = np.where(self.contends, self.difference[p], np.nan)[1:]
        return 1 + int(np.nanargmin(S)) if np.isfinite(S).any() else None

    @property
    def behind(self) -> FloatArray:
        """Lower ends (p,) of the differences of the reference to its rivals [m s]: above 0 where these are better."""
        rivals = ((p, self.rival(p)) for p in range(len(self.plants)))
        return np.array([math.nan if i is None else -self.difference_ends[1, p, i] for p, i in rivals])

    @property
    def drivers(self) -> dict[str, int]:
        """The plants with one kind of driver other than the study's, by its name."""
        return {name.removeprefix(DRIVER): p for p, name in enumerate(self.plants) if name.startswith(DRIVER)}

    def of_mix(self, driver: Driver) -> dict[str, int]:
        """Each intent that has a share among the study's drivers, and the plant on which all have it."""
        return {name: self.drivers.get(name, 0) for name in DRIVERS if getattr(driver, name)}

    def driver_light(self, ranking: RankedDesigns, position: int, driver: Driver) -> Light | None:
        """Amber where another ranked design is first with a driver of the mix who means to stay in the lane.

        It counts if it is certain, or if by mean S the order is another than with all drivers together.
        """
        if self.designs[0] != ranking.designs[position].id:
            return None
        names = {design.id: design_name(design) for design in ranking.designs}
        leads = (top := self.rival(0)) is not None and self.difference[0, top] >= 0
        first, ahead, even, leaving = [], [], "", ""
        for intent, p in self.of_mix(driver).items():
            if intent == LEAVES:
                torque, share = float(self.felt[1, p, 0]), percent(float(self.felt[3, p, 0]), 0)
                leaving = f" With {intent} torque counts: 95 % of the peaks to {torque:.1f} N m, {share} overridden."
            elif (i := self.rival(p)) is not None:
                less, low, high = -self.difference[p, i], *-self.difference_ends[::-1, p, i]
                if low > 0 or (less > 0 and leads):
                    apart = f"{low:.3f} to {high:.3f}" if low > 0 else "not separated"
                    ahead.append(f"with {intent} {names[self.designs[i]]}, S {less:.3f} m s less ({apart})")
                else:
                    first.append(intent)
                    even = " or not separated from it" if less > 0 else even
        if ahead:
            return Light("Driver", "warning", f"Another design is first {'; '.join(ahead)}.{leaving}")
        if first:
            return Light("Driver", "good", f"First{even} with each driver of the mix: {', '.join(first)}.{leaving}")
        return Light("Driver", "unknown", f"There is nothing to compare its S with.{leaving}")


@dataclasses.dataclass(frozen=True)
class RobustnessTask:
    """All inputs that decide the numbers."""

    chosen: ChosenDesigns
    plants: tuple[OtherPlant, ...]  # That of the study first
    left_out: tuple[tuple[str, str], ...]
    scenarios: Scenarios
    setup: Setup
    window: Window  # Of S

    @classmethod
    def of(
        cls, results: StudyResults, ranking: Ranking, setup: Setup, per_side: int = PER_SIDE,
        vehicles: Sequence[str | VehicleModel] = (),
    ) -> RobustnessTask:  # fmt: skip
        """The task of a study and its ranking; vehicle models among its `vehicles` are plants too."""
        scenarios = first_of_each_side(results.scenarios.take(results.drivable), per_side)
        model = setup.vehicle_model
        has_residuals = bool((scenarios.sigma_y > 0).any() or (scenarios.sigma_v > 0).any())
        study_plant = OtherPlant(
            "study", "Study\u2019s plant", "the plant that designs were ranked on", setup.options, False, model
        )
        plants, left_out = [study_plant], []
        if model is not None:
            what = "the single track that laws are designed on, in place of the vehicle model"
            plants.append(OtherPlant("single-track", "Single track", what, setup.options, adds=False))
        for own in vehicles:
            if isinstance(own, VehicleModel) and own != model:
                name = type(own).__name__
                hands_off = "" if setup.options.driver.ideal else ", hands off the wheel"
                what = f"vehicle model {own!r} in place of the study\u2019s vehicle{hands_off}"
                if same := sum(plant.title.split()[:2] == ["Vehicle", name] for plant in plants):
                    name = f"{name} {same + 1}"
                plants.append(
                    OtherPlant(f"model-{name}".replace(" ", "-"), f"Vehicle {name}", what, setup.options, model=own)
                )
        for plant in other_plants(setup.options):
            plant = dataclasses.replace(plant, model=model)
            reason = impossible(plant, setup.convention, has_residuals)
            theirs = plant.options.mismatch, plant.options.tyres
            if model is not None and theirs != (setup.options.mismatch, setup.options.tyres):
                reason = "the vehicle model brings its own mass and tyres"
            if reason:
                left_out.append((plant.title, reason))
            else:
                plants.append(plant)
        return cls(chosen_designs(ranking), tuple(plants), tuple(left_out), scenarios, setup, ranking.window)

    @property
    def key(self) -> str:
        """Sixteen hexadecimal digits of a hash of all inputs."""
        selection = self.chosen
        identity = [
            _FORMAT,
            [[design.id, contends] for design, contends in zip(selection.designs, selection.contends, strict=True)],
            [selection.slow, selection.unsafe, selection.more],
            [dataclasses.asdict(plant) for plant in self.plants],
            dataclasses.asdict(self.setup),
            self.window,
        ]
        content = hashlib.sha256(json.dumps(identity, sort_keys=True, separators=(",", ":")).encode())
        for array in self.scenarios.arrays():
            content.update(array.tobytes())
        return content.hexdigest()[:16]


def work_out(task: RobustnessTask) -> Robustness:
    """Simulate the designs of a task on its plants, and compute their stability margins."""
    selection, setup = task.chosen, task.setup
    plants = [plant.setup(setup) for plant in task.plants]
    drives = drive_on_plants(selection.designs, plants, task.scenarios, setup, task.window)
    # means are comparable only over the same scenarios for every plant and design
    known = np.isfinite(drives.S)
    ran = np.any(known, axis=2)
    rows = np.all(known[ran], axis=0)
    S, S_uncorrected, status = drives.S[:, :, rows], drives.S_uncorrected[:, :, rows], drives.status[:, :, rows]
    mean, shape, side = _means(S), S.shape[:2], task.scenarios.side[rows]
    acted = ~status_among(status, (EventStatus.NEVER_TRIGGERED, EventStatus.INVALID)).reshape(mean.size, S.shape[2])

    def ends(values: FloatArray) -> FloatArray:
        flat, cluster = values.reshape(acted.shape), task.scenarios.take(rows).cluster
        none = np.zeros_like(flat)
        low, high = (lower_ends(*pair, side, CONFIDENCE, cluster) for pair in ((none, flat), (flat, none)))
        return np.stack([low, -high]).reshape(2, *shape)

    def felt(name: str, share: float | None = None) -> FloatArray:
        values = drives.driver[name][:, :, rows].reshape(acted.shape)
        return masked_mean(values, acted) if share is None or not rows.any() else masked_quantile(values, acted, share)

    feelings = (felt("driver_torque_peak"), felt("driver_torque_peak", 0.95), felt("against_time"), felt("overridden"))
    thresholds = dict.fromkeys(design.y_s for design in selection.designs if not design.is_baseline)
    takeovers = [Takeover.build(task.scenarios, setup, y_s=y_s) for y_s in thresholds]
    slowest, fastest = trigger_speeds(takeovers) or (SPEEDS[0], SPEEDS[-1])
    v = np.linspace(slowest, fastest, POINTS if fastest > slowest else 1)
    gain, phase = design_margins([design.controller(setup.convention) for design in selection.designs], setup, v)
    contends = np.array(selection.contends, dtype=np.bool_)
    allowed = ~np.stack([beyond_friction(task.scenarios, setup.on(plant.options)) for plant in task.plants])
    return Robustness(
        key=task.key,
        designs=tuple(design.id for design in selection.designs),
        contends=contends,
        slow=selection.slow,
        unsafe=selection.unsafe,
        more=selection.more,
        plants=tuple(plant.name for plant in task.plants),
        titles=tuple(plant.title for plant in task.plants),
        adds=tuple(plant.adds for plant in task.plants),
        differences=tuple(plant.what for plant in task.plants),
        left_out=task.left_out,
        left=int((side == LEFT).sum()),
        right=int((side != LEFT).sum()),
        S=mean,
        diverged=((status == EventStatus.DIVERGED) & allowed[:, None, rows]).sum(axis=2, dtype=np.int64),
        excess=_means(S - S_uncorrected),
        S_ends=np.maximum(ends(S), 0.0),
        difference_ends=ends(S - S[:, :1]),
        felt=np.stack(feelings).reshape(4, *shape),
        raised=drives.raised,
        v=v,
        gain=gain,
        phase=phase,
    )


def _means(values: FloatArray) -> FloatArray:
    """Means over the scenarios; NaN if there are none."""
    if not values.shape[2]:
        return np.full(values.shape[:2], np.nan)
    return row_means(values.reshape(-1, values.shape[2])).reshape(values.shape[:2])


def robustness_of(folder: Path, task: RobustnessTask) -> Robustness:
    """The numbers of a task: read from the study's folder if they are stored there, else computed and stored."""
    robustness = stored_of(folder, task)
    if robustness is None:
        write_fields(folder / ROBUSTNESS, robustness := work_out(task))
    return robustness


def stored_of(folder: Path, task: RobustnessTask) -> Robustness | None:
    """The numbers of a task in a study's folder; None if there are none, or if they belong to another task."""
    stored = read_fields(folder / ROBUSTNESS, Robustness)
    return stored if stored is not None and stored.key == task.key else None
