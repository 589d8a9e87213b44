"""What other plants do to a ranking: scores, ranks, failures and paired changes, and margins over speed."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import statistics
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, get_type_hints

import numpy as np
import numpy.typing as npt

import ldctoolkit
from ldctoolkit import EventStatus, Scenarios, Setup
from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.departures import LEFT
from ldctoolkit.errors import StoreError
from ldctoolkit.plant_options import Actuator, KalmanFilter, Mismatch, PlantOptions, Residuals, Sensors, Tyres
from ldctoolkit.review import SPEEDS, design_margins
from ldctoolkit.simulation import Takeover
from ldctoolkit.vehicle import Convention

from .design import Design, is_paper_design
from .ranking.inference import (
    degrees_of_freedom,
    error_parts,
    half_widths,
    lengths,
    row_means,
    spread_is_known,
    with_tails_of_t,
)
from .ranking.named_vehicles import drive_on_plants, first_of_each_side
from .ranking.verdict import OtherPlants
from .results import FAILED_STATUSES, Case, status_among
from .storage.files import read_json, write_text

if TYPE_CHECKING:
    from .ranking.ranking import Ranking
    from .results import StudyResults


REAL: Final = PlantOptions(
    speed="profile",
    actuator=Actuator(rate_max=0.33, lag=0.1, delay=0.05),
    mismatch=Mismatch(m=(1.0, 1.3), I_z=(1.0, 1.3), C_af=(0.8, 1.2), C_ar=(0.8, 1.2)),
    tyres=Tyres(model="magic_formula", mu=0.9),
    sensors=Sensors(e_y_noise=0.03, e_psi_noise=0.003, delay=0.1, curvature_noise=2e-4, kalman=KalmanFilter()),
)
"""The plant of the catalog's study `reality`, where the reason for each value stands."""

ANGLE: Final = 0.1  # limit of the steering angle [rad]: about 90 deg at a steering wheel with a ratio of 16
LIGHT: Final = 0.85  # factor on mass and yaw inertia of a vehicle that is lighter than the laws know it


@dataclasses.dataclass(frozen=True)
class OtherPlant:
    """A plant to drive on."""

    name: str  # Letters and dashes
    title: str  # A short text
    what: str  # What is different, with values and units
    options: PlantOptions


def other_plants(options: PlantOptions) -> tuple[OtherPlant, ...]:
    """The variations of a study's plant; an option that it has already is taken away."""
    plants = [*_actuator(options), *_mismatch(options), *_tyres(options), *_camera(options), *_departure(options)]
    if options.ideal:
        what = "the plant of the catalog\u2019s study reality: actuator, mismatch, tyres, camera with filter, speed"
        plants.append(OtherPlant("together", "Many at once", what, REAL))
    else:
        plants.append(
            OtherPlant("ideal", "Ideal plant", "none of the options of the study\u2019s plant", PlantOptions())
        )
    return tuple(plants)


def impossible(plant: OtherPlant, convention: Convention, has_residuals: bool) -> str:
    """Why a plant cannot be driven on; empty where it can."""
    if convention != "consistent" and not plant.options.tyres.ideal:
        return "the matrix as printed is linear and has no saturating tyres"
    if not plant.options.residuals.ideal and not has_residuals:
        return "the departures have no residuals"
    return ""


def _with(options: PlantOptions, name: str, title: str, what: str, **parts: object) -> OtherPlant:
    return OtherPlant(name, title, what, dataclasses.replace(options, **parts))  # type: ignore[arg-type]


