"""The verdict on a ranking, and the ranking as text: terminal, Markdown and notebook."""

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, Literal

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.declared import Gain
from ldctoolkit.metrics import DTLE_LIMIT, METRICS
from ldctoolkit.paths.uncorrected import UncorrectedPath
from ldctoolkit.plant_options import Driver
from ldctoolkit.scenario_model import ScenarioModel
from ldctoolkit.scenario_model.model import misleading
from ldctoolkit.setup import Setup

from ..design import Design
from ..design_space import THRESHOLD, Y_S, Choices, Span
from ..requirements import Estimate, G, Miss, metric_values
from ..results import StudyResults
from ..tables import Cell, Column, Row, Table, Value, notebook_html
from ..text import compact
from .design_metrics import beyond_friction
from .finalists import RankedDesigns
from .inference import tail_text

State = Literal["good", "warning", "bad", "unknown"]

_NEAREST: Final = 3


@dataclasses.dataclass(frozen=True)
class Light:
    """A light: its subject, its state and the reason."""

    name: str
    state: State
    text: str


@dataclasses.dataclass(frozen=True)
class OtherPlants:
    """The part of `ldctoolkit.studies.robustness.Robustness` for a verdict: d designs, p plants, the study's first."""

    designs: tuple[str, ...]  # Identifiers
    plants: tuple[str, ...]  # Names
    titles: tuple[str, ...]  # Names for readers
    adds: tuple[bool, ...]  # Whether a plant is more difficult than the study's
    S: FloatArray  # (p, d) [m s] Mean S; NaN where the law raised
    diverged: IntArray  # (p, d) Departures that diverged though friction allows their recorded path
    # (p, d) [m s] Paired difference of mean S to no control on the same plant, above 0 where the design is worse
    excess: FloatArray

    def driver_light(self, ranking: RankedDesigns, position: int, driver: Driver) -> Light | None:
        """Whether a design is the first with each driver; None where designs were not driven with each."""


@dataclasses.dataclass(frozen=True)
class SweepEnd:
    """A gain or threshold of a design that lies at an end of the values that were tried."""

    gain: Gain
    value: float
    end: float  # The same; of a range without a list of values, its end close by
    upper: bool  # Whether it is the largest

    @property
    def open(self) -> bool:
        """Whether the law allows values beyond."""
        return self.end != (self.gain.upper if self.upper else self.gain.lower)

    @property
    def text(self) -> str:
        """For a reader: ``"r_delta = 5000 is the end of its sweep: extend it"``."""
        shown = _setting(self.gain, self.value)
        if not self.open:
            return f"{shown} is the {'largest' if self.upper else 'smallest'} allowed"
        near = "" if self.value == self.end else f" beside {compact(self.end)},"
        return f"{shown} is{near} the end of its sweep: extend it"


@dataclasses.dataclass(frozen=True)
class BlockedValue:
    """The next value of a gain or threshold in its sweep, where S is less but a requirement is not met."""

    gain: Gain
    value: float
    missed: tuple[Miss, ...]

    @property
    def text(self) -> str:
        """For a reader: ``"r_delta = 2500 would be better, but breaks needless <= 50 % (52.1 %)"``."""
        broken = _list([miss.broken for miss in self.missed])
        return f"{_setting(self.gain, self.value)} would be better, but breaks {broken}"


def _setting(gain: Gain, value: float) -> str:
    return f"{gain.name} = {compact(value)}{' m' if gain is Y_S else ''}"


@dataclasses.dataclass(frozen=True)
class Verdict:
    """The conclusion of a study; requirements come first."""

    title: str  # One line
    sentences: tuple[str, ...]  # At most two: the score of the named design, and what it violates or misses
    lights: tuple[Light, ...]  # Of the named design: score, stable, limits, other plants, tail; then scenarios
    position: int  # Of the named design in the ranking
    # If no design meets the requirements: positions of those whose largest excess is smallest
    nearest: tuple[int, ...] = ()
    try_next: tuple[str, ...] = ()  # If no design meets the requirements: what to try
    recorded: float = 0.0  # Share of departures whose recorded path alone needs more than the friction
    # What holds the named design back, if it meets the requirements: those that bind, ends of sweeps, and values beside
    # its own that break a requirement
    binding: tuple[Estimate, ...] = ()
    ends: tuple[SweepEnd, ...] = ()
    blocked: tuple[BlockedValue, ...] = ()

    @property
    def usable(self) -> bool:
        """Whether no light is red."""
        return not any(light.state == "bad" for light in self.lights)

    @property
    def held_back(self) -> tuple[str, ...]:
        """Sentences on what binds, on the ends of sweeps, and on better values that break a requirement."""
        binding = "; ".join(estimate.of_limit for estimate in self.binding)
        texts = [f"Requirements that bind: {binding}"] if binding else []
        texts += [end.text for end in self.ends] + [value.text for value in self.blocked]
        return tuple(f"{text}." for text in texts)