def _actuator(options: PlantOptions) -> Iterator[OtherPlant]:
    own, real = options.actuator, REAL.actuator
    delay, lag = (0.0 if own.delay else real.delay), (0.0 if own.lag else real.lag)
    what = f"{delay:g} s from command to actuator" if delay else "no delay"
    yield _with(options, "delay", "Actuator delay", what, actuator=dataclasses.replace(own, delay=delay))
    what = f"time constant of {lag:g} s" if lag else "no lag"
    yield _with(options, "lag", "Actuator lag", what, actuator=dataclasses.replace(own, lag=lag))
    if own.rate_max is None and own.delta_max is None:
        limited = dataclasses.replace(own, rate_max=real.rate_max, delta_max=ANGLE)
        what = f"at most {ANGLE:g} rad and {real.rate_max:g} rad/s at the front wheels"
    else:
        limited, what = dataclasses.replace(own, rate_max=None, delta_max=None), "no limits of angle and rate"
    yield _with(options, "limits", "Steering limits", what, actuator=limited)


def _mismatch(options: PlantOptions) -> Iterator[OtherPlant]:
    own, heavy, soft_stiff = options.mismatch, REAL.mismatch.m[1], REAL.mismatch.C_af
    none = (1.0, 1.0)
    if (own.m, own.I_z) == (none, none):
        for name, title, factor in (("heavy", "Heavier vehicle", heavy), ("light", "Lighter vehicle", LIGHT)):
            pair = (factor, factor)
            what = f"mass and yaw inertia times {factor:g}; laws do not know"
            yield _with(options, name, title, what, mismatch=dataclasses.replace(own, m=pair, I_z=pair))
    else:
        mismatch = dataclasses.replace(own, m=none, I_z=none)
        yield _with(options, "mass", "Mass as known", "mass and yaw inertia as the laws know them", mismatch=mismatch)
    if (own.C_af, own.C_ar) == (none, none):
        for name, title, factor in zip(("soft", "stiff"), ("Softer tyres", "Stiffer tyres"), soft_stiff, strict=True):
            pair = (factor, factor)
            what = f"cornering stiffness of both axles times {factor:g}; laws do not know"
            yield _with(options, name, title, what, mismatch=dataclasses.replace(own, C_af=pair, C_ar=pair))
    else:
        mismatch = dataclasses.replace(own, C_af=none, C_ar=none)
        yield _with(options, "stiffness", "Stiffness as known", "cornering stiffness as the laws know it",
                    mismatch=mismatch)  # fmt: skip


def _tyres(options: PlantOptions) -> Iterator[OtherPlant]:
    if options.tyres.ideal:
        what = f"magic formula, friction coefficient {REAL.tyres.mu:g}"
        yield _with(options, "tyres", "Saturating tyres", what, tyres=REAL.tyres)
    else:
        mismatch = dataclasses.replace(options.mismatch, mu=(1.0, 1.0))  # linear tyres have no friction coefficient
        yield _with(options, "tyres", "Linear tyres", "tyres do not saturate", tyres=Tyres(), mismatch=mismatch)


def _camera(options: PlantOptions) -> Iterator[OtherPlant]:
    own, real, ideal = options.sensors, REAL.sensors, Sensors()
    timing = {"period", "delay", "kalman"}
    errors = [field.name for field in dataclasses.fields(Sensors) if field.name not in timing]
    if any(getattr(own, name) for name in errors):
        sensors, what = dataclasses.replace(own, **{name: getattr(ideal, name) for name in errors}), "no errors"
    else:
        sensors = dataclasses.replace(own, **{name: getattr(real, name) for name in errors})
        what = (
            f"standard deviations of {real.e_y_noise:g} m, {real.e_psi_noise:g} rad, and {real.curvature_noise:g} 1/m "
            "in the curvature"
        )
    yield _with(options, "noise", "Camera noise", what, sensors=sensors)
    delay = 0.0 if own.delay or own.period else real.delay
    sensors = dataclasses.replace(own, delay=delay, period=0.0)
    what = f"{delay:g} s from light to number" if delay else "frames at every sample, at once"
    yield _with(options, "camera-delay", "Camera delay", what, sensors=sensors)
    if own.kalman is None:
        # without noise a filter knows the state as well as the laws do
        sensors = dataclasses.replace(own, kalman=real.kalman, **{name: getattr(real, name) for name in errors})
        what = "it gives no rates: a Kalman filter estimates them from its numbers with the noise above"
        yield _with(options, "filter", "Camera with filter", what, sensors=sensors)
    else:
        sensors = dataclasses.replace(own, kalman=None)
        yield _with(options, "filter", "No Kalman filter", "laws see the true rates", sensors=sensors)


def _departure(options: PlantOptions) -> Iterator[OtherPlant]:
    if options.speed == "frozen":
        what = "the speed follows the departure, it is not frozen at the trigger"
        yield _with(options, "speed", "Speed profile", what, speed="profile")
    else:
        yield _with(options, "speed", "Frozen speed", "the speed of the trigger stays", speed="frozen")
    if options.residuals.ideal:
        what = "the recorded path and speed leave their fitted curves"
        yield _with(options, "residuals", "Residuals", what, residuals=Residuals(y=True, v=True))
    else:
        yield _with(options, "residuals", "No residuals", "path and speed are the fitted curves", residuals=Residuals())


MOST: Final = 10  # designs that steer; no control comes on top, it costs nothing
SLOW_BATCH: Final = 100  # a law whose batches are smaller takes too long to be driven a dozen times more


@dataclasses.dataclass(frozen=True)
class ChosenDesigns:
    """What is driven, and what is not."""

    # d of them, the reference first: the winner, or where there is none the first of the ranking. Then the others in
    # the order of the ranking
    designs: tuple[Design, ...]
    # Whether each has a rank among the others: not if it misses a requirement, unless all do
    contends: tuple[bool, ...]
    slow: tuple[str, ...]  # Registry names of laws that take too long
    # Labels of designs whose law ended or held up its process in the study: they are not run in this one
    unsafe: tuple[str, ...]
    more: int  # Designs beyond `MOST` that were left out


def chosen_designs(ranking: Ranking) -> ChosenDesigns:
    """Winner, baseline, the paper's Table I, and the best design of each law."""
    places = list(dict.fromkeys(_places(ranking)))
    of = {place: ranking.designs[place] for place in places}
    slow = dict.fromkeys(of[place].law for place in places if of[place].batch < SLOW_BATCH)
    unsafe = [place for place in places if ranking.crashed[place] or ranking.timed_out[place]]
    quick = [place for place in places if of[place].law not in slow and place not in unsafe]
    steering = [place for place in quick if not of[place].is_baseline]
    kept = {place for place in quick if of[place].is_baseline} | set(steering[:MOST])
    first = [place for place in places[:1] if place in kept]
    order = [*first, *sorted(kept - set(first))]
    anything = ranking.ranked > 0
    return ChosenDesigns(
        designs=tuple(of[place] for place in order),
        contends=tuple(bool(ranking.rank[place]) or not anything for place in order),
        slow=tuple(slow),
        unsafe=tuple(of[place].label for place in unsafe),
        more=len(steering[MOST:]),
    )


def _places(ranking: Ranking) -> list[int]:
    """Positions in the ranking, the most wanted first."""
    best = 0 if ranking.winner is None else ranking.winner
    first_of_law: dict[str, int] = {ranking.designs[best].law: best}
    for place, design in enumerate(ranking.designs):
        first_of_law.setdefault(design.law, place)
    paper = [place for place, design in enumerate(ranking.designs) if is_paper_design(design)]
    baseline = [] if ranking.baseline is None else [ranking.baseline]
    return [best, *baseline, *paper, *sorted(first_of_law.values())]


SAME = 1e-6  # scores [m s] that differ by less are the same