def verdict(
    ranking: RankedDesigns,
    results: StudyResults,
    setup: Setup | None = None,
    robustness: OtherPlants | None = None,
    model: ScenarioModel | None = None,
) -> Verdict:
    """Judge a ranking; `model` is what generated the scenarios."""
    setup = setup or Setup()
    nearest: tuple[int, ...] = ()
    try_next: tuple[str, ...] = ()
    drivable = results.scenarios.take(results.drivable)
    recorded = float(beyond_friction(drivable, setup).mean()) if drivable.n else 0.0
    acting = [i for i, design in enumerate(ranking.designs) if not design.is_baseline]
    meeting = [i for i in range(ranking.ranked) if not ranking.designs[i].is_baseline]
    if meeting or not acting:
        position = meeting[0] if ranking.winner is None and meeting else ranking.winner or 0
        title = _of_winner(ranking, position)
        sentences = [f"{ranking.criterion_text(position)}{_score(ranking, position)}"]
        broken = _broken(ranking, position)
        if broken:
            sentences.append(f"It is not usable as it is: {_list(broken)}.")
    else:
        nearest = _nearest(ranking)
        position = nearest[0]
        only = "The design does not meet the limits"
        title = only if len(acting) == 1 else f"None of {len(acting)} designs meets the limits"
        misses = [miss.text for miss in ranking.missed[position]]
        sentences = [f"Nearest: {design_name(ranking.designs[position])}; it misses {_list(misses)}."]
        if recorded > 0:
            sentences.append(f"In {100 * recorded:.1f} % of departures the recorded path alone is beyond friction.")
        try_next = tuple(_try_next(ranking, position))
    lights = (
        _score_light(ranking, position),
        _stable_light(ranking, position),
        _limits_light(ranking, position),
        _plants_light(ranking, position, robustness),
        *_driver_light(ranking, position, setup.options.driver, robustness),
        *_tail_light(ranking, results, setup, position),
        *_scenarios_light(model),
    )
    binding = tuple(limit for limit in ranking.estimates(position) if limit.required and limit.binds and not nearest)
    ends, blocked = ((), ()) if nearest else (sweep_ends(ranking, position), blocked_values(ranking, position))
    return Verdict(title, tuple(sentences), lights, position, nearest, try_next, recorded, binding, ends, blocked)


def law_title(design: Design) -> str:
    """Title of a design's law."""
    return design.kind.title


def gains_text(design: Design, between: str = " = ") -> str:
    """Gains that differ from their defaults."""
    return ", ".join(f"{name}{between}{compact(value)}" for name, value in design.changed)


def design_name(design: Design) -> str:
    """A design in a sentence: law, threshold, gains that differ from their defaults."""
    return ", ".join(filter(None, (law_title(design), f"y_s = {design.y_s:g} m", gains_text(design))))


def _list(parts: list[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def _of_winner(ranking: RankedDesigns, position: int) -> str:
    name = design_name(ranking.designs[position])
    if ranking.winner is None:
        return f"No winner: no finalist meets the requirements on the fresh scenarios. First: {name}"
    if ranking.requirements:
        return f"Best design that meets the limits: {name}"
    of = ranking.ranked_by
    best = "Smallest S" if of.name == "S" else f"{'Largest' if of.better == 'more' else 'Smallest'} {of.title}"
    return f"{best}{', but not usable' if _broken(ranking, position) else ''}: {name}"


def _score(ranking: RankedDesigns, i: int) -> str:
    """Score of a design on the sample of scenarios that the sentence names."""
    of = (ranking.fresh.S, ranking.fresh.low, ranking.fresh.high)
    if not np.isfinite(ranking.fresh.S[i]):
        of = (ranking.metrics.S, ranking.inference.S_low, ranking.inference.S_high)
    S, low, high = (float(values[i]) for values in of)
    saved = ranking.saved(i)
    values = {estimate.requirement.metric.name: estimate.value for estimate in ranking.estimates(i)}
    level = f"{100 * ranking.confidence:g} % interval"
    between = f" ({level} {low:.3f} to {high:.3f})" if math.isfinite(low + high) else ""
    # from above: an interval of S ends at 0 below
    either_way = [_percent((end - S) / S) if S > 0.0 else "" for end in (high, float(ranking.recordings.high[i]))]
    if math.isfinite(ranking.recordings.high[i]) and between:
        between += f", {either_way[0]} either way from the scenarios, {either_way[1]} from the recordings"
    if ranking.designs[i].is_baseline or not math.isfinite(saved):
        change = ""
    elif saved <= -1.0:
        change = f", {1.0 - saved:.3g} times that without control"
    else:
        change = f", {100 * abs(saved):.1f} % {'less' if saved >= 0 else 'more'} than without control"
    added = [
        f"{METRICS[name].scale * value:.{METRICS[name].digits}f} {METRICS[name].shown_unit} of {what}"
        for name, what in (("a_y_added_peak_p95", "lateral acceleration"), ("jerk_added_peak_p95", "jerk"))
        if math.isfinite(value := values[name])
    ]
    costs = f"; control adds {_list(added)} (95 % quantiles)" if added else ""
    share = math.nan if ranking.designs[i].is_baseline else ranking.needless(i)
    needless = (
        f" In {100 * share:.1f} % of departures it intervenes needlessly: the recorded path stays within "
        f"{-DTLE_LIMIT:g} m beyond the line."
    )
    return f"Mean S {S:.3f} m s on {ranking.sample(i)}{between}{change}{costs}.{'' if math.isnan(share) else needless}"


def _percent(share: float) -> str:
    return f"{100.0 * share:.{0 if share >= 0.0095 else 1}f} %"


def _broken(ranking: RankedDesigns, position: int) -> list[str]:
    """Violations of what every design on a road must satisfy: stability, and accelerations that tyres allow."""
    faults = []
    if lost := int(metric_values("lost", ranking)[position]):
        faults.append(f"it diverges in {lost} departure{'' if lost == 1 else 's'}")
    if float(metric_values("gain_margin", ranking)[position]) == 0.0:
        faults.append("its linear loop is unstable at some speed")
    impossible = _impossible(ranking, position)
    if impossible:
        faults.append(impossible)
    return faults


def _impossible(ranking: RankedDesigns, position: int) -> str:
    """Phrase on a peak lateral acceleration beyond what tyres allow; empty if there is none."""
    most = next((requirement.limit for requirement in ranking.limits if requirement.set == "physical"), G)
    peak = float(metric_values("a_y_peak_max", ranking)[position])
    if not peak > most:
        return ""
    return f"a lateral acceleration of {peak:.3g} m/s\u00b2 ({peak / G:.2g} g) is physically impossible"


def _score_light(ranking: RankedDesigns, position: int) -> Light:
    saved = ranking.saved(position)
    if not math.isfinite(saved):
        return Light("Score", "unknown", "There is no score without control to compare with.")
    if saved <= 0:
        return Light("Score", "bad", "No better than without control.")
    others = int(ranking.inference.set_of_best.sum()) - 1
    if not ranking.inference.set_of_best[position] or others <= 0:
        return Light("Score", "good", f"{100 * saved:.1f} % less S than without control.")
    rest = f"{others} other design{'' if others == 1 else 's'} {'is' if others == 1 else 'are'} not separated from it"
    return Light("Score", "good", f"{100 * saved:.1f} % less S than without control; {rest}.")


def _stable_light(ranking: RankedDesigns, position: int) -> Light:
    lost, diverged = int(metric_values("lost", ranking)[position]), int(ranking.metrics.diverged[position])
    gain, phase = (float(metric_values(name, ranking)[position]) for name in ("gain_margin", "phase_margin"))
    missed = [miss.text for miss in ranking.estimates(position) if miss.requirement.set == "stable" and not miss.met]
    if lost:
        return Light("Stable", "bad", f"It diverges in {lost} of {ranking.scenarios:,} departures.")
    if gain == 0.0:
        return Light("Stable", "bad", "Its linear loop is unstable at some speed from 10 to 40 m/s.")
    if missed:
        return Light("Stable", "bad", f"{_capital(_list(missed))}.")
    never = "Diverges in no departure"
    if diverged:
        never = (
            f"Diverges only in {diverged} of {ranking.scenarios:,} departures, whose recorded path is beyond friction"
        )
    if math.isnan(gain):
        return Light("Stable", "warning", f"{never}; it has no linear loop whose margins are known.")
    shown = "no limit" if math.isinf(gain) else f"{gain:.1f}"
    return Light("Stable", "good", f"{never}; gain margin {shown}, phase margin {math.degrees(phase):.0f}\u00b0.")


def _limits_light(ranking: RankedDesigns, position: int) -> Light:
    impossible = _impossible(ranking, position)
    limited = [of for of in ranking.estimates(position) if of.requirement.set not in ("stable", "physical")]
    missed = [estimate.text for estimate in limited if estimate.required and not estimate.met]
    others = {of.text: of.requirement.set for of in limited if not (of.required or of.met)}
    level = f"{100 * ranking.confidence:g} %"
    close = [estimate.with_interval(level) for estimate in limited if estimate.met and estimate.uncertain]
    if impossible:
        return Light("Limits", "bad", f"{_capital(impossible)}.")
    if missed:
        return Light("Limits", "bad", f"{_capital(_list(missed))}.")
    sets = list(dict.fromkeys(others.values()))
    doubts = [f"Not required, but beyond {_list(sets)}: {_list([*others])}."] if others else []
    doubts += [f"Met on {ranking.sample(position)}, but not with certainty: {'; '.join(close)}."] if close else []
    if doubts:
        return Light("Limits", "warning", " ".join(doubts))
    every = (*ranking.requirements, *(estimate.requirement for estimate in limited))
    return Light("Limits", "good", f"Meets {_list([*dict.fromkeys(limit.set or limit.text for limit in every)])}.")


def depths(results: StudyResults, i: int, setup: Setup | None = None) -> tuple[FloatArray, FloatArray]:
    """Largest depths [m] with a design and without control, on the departures that every design can be driven on."""
    scenarios, setup = results.scenarios.take(results.drivable), setup or Setup()
    path = UncorrectedPath.of(scenarios, setup.options.residuals, setup.seed)
    return results.metrics.deepest[i][results.drivable], path.deepest(scenarios.T)


def _tail_light(ranking: RankedDesigns, results: StudyResults, setup: Setup, position: int) -> Iterator[Light]:
    """Yield a light if the design reaches large depths significantly more often than no control does."""
    if text := tail_text(*depths(results, int(ranking.index[position]), setup)):
        yield Light("Tail", "bad", f"{_capital(text)}.")


def _scenarios_light(model: ScenarioModel | None) -> Iterator[Light]:
    """Whether generated and recorded departures lead to the same conclusion; no light without a model."""
    if model is None:
        return
    sides = [side for side in (model.provenance.left, model.provenance.right) if side is not None and side.fidelity]
    wrong = misleading(model)
    if wrong:
        yield Light("Scenarios", "bad", f"{_capital('; '.join(wrong))}.")
    elif len(sides) < 2:
        yield Light("Scenarios", "unknown", "The model does not say whether it gives its recordings' answer.")
    else:
        yield Light("Scenarios", "good", "Test designs score the same on generated and recorded departures.")


def _plants_light(ranking: RankedDesigns, position: int, robustness: OtherPlants | None) -> Light:
    name = "Other plants"
    if robustness is None or ranking.designs[position].id not in robustness.designs:
        return Light(name, "unknown", "Not tested on other plants.")
    i = robustness.designs.index(ranking.designs[position].id)
    others = [p for p, adds in enumerate(robustness.adds) if adds]
    lost = [robustness.titles[p] for p in others if robustness.diverged[p, i] > robustness.diverged[0, i]]
    worse = [robustness.titles[p] for p in others if robustness.excess[p, i] > 0]
    if lost:
        return Light(name, "bad", f"It diverges with: {', '.join(lost)}.")
    if worse:
        return Light(name, "bad", f"Worse than no control with: {', '.join(worse)}.")
    ratio = {p: float(robustness.S[p, i] / robustness.S[0, i]) for p in others if robustness.S[0, i] > 0}
    if not any(map(math.isfinite, ratio.values())):
        return Light(name, "unknown", "Its scores on other plants are not known.")
    p, most = max(ratio.items(), key=lambda item: item[1] if math.isfinite(item[1]) else 0.0)
    rise = f"{most:.2g} times its S" if most >= 2 else f"{100 * (most - 1):.0f} % more S"
    title = robustness.titles[p]
    title = title[:1].lower() + title[1:] if title[1:2].islower() else title
    worst = f"Least favourable plant: {title}, {rise}."
    text = worst if most > 1 else "S rises on none of them."
    return Light(name, "warning" if most > 1.5 else "good", text)


def _driver_light(
    ranking: RankedDesigns, position: int, driver: Driver, robustness: OtherPlants | None
) -> Iterator[Light]:
    """The light of the drivers; no light where nobody holds the wheel."""
    if not driver.ideal:
        light = None if robustness is None else robustness.driver_light(ranking, position, driver)
        yield light or Light("Driver", "unknown", "Not compared with each driver.")


def optimism_text(ranking: RankedDesigns, i: int, unit: str = "m s") -> str:
    """Compare the score of a design on fresh scenarios with that on the study scenarios, which selected it."""
    change, low, high = ranking.fresh.optimism[i], ranking.fresh.optimism_low[i], ranking.fresh.optimism_high[i]
    word = "worse" if change > 0 else "better"
    of = ", as the difference to the baseline," if ranking.fresh.optimism_paired else ""
    chance = "within sampling error" if low <= 0 <= high else "more than sampling error"
    scale, unit = ranking.scale_and_unit(unit)
    return (
        f"On fresh scenarios the winner scored{of} {scale * abs(change):.4f} {unit} {word} than on the study scenarios "
        f"({scale * low:+.4f} .. {scale * high:+.4f}), {chance}."
    )


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _nearest(ranking: RankedDesigns) -> tuple[int, ...]:
    """Positions of the designs whose largest excess is smallest; designs that intervene come first."""
    largest = [max((miss.excess for miss in misses), default=0.0) for misses in ranking.missed]
    passive = [design.is_baseline for design in ranking.designs]
    total = [sum(miss.excess for miss in misses) for misses in ranking.missed]
    order = sorted(range(len(ranking)), key=lambda i: (passive[i], largest[i], total[i], i))
    return tuple(order[:_NEAREST])


def _try_next(ranking: RankedDesigns, position: int) -> Iterator[str]:
    """Advice from the position of the nearest design in its sweep."""
    design = ranking.designs[position]
    ends = [
        f"{end.gain.name} {'above' if end.upper else 'below'} {end.end:g}"
        for end in sweep_ends(ranking, position)
        if end.open
    ]
    if ends:
        yield f"The nearest design stands at an end of its sweep: try {_list(ends)}."
    else:
        yield f"{law_title(design)} comes closest; sweep its gains around the nearest design."


_AT_END: Final = 0.02  # of a range: what lies closer to its end lies at it


def _sweeps(ranking: RankedDesigns, position: int) -> Iterator[tuple[Gain, float, dict[float, int]]]:
    """Yield each numeric gain and the threshold of a design, and the values beside which it was tried.

    In a grid these are of the designs that differ from it in nothing else, whose positions they have; failed designs
    come after all others.
    """
    design = ranking.designs[position]
    every = enumerate((*ranking.designs, *(failure.design for failure in ranking.failed)))
    tried = {i: {THRESHOLD: other.y_s, **dict(other.gains)} for i, other in every if other.law == design.law}
    values = tried[position]
    for gain in () if design.is_baseline else (Y_S, *design.kind.gains()):
        value: Any = values[gain.name]
        if not isinstance(value, str | bool):
            beside: Any = {of[gain.name]: i for i, of in tried.items() if of | {gain.name: value} == values}
            yield gain, value, beside


def sweep_ends(ranking: RankedDesigns, position: int) -> tuple[SweepEnd, ...]:
    """Gains and threshold of a design that lie at an end of the values beside which it was tried."""
    law, ends = ranking.designs[position].law, []
    for gain, value, beside in _sweeps(ranking, position):
        ranges = [of for *what, of in ranking.ranges if what == [law, gain.name]]
        numbers: set[Any] = set(beside)
        numbers |= {end for of in ranges for end in (of.values if isinstance(of, Choices) else (of.low, of.high))}
        for upper, end in enumerate((min(numbers), max(numbers)) if len(numbers) > 1 else ()):
            close = (abs(of.share(value) - of.share(end)) <= _AT_END for of in ranges if isinstance(of, Span))
            if value == end or any(close):
                ends.append(SweepEnd(gain, value, end, bool(upper)))
    return tuple(ends)


def blocked_values(ranking: RankedDesigns, position: int) -> tuple[BlockedValue, ...]:
    """Next values of a design's gains and threshold, in both directions, with less S but a requirement not met."""
    blocked = []
    for gain, value, beside in _sweeps(ranking, position):
        tried = sorted(beside)
        at = tried.index(value)
        for x in (*tried[:at][-1:], *tried[at + 1 :][:1]):
            if (i := beside[x]) >= len(ranking):
                continue
            cost = ranking.costs[bool(np.isfinite(ranking.fresh.S[[i, position]]).all())]
            missed = ranking.missed[i] or tuple(of for of in ranking.estimates(i) if of.required and not of.met)
            if missed and cost[i] < cost[position]:
                blocked.append(BlockedValue(gain, x, missed))
    return tuple(blocked)


TOP: Final = 20  # rows of a notebook; the winner and the baseline follow where they are further down

RANKING_METRICS: Final = ("reduction", "a_y_added_peak_p95", "jerk_added_peak_p95", "needless")
"""Metrics beside S of every table that shows a ranking."""

COLUMNS_TEXT: Final = (
    "Reduction: of mean S against no control. p95: 95 % quantile of what control adds to the recorded path. "
    "Needless: share of departures with an intervention although the recorded path stays within 0.3 m beyond the line."
)
"""Explanation of the short headings."""


STEP_TEXT: Final = (
    "Step: time of the law's step for one vehicle, median and 99 % quantile, measured on this machine, in Python. It "
    "differs from run to run and is not part of the results. Linear laws have no step."
)
_STEP_COLUMNS: Final = (("Step", "step", "Median"), ("Step 99 %", "step_p99", "99 % quantile"))

StepTimes = Mapping[str, tuple[float, float]]
"""Median and 99 % quantile of the time of a law's step [s], by the identifier of a design."""


def ranking_table(ranking: RankedDesigns, positions: Sequence[int], times: StepTimes | None = None) -> Table:
    """Table of the designs at the given positions, for terminal, Markdown and notebook."""
    heads = (("Reduction", "reduction"), ("a_y p95", "a_y"), ("Jerk p95", "jerk"), ("Needless", "needless"))
    level = f"{100 * ranking.confidence:g} % interval"
    users = ranking.user_columns
    columns = [
        Column("Rank", key="rank"),
        Column("Law", text=True),
        Column("y_s", "m", "g", key="y_s", about="Trigger threshold"),
        Column("Gains", text=True, about="Gains that differ from their defaults"),
        *(Column(of.title, of.shown_unit, f".{of.digits}f", key=name) for name, of in users.items()),
        Column("Mean S", "m\u00b7s", ".3f", key="S"),
        Column(level, "m\u00b7s", ".3f", about="Of mean S, for all designs at once"),
        *(
            Column(head, METRICS[name].shown_unit, f".{METRICS[name].digits}f", key=key, about=METRICS[name].title)
            for (head, key), name in zip(heads, RANKING_METRICS, strict=True)
        ),
        *([Column("Fresh S", "m\u00b7s", ".3f", key="fresh", about="Mean S on the fresh scenarios")]
          if ranking.fresh.scenarios else []),
        *(Column(head, "\u00b5s", ".0f", key=key, about=f"{what} of the law's step, measured on this machine")
          for head, key, what in _STEP_COLUMNS if times),
        Column("Verdict", text=True),
    ]  # fmt: skip
    shown = {name: of.scale * metric_values(name, ranking) for name, of in users.items()}
    metrics = {name: METRICS[name].scale * metric_values(name, ranking) for name in RANKING_METRICS}
    rows = []
    for before, i in zip([-1, *positions], positions, strict=False):
        design, missed = ranking.designs[i], {miss.requirement.metric.name for miss in ranking.missed[i]}
        S_of = (ranking.metrics.S, ranking.inference.S_low, ranking.inference.S_high, ranking.fresh.S)
        S, low, high, fresh = (float(values[i]) for values in S_of)
        cells: list[Cell | Value] = [
            int(ranking.rank[i]) or math.nan, law_title(design), design.y_s, gains_text(design, "="),
            *(Cell(float(values[i]), bad=name in missed) for name, values in shown.items()), S, (low, high),
            *(Cell(float(values[i]), bad=name in missed) for name, values in metrics.items()),
            *([fresh] if ranking.fresh.scenarios else []),
            *(1e6 * value for value in (times.get(design.id, (math.nan,) * 2) if times else ())),
            Cell(judged(ranking, i), bad=bool(missed)),
        ]  # fmt: skip
        kind = "winner" if i == ranking.winner else "baseline" if i == ranking.baseline else ""
        rows.append(Row(cells, kind, apart=i > before + 1))
    by = "mean S" if ranking.criterion is None else ranking.ranked_by.title
    title = f"{len(ranking):,} design{'s' * (len(ranking) != 1)} by {by}, {ranking.label}"
    return Table(title, columns, rows, head=1)


def judged(ranking: RankedDesigns, position: int) -> str:
    """State of a design in a phrase: winner, baseline, violated requirements, failures."""
    phrases = ["winner"] if position == ranking.winner else []
    if position == ranking.baseline:
        phrases.append("baseline")
    if ranking.missed[position]:
        sets = dict.fromkeys(miss.requirement.set or miss.requirement.text for miss in ranking.missed[position])
        most = max((miss.excess for miss in ranking.missed[position] if miss.requirement.limit), default=0.0)
        by = f" by {100 * most:.0f} %" if 0.005 <= most < 10 else ""
        phrases.append(f"breaks {', '.join(sets)}{by}")
    elif ranking.requirements:
        certain = not any(estimate.required and estimate.uncertain for estimate in ranking.estimates(position))
        phrases.append("meets all" if certain else "meets all, not with certainty")
    failed = failures(ranking, position)
    if failed:
        phrases.append(f"failed in {failed:,}")
    separated = not ranking.inference.set_of_best[position]
    if not (separated or ranking.missed[position] or position in (ranking.winner, ranking.baseline)):
        phrases.append("not separated")
    if ranking.pareto[position]:
        phrases.append("Pareto")
    return ", ".join(phrases)


def failures(ranking: RankedDesigns, position: int) -> int:
    """Number of scenarios in which the law of a design failed."""
    of = ranking.metrics
    return sum(int(count[position]) for count in (of.solver_failed, of.diverged, of.timed_out, of.crashed))


def listed_positions(ranking: RankedDesigns, most: int) -> list[int]:
    """Positions of the first designs, the winner, the baseline and the best design of each law."""
    named = {position for position in (ranking.winner, ranking.baseline) if position is not None}
    return sorted({*range(min(most, len(ranking))), *named, *ranking.best_of_each_law()[:most]})


def verdict_lines(verdict: Verdict) -> list[str]:
    """Title and sentences of a verdict, what holds the design back, red and yellow lights, and what to try."""
    lights = [f"{light.name}: {light.text}" for light in verdict.lights if light.state in ("bad", "warning")]
    return [f"{verdict.title}.", *verdict.sentences, *verdict.held_back, *lights, *verdict.try_next]


def set_of_best_line(ranking: RankedDesigns) -> str:
    """Sentence on the designs that the scenarios do not separate; empty for a single design, or if none is ranked."""
    size, level = int(ranking.inference.set_of_best.sum()), f"{100 * ranking.confidence:g} % confidence"
    if not ranking.ranked or len(ranking) == 1:
        return ""
    if size == 1:
        return f"Set of best: the first design alone, with {level}."
    return f"Set of best: {size:,} designs that these scenarios do not separate; with {level} the best is among them."


_LIMITED: Final = {"jerk_max": "jerk_added_peak_p95", "a_y_max": "a_y_added_peak_p95"}
"""Gains by which a law itself limits comfort (0: no limit), and what they are to limit."""


def limit_line(ranking: RankedDesigns) -> str:
    """What a limit of comfort inside the law buys: the best ranked designs with and without, where there are both."""
    limited = [[name for name in _LIMITED if dict(design.gains).get(name)] for design in ranking.designs]
    acting = [i for i in range(ranking.ranked) if not ranking.designs[i].is_baseline]
    within, without = (next((i for i in acting if bool(limited[i]) is has), None) for has in (True, False))
    if within is None or without is None:
        return ""

    def parts(i: int, less: str) -> str:
        saved = float(ranking.metrics.reduction[i])
        values = (
            f"{METRICS[_LIMITED[name]].scale * metric_values(_LIMITED[name], ranking)[i]:.2f} "
            f"{METRICS[_LIMITED[name]].shown_unit} of {'jerk' if name == 'jerk_max' else 'lateral acceleration'}"
            for name in limited[within]
        )
        change = f"{100 * abs(saved):.1f} % {'less' if saved >= 0 else 'more'}{less}"
        return f"{design_name(ranking.designs[i])}, S {change} at {_list(list(values))}"

    second = max(within, without)
    low, high = (float(getattr(ranking.inference, f"difference_{end}")[second]) for end in ("low", "high"))
    apart = f" Difference of the two: {ranking.apart(float(ranking.inference.difference[second]), low, high)}."
    return (
        f"Best design with a limit of comfort in its law: {parts(within, ' than without control')} (95 % quantile). "
        f"Best without: {parts(without, '')}.{'' if min(within, without) or math.isnan(low + high) else apart}"
    )


def more_lines(ranking: RankedDesigns) -> Iterator[str]:
    """Further sentences on a ranking: the set of best, limits inside laws, fresh scenarios, failures."""
    yield from filter(None, (set_of_best_line(ranking), limit_line(ranking)))
    i, b = ranking.winner, ranking.baseline
    if i is not None and b is not None and b != i:
        fresh = bool(np.isfinite(ranking.fresh.baseline_difference[i]))
        of, name = ranking.fresh if fresh else ranking.inference, "baseline_difference"
        value, low, high = (float(getattr(of, name + end)[i]) for end in ("", "_low", "_high"))
        if math.isfinite(low):
            where = "fresh" if fresh else "study"
            what = "Winner minus baseline" if ranking.ranked_by.better == "less" else "Baseline minus winner"
            apart = ranking.apart(value, low, high, "+.4f")
            yield f"{what} ({design_name(ranking.designs[b])}): {apart} on the {where} scenarios."
    if i is not None and ranking.fresh.scenarios and not np.isfinite(ranking.fresh.S[i]):
        yield "The winner was not among the finalists and has no score on fresh scenarios."
    if i is not None and np.isfinite(ranking.fresh.optimism[i]):
        yield optimism_text(ranking, i)
    if i is not None and ranking.fresh.difference[i] < 0 and ranking.fresh.difference_high[i] < 0:
        yield "It was not the first on the study scenarios: fresh scenarios separate the two."
    if i is not None and np.isfinite(ranking.replayed.S[i]):
        ends = (float(column[i]) for column in (ranking.replayed.S, ranking.replayed.low, ranking.replayed.high))
        mean, lowest, highest = (f"{value:.3f}" for value in ends)
        saved = float(ranking.replayed.reduction[i])
        less = f", {100 * abs(saved):.1f} % {'less' if saved >= 0 else 'more'} than without control"
        yield (
            f"On {ranking.replayed.departures:,} replayed departures its mean S is {mean} m s ({lowest} .. {highest})"
            f"{less if math.isfinite(saved) else ''}."
        )
        finalists = np.where(np.isfinite(ranking.fresh.S) & (ranking.rank > 0), ranking.replayed.S, np.inf)
        if (best := int(np.nanargmin(finalists))) != i and ranking.criterion is None:
            yield f"The first finalist there is {design_name(ranking.designs[best])}."
    if recordings := recordings_text(ranking):
        yield recordings
    limits = () if i is None else ranking.estimates(i)
    if i is not None and (required := [limit for limit in limits if limit.required and limit.interval]):
        texts = (limit.with_interval(f"{100 * ranking.confidence:g} %") for limit in required)
        yield f"Required of the winner, on {ranking.sample(i)}: {'; '.join(texts)}."
    if ranking.ranked < len(ranking):
        left = len(ranking) - ranking.ranked
        yield f"{left:,} of {len(ranking):,} designs do not meet a requirement and are not ranked."
    if ranking.pareto_metrics and ranking.pareto.any():
        yield (
            f"Pareto front over {', '.join(ranking.pareto_metrics)}: {int(ranking.pareto.sum())} designs, "
            "see ranking.csv."
        )
    if ranking.failed:
        yield f"{len(ranking.failed):,} design{'' if len(ranking.failed) == 1 else 's'} failed, without metrics."


def recordings_text(ranking: RankedDesigns, unit: str = "m s") -> str:
    """Sentence on what the recordings behind the model leave open of the winner; may be empty."""
    i, recordings, level = ranking.winner, ranking.recordings, f"{100 * ranking.confidence:g} %"
    if i is None or not recordings.text:
        return ""
    if not math.isfinite(low := float(recordings.low[i])):
        return f"Uncertainty from the limited recordings is not known: {recordings.text}."
    parts = [
        f"mean S {low:.3f} .. {recordings.high[i]:.3f} {unit}",
        f"reduction {100 * recordings.reduction_low[i]:.1f} .. {100 * recordings.reduction_high[i]:.1f} %",
    ]
    if math.isfinite(end := float(recordings.baseline_difference_low[i])):
        high = recordings.baseline_difference_high[i]
        parts.append(f"difference to the baseline {end:+.4f} .. {high:+.4f} {unit}")
    failed = f" ({recordings.failed} more failed)" if recordings.failed else ""
    return (
        f"Uncertainty from the limited recordings ({level} intervals, {recordings.refits} refits{failed}): "
        f"{', '.join(parts)}; {recordings.text}."
    )


def ranking_html(ranking: RankedDesigns, top: int = TOP) -> str:
    """HTML of a ranking for a notebook."""
    table = ranking_table(ranking, listed_positions(ranking, top))
    if ranking.winner is not None:
        best = f"Winner: {design_name(ranking.designs[ranking.winner])}."
    else:
        best = "No winner." if ranking.ranked else "None meets the requirements."
    return notebook_html((best, *more_lines(ranking)), ranking.warnings, table, len(ranking) - len(table.rows))