def paired_means(
    old: FloatArray, new: FloatArray, side: IntArray, confidence: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """New minus old of k rows on the same n scenarios: differences of means and their intervals, (k,) [m s] each."""
    change = new - old
    changed = (np.abs(change) > SAME).sum(axis=1)
    difference = row_means(change)
    z = statistics.NormalDist().inv_cdf(0.5 * (1.0 + confidence))
    critical = with_tails_of_t(z, degrees_of_freedom(side))
    half = half_widths(critical, lengths(error_parts(change, side)))
    fewest = 1.0 + math.log2(1.0 / (1.0 - confidence))
    unknown = (changed > 0) & ((changed < fewest) | (not spread_is_known(side)))
    half = np.where(changed == 0, 0.0, np.where(unknown, np.nan, half))
    return difference, difference - half, difference + half


_FORMAT: Final = 2  # to be raised with whatever changes the numbers or the file


PER_SIDE: Final = 50
"""Scenarios of each side, at most: changes are paired, so that few tell much, and what a report may cost is seconds."""

POINTS: Final = 7  # speeds of the margins
CONFIDENCE: Final = 0.95  # of every interval by itself


@dataclasses.dataclass(frozen=True)
class Robustness(OtherPlants):
    """Designs on p plants; the first plant is the study's own, the first of d designs the reference."""

    key: str  # What it was worked out from; see `RobustnessTask.key`
    contends: BoolArray  # (d,) Whether the design is ranked here; see `ChosenDesigns`
    slow: tuple[str, ...]  # Laws that were left out because they take too long
    unsafe: tuple[str, ...]  # Labels of designs that were left out because their law ended or held up its process
    more: int  # Further designs that were left out
    differences: tuple[str, ...]  # What differs from the study's plant, p
    left_out: tuple[tuple[str, str], ...]  # Plants that cannot be driven on
    # Scenarios of each side
    left: int
    right: int
    S_uncorrected: FloatArray  # (p, d) [m s]
    rank: IntArray  # (p, d) By mean S among the designs that contend; 0 for the others
    failures: IntArray  # (p, d) Scenarios that failed
    # (p, d) [m s] Paired change of mean S to the study's plant, and its interval. The interval is NaN where too few
    # scenarios changed, the change too where the law raised
    change: FloatArray
    low: FloatArray
    high: FloatArray
    # (p, d) [m s] Interval of `excess`; NaN as above
    excess_low: FloatArray
    excess_high: FloatArray
    rival: IntArray  # (p,) The best of the other designs that contend; -1 where there is none
    # (p,) [m s] Paired difference of the reference to `rival`, below 0 where the reference is better, and its interval.
    # NaN without a rival
    lead: FloatArray
    lead_low: FloatArray
    lead_high: FloatArray
    raised: tuple[tuple[int, int, str], ...]  # By position: laws that raised
    v: FloatArray  # (k,) [m/s] Speeds of the margins
    # (d, k) Gain margin on the study's plant, a factor: 0 where the loop is unstable, NaN for a law that is not linear
    gain: FloatArray
    phase: FloatArray  # (d, k) [rad] Phase margin, the same

    @property
    def n(self) -> int:
        """Number of scenarios."""
        return self.left + self.right


@dataclasses.dataclass(frozen=True)
class RobustnessTask:
    """Everything that the numbers follow from."""

    chosen: ChosenDesigns
    plants: tuple[OtherPlant, ...]  # The study's own first
    left_out: tuple[tuple[str, str], ...]
    scenarios: Scenarios
    setup: Setup  # In the convention of the case
    case: Case

    @classmethod
    def of(cls, results: StudyResults, ranking: Ranking, setup: Setup, per_side: int = PER_SIDE) -> RobustnessTask:
        """The task that a study sets."""
        setup = setup.under(ranking.case.convention)
        scenarios = first_of_each_side(results.drivable().scenarios, per_side)
        has_residuals = bool((scenarios.sigma_y > 0).any() or (scenarios.sigma_v > 0).any())
        own = OtherPlant("study", "Study\u2019s plant", "the plant that designs were ranked on", setup.options)
        plants, left_out = [own], []
        for plant in other_plants(setup.options):
            reason = impossible(plant, setup.convention, has_residuals)
            if reason:
                left_out.append((plant.title, reason))
            else:
                plants.append(plant)
        return cls(chosen_designs(ranking), tuple(plants), tuple(left_out), scenarios, setup, ranking.case)

    @property
    def key(self) -> str:
        """Sixteen hexadecimal digits that stand for all of it."""
        chosen = self.chosen
        identity = [
            _FORMAT,
            ldctoolkit.__version__,
            [[design.id, contends] for design, contends in zip(chosen.designs, chosen.contends, strict=True)],
            [chosen.slow, chosen.unsafe, chosen.more],
            [dataclasses.asdict(plant) for plant in self.plants],
            dataclasses.asdict(self.setup),
            dataclasses.asdict(self.case),
        ]
        content = hashlib.sha256(json.dumps(identity, sort_keys=True, separators=(",", ":")).encode())
        for array in self.scenarios.arrays():
            content.update(array.tobytes())
        return content.hexdigest()[:16]


def work_out(task: RobustnessTask) -> Robustness:
    """Drive the designs of a task on its plants, and look at their loops."""
    chosen, setup = task.chosen, task.setup
    drives = drive_on_plants(chosen.designs, [plant.options for plant in task.plants], task.scenarios, setup, task.case)
    # every plant and design on the same scenarios, or their means could not be compared
    known = np.isfinite(drives.S)
    ran = np.any(known, axis=2)
    rows = np.all(known[ran], axis=0)
    some = {name: getattr(drives, name)[:, :, rows] for name in ("S", "S_uncorrected", "status")}
    drives = dataclasses.replace(drives, **some)
    side = task.scenarios.side[rows]
    thresholds = dict.fromkeys(design.y_s for design in chosen.designs if not design.is_baseline)
    takeovers = [Takeover.build(task.scenarios, setup, y_s=y_s) for y_s in thresholds]
    v = _trigger_speeds(takeovers)
    gain, phase = design_margins([design.controller(setup.convention) for design in chosen.designs], setup, v)
    contends = np.array(chosen.contends, dtype=np.bool_)
    S = _means(drives.S)
    failed = status_among(drives.status, FAILED_STATUSES)
    change, low, high = _changes(drives.S, side)
    # to no control on the same plant
    excess, excess_low, excess_high = _paired(
        drives.S_uncorrected, drives.S, np.all(np.isfinite(drives.S), axis=2), side
    )
    rival, lead, lead_low, lead_high = _leads(drives.S, S, contends, side)
    return Robustness(
        key=task.key,
        designs=tuple(design.id for design in chosen.designs),
        contends=contends,
        slow=chosen.slow,
        unsafe=chosen.unsafe,
        more=chosen.more,
        plants=tuple(plant.name for plant in task.plants),
        titles=tuple(plant.title for plant in task.plants),
        differences=tuple(plant.what for plant in task.plants),
        left_out=task.left_out,
        left=int((side == LEFT).sum()),
        right=int((side != LEFT).sum()),
        S=S,
        S_uncorrected=_means(drives.S_uncorrected),
        rank=np.stack([ranks(row, contends) for row in S]),
        failures=failed.sum(axis=2, dtype=np.int64),
        diverged=(drives.status == EventStatus.DIVERGED).sum(axis=2, dtype=np.int64),
        change=change,
        low=low,
        high=high,
        excess=excess,
        excess_low=excess_low,
        excess_high=excess_high,
        rival=rival,
        lead=lead,
        lead_low=lead_low,
        lead_high=lead_high,
        raised=drives.raised,
        v=v,
        gain=gain,
        phase=phase,
    )


def _trigger_speeds(takeovers: Sequence[Takeover]) -> FloatArray:
    """Speeds from the slowest to the fastest trigger, (k,) [m/s]; the review's own range where nothing triggers."""
    v = [takeover.plant.v for takeover in takeovers if takeover.m]
    if not v:
        return np.linspace(SPEEDS[0], SPEEDS[-1], POINTS)
    low, high = min(float(one.min()) for one in v), max(float(one.max()) for one in v)
    return np.linspace(low, high, POINTS if high > low else 1)


def ranks(S: FloatArray, contends: BoolArray) -> IntArray:
    """Rank of each design by mean S among those that contend; equal ones (to 1e-6 m s) share it, 0 for the others."""
    among = contends & ~np.isnan(S)
    better = (S[None, among] < S[:, None] - SAME).sum(axis=1)
    return np.where(among, 1 + better, 0).astype(np.int64)


def _means(values: FloatArray) -> FloatArray:
    """Means over the scenarios; NaN without any."""
    if not values.shape[2]:
        return np.full(values.shape[:2], np.nan)
    return row_means(values.reshape(-1, values.shape[2])).reshape(values.shape[:2])


def _changes(S: FloatArray, side: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Change to the first plant and its interval, (p, d) each."""
    known = np.all(np.isfinite(S), axis=2)
    ends = _paired(np.broadcast_to(S[0], S.shape), S, known & known[0], side)
    for end in ends:
        end[0, known[0]] = 0.0
    return ends


def _leads(
    S: FloatArray, mean: FloatArray, contends: BoolArray, side: IntArray
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """The best other design on each plant, and the difference of the first design to it with its interval."""
    p, d, n = S.shape
    if d < 2 or not n:
        return np.full(p, -1, dtype=np.int64), *_paired(S[:, 0], S[:, 0], np.zeros(p, dtype=np.bool_), side)
    others = np.where(contends[None, 1:] & ~np.isnan(mean[:, 1:]), mean[:, 1:], np.inf)
    rival = np.where(np.isfinite(others).any(axis=1) & ~np.isnan(mean[:, 0]), 1 + others.argmin(axis=1), -1)
    return rival.astype(np.int64), *_paired(S[np.arange(p), rival], S[:, 0], rival >= 0, side)


def _paired(
    old: FloatArray, new: FloatArray, where: BoolArray, side: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Difference of the means of scores (..., n) and its interval where that is wanted, NaN elsewhere."""
    difference, low, high = (np.full(where.shape, np.nan) for _ in range(3))
    if where.any() and side.size:
        difference[where], low[where], high[where] = paired_means(old[where], new[where], side, CONFIDENCE)
    return difference, low, high


NAME: Final = "robustness.json"

_KINDS: Final[dict[Any, Any]] = {FloatArray: np.float64, IntArray: np.int64, BoolArray: np.bool_}


def robustness_of(folder: Path, task: RobustnessTask) -> Robustness:
    """The numbers of a task: those in a study's folder if they are its own, else worked out and stored there."""
    found = stored_of(folder, task)
    if found is not None:
        return found
    made = work_out(task)
    write_text(folder / NAME, text_of(made))
    return made


def stored_of(folder: Path, task: RobustnessTask) -> Robustness | None:
    """The numbers of a task in a study's folder; None where there are none, or those of something else."""
    found = read(folder / NAME)
    return found if found is not None and found.key == task.key else None


def text_of(robustness: Robustness) -> str:
    """The numbers as JSON; every one of them comes back as it was."""
    content = {
        name: _plain(value) if isinstance(value, np.ndarray) else value for name, value in vars(robustness).items()
    }
    return json.dumps(content, separators=(",", ":"), allow_nan=False) + "\n"


def read(path: Path) -> Robustness | None:
    """Read a file that was written from `text_of`; None where there is none, or it is of another kind."""
    kinds = {name: _KINDS.get(hint) for name, hint in get_type_hints(Robustness).items()}
    try:
        content = read_json(path)
        values: dict[str, Any] = {
            name: _tuples(value) if kinds[name] is None else np.array(value, dtype=kinds[name])
            for name, value in content.items()
        }
        return Robustness(**values)
    except (StoreError, ValueError, TypeError, KeyError, AttributeError):
        return None  # it only saves time: what cannot be read is worked out again


def _plain(values: npt.NDArray[Any]) -> Any:
    """Lists of numbers; text for those that JSON does not know."""
    plain = values.astype(object)
    plain[~np.isfinite(values)] = values[~np.isfinite(values)].astype(str)
    return plain.tolist()


def _tuples(value: Any) -> Any:
    return tuple(_tuples(one) for one in value) if isinstance(value, list) else value
