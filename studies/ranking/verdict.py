"""The verdict on a ranking, and the ranking as text: terminal, Markdown and notebook."""

import dataclasses
import math
from collections.abc import Iterator, Sequence
from typing import Final, Literal

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.declared import GainValue
from ldctoolkit.metrics import METRICS
from ldctoolkit.paths.uncorrected import UncorrectedPath
from ldctoolkit.scenario_model import ScenarioModel
from ldctoolkit.scenario_model.model import misleading
from ldctoolkit.setup import Setup

from ..design import Design
from ..requirements import G, metric_values
from ..results import StudyResults
from ..tables import Cell, Column, Row, Table, Value, notebook_html
from .design_metrics import beyond_friction
from .inference import tail_text
from .ranked_designs import RankedDesigns

State = Literal["good", "warning", "bad", "unknown"]

_NEAREST: Final = 3


@dataclasses.dataclass(frozen=True)
class OtherPlants:
    """What a verdict takes from `ldctoolkit.studies.robustness.Robustness`: d designs on p plants, their own first."""

    designs: tuple[str, ...]  # Identifiers
    plants: tuple[str, ...]  # Names
    titles: tuple[str, ...]  # The same for people
    adds: tuple[bool, ...]  # Whether a plant adds a difficulty to the designs' own
    S: FloatArray  # (p, d) [m s] Mean S; NaN where the law raised
    diverged: IntArray  # (p, d) Departures that diverged though friction allows their recorded path
    # (p, d) [m s] Paired difference of mean S to no control on the same plant, above 0 where the design is worse
    excess: FloatArray


@dataclasses.dataclass(frozen=True)
class Light:
    """One of the lights: what it is about, its state, and why."""

    name: str
    state: State
    text: str


@dataclasses.dataclass(frozen=True)
class Verdict:
    """What a study says, requirements first."""

    title: str  # One line
    sentences: tuple[str, ...]  # Two at most: the score of the design named, and what it breaks or what is nearest
    lights: tuple[Light, ...]  # Score, stable, limits, other plants, tail, of the design named; scenarios
    place: int  # Of the design named, in the ranking
    # Where none meets the requirements: places of the designs with the smallest largest excess
    nearest: tuple[int, ...] = ()
    try_next: tuple[str, ...] = ()  # Sentences on what to try then
    recorded: float = 0.0  # Share of departures whose recorded path alone needs more than the friction

    @property
    def usable(self) -> bool:
        """Whether no light is red."""
        return not any(light.state == "bad" for light in self.lights)


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
    ahead: tuple[str, ...] = ()
    some = results.on_drivable().scenarios
    recorded = float(beyond_friction(some, setup).mean()) if some.n else 0.0
    acting = [i for i, design in enumerate(ranking.designs) if not design.is_baseline]
    meeting = [i for i in range(ranking.ranked) if not ranking.designs[i].is_baseline]
    if meeting or not acting:
        place = meeting[0] if ranking.winner is None and meeting else ranking.winner or 0
        title = _of_winner(ranking, place)
        sentences = [_score(ranking, place)]
        broken = _broken(ranking, place)
        if broken:
            sentences.append(f"It is not usable as it is: {_list(broken)}.")
    else:
        nearest = _nearest(ranking)
        place = nearest[0]
        only = "The design does not meet the limits"
        title = only if len(acting) == 1 else f"None of {len(acting)} designs meets the limits"
        misses = [miss.text for miss in ranking.missed[place]]
        sentences = [f"Nearest: {design_name(ranking.designs[place])}; it misses {_list(misses)}."]
        if recorded > 0:
            sentences.append(f"In {100 * recorded:.1f} % of departures the recorded path alone is beyond friction.")
        ahead = tuple(_try_next(ranking, place))
    lights = (
        _score_light(ranking, place),
        _stable_light(ranking, place),
        _limits_light(ranking, place),
        _plants_light(ranking, place, robustness),
        *_tail_light(ranking, results, setup, place),
        *_scenarios_light(model),
    )
    return Verdict(title, tuple(sentences), lights, place, nearest, ahead, recorded)


def law_title(design: Design) -> str:
    """Title of a design's law."""
    return design.kind.title


def gains_text(design: Design, between: str = " = ") -> str:
    """Gains that differ from their defaults."""
    return ", ".join(f"{name}{between}{value_text(value)}" for name, value in design.changed)


def design_name(design: Design) -> str:
    """A design in a sentence: law, threshold, gains that differ from their defaults."""
    return ", ".join(filter(None, (law_title(design), f"y_s = {design.y_s:g} m", gains_text(design))))


def value_text(value: GainValue) -> str:
    """A gain in a sentence."""
    return f"{value:g}" if isinstance(value, float) else str(value).lower() if isinstance(value, bool) else str(value)


def _list(parts: list[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def _of_winner(ranking: RankedDesigns, place: int) -> str:
    name = design_name(ranking.designs[place])
    if ranking.winner is None:
        return f"No winner: no finalist meets the requirements on the fresh scenarios. First: {name}"
    if ranking.requirements:
        return f"Best design that meets the limits: {name}"
    return f"{'Smallest S, but not usable' if _broken(ranking, place) else 'Smallest S'}: {name}"


def _score(ranking: RankedDesigns, i: int) -> str:
    """Of one sample, which it names."""
    of = (ranking.fresh.S, ranking.fresh.low, ranking.fresh.high)
    if not np.isfinite(ranking.fresh.S[i]):
        of = (ranking.metrics.S, ranking.inference.S_low, ranking.inference.S_high)
    S, low, high = (float(values[i]) for values in of)
    saved, values = ranking.saved(i), {one.requirement.metric.name: one.value for one in ranking.estimates(i)}
    level = f"{100 * ranking.confidence:g} % interval"
    between = f" ({level} {low:.3f} to {high:.3f})" if math.isfinite(low + high) else ""
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
    return f"Mean S {S:.3f} m s on {ranking.sample(i)}{between}{change}{costs}."


def _broken(ranking: RankedDesigns, place: int) -> list[str]:
    """What a design breaks of what every design on a road must keep: it is stable, and tyres can do it."""
    found = []
    if lost := int(metric_values("lost", ranking)[place]):
        found.append(f"it diverges in {lost} departure{'' if lost == 1 else 's'}")
    if float(metric_values("gain_margin", ranking)[place]) == 0.0:
        found.append("its linear loop is unstable at some speed")
    impossible = _impossible(ranking, place)
    if impossible:
        found.append(impossible)
    return found


def _impossible(ranking: RankedDesigns, place: int) -> str:
    """Lateral acceleration that no tyre gives."""
    most = next((one.limit for one in ranking.limits if one.set == "physical"), G)
    peak = float(metric_values("a_y_peak_max", ranking)[place])
    if not peak > most:
        return ""
    return f"a lateral acceleration of {peak:.3g} m/s\u00b2 ({peak / G:.2g} g) is physically impossible"


def _score_light(ranking: RankedDesigns, place: int) -> Light:
    saved = ranking.saved(place)
    if not math.isfinite(saved):
        return Light("Score", "unknown", "There is no score without control to compare with.")
    if saved <= 0:
        return Light("Score", "bad", "No better than without control.")
    others = int(ranking.inference.set_of_best.sum()) - 1
    if not ranking.inference.set_of_best[place] or others <= 0:
        return Light("Score", "good", f"{100 * saved:.1f} % less S than without control.")
    rest = f"{others} other design{'' if others == 1 else 's'} {'is' if others == 1 else 'are'} not separated from it"
    return Light("Score", "good", f"{100 * saved:.1f} % less S than without control; {rest}.")


def _stable_light(ranking: RankedDesigns, place: int) -> Light:
    lost, diverged = int(metric_values("lost", ranking)[place]), int(ranking.metrics.diverged[place])
    gain, phase = (float(metric_values(name, ranking)[place]) for name in ("gain_margin", "phase_margin"))
    missed = [one.text for one in ranking.estimates(place) if one.requirement.set == "stable" and not one.met]
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


def _limits_light(ranking: RankedDesigns, place: int) -> Light:
    impossible = _impossible(ranking, place)
    limited = [one for one in ranking.estimates(place) if one.requirement.set not in ("stable", "physical")]
    missed = [one.text for one in limited if one.required and not one.met]
    others = [one.text for one in limited if not one.required and not one.met]
    close = [one.with_interval(f"{100 * ranking.confidence:g} %") for one in limited if one.met and one.uncertain]
    if impossible:
        return Light("Limits", "bad", f"{_capital(impossible)}.")
    if missed:
        return Light("Limits", "bad", f"{_capital(_list(missed))}.")
    doubts = [f"Not required, but beyond comfort: {_list(others)}."] if others else []
    doubts += [f"Met on {ranking.sample(place)}, but not with certainty: {'; '.join(close)}."] if close else []
    if doubts:
        return Light("Limits", "warning", " ".join(doubts))
    names = dict.fromkeys([*(one.set or one.text for one in ranking.requirements), "comfort"])
    return Light("Limits", "good", f"Meets {_list(list(names))}.")


def depths(results: StudyResults, i: int, setup: Setup | None = None) -> tuple[FloatArray, FloatArray]:
    """Deepest positions of a design and without control on the departures that every design could be driven on [m]."""
    some, on = results.scenarios.take(results.drivable), setup or Setup()
    path = UncorrectedPath.of(some, on.options.residuals, on.seed)
    return results.metrics.deepest[i][results.drivable], path.deepest(some.T)


def _tail_light(ranking: RankedDesigns, results: StudyResults, setup: Setup, place: int) -> Iterator[Light]:
    """Whether the design named goes badly more often than no control does; none where that is not significant."""
    if text := tail_text(*depths(results, int(ranking.index[place]), setup)):
        yield Light("Tail", "bad", f"{_capital(text)}.")


def _scenarios_light(model: ScenarioModel | None) -> Iterator[Light]:
    """Whether generated departures give the answer of the recorded ones; none without a model."""
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


def _plants_light(ranking: RankedDesigns, place: int, robustness: OtherPlants | None) -> Light:
    name = "Other plants"
    if robustness is None or ranking.designs[place].id not in robustness.designs:
        return Light(name, "unknown", "Not tested on other plants.")
    i = robustness.designs.index(ranking.designs[place].id)
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
    p, most = max(ratio.items(), key=lambda one: one[1] if math.isfinite(one[1]) else 0.0)
    rise = f"{most:.2g} times its S" if most >= 2 else f"{100 * (most - 1):.0f} % more S"
    worst = f"Least favourable plant: {_small(robustness.titles[p])}, {rise}."
    text = worst if most > 1 else "S rises on none of them."
    return Light(name, "warning" if most > 1.5 else "good", text)


def optimism_text(ranking: RankedDesigns, i: int, unit: str = "m s") -> str:
    """How a design scored on fresh scenarios, against the study scenarios that it was chosen on."""
    change, low, high = ranking.fresh.optimism[i], ranking.fresh.optimism_low[i], ranking.fresh.optimism_high[i]
    word = "worse" if change > 0 else "better"
    of = ", as the difference to the baseline," if ranking.fresh.optimism_paired else ""
    chance = "within sampling error" if low <= 0 <= high else "more than sampling error"
    return (
        f"On fresh scenarios the winner scored{of} {abs(change):.4f} {unit} {word} than on the study scenarios "
        f"({low:+.4f} .. {high:+.4f}), {chance}."
    )


def _small(title: str) -> str:
    return title[:1].lower() + title[1:] if title[1:2].islower() else title


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _nearest(ranking: RankedDesigns) -> tuple[int, ...]:
    """Places of the designs with the smallest largest excess; those that intervene first."""
    largest = [max(miss.excess for miss in some) if some else 0.0 for some in ranking.missed]
    passive = [design.is_baseline for design in ranking.designs]
    total = [sum(miss.excess for miss in some) for some in ranking.missed]
    order = sorted(range(len(ranking)), key=lambda i: (passive[i], largest[i], total[i], i))
    return tuple(order[:_NEAREST])


def _try_next(ranking: RankedDesigns, place: int) -> Iterator[str]:
    """Where the nearest design stands in its sweep."""
    design = ranking.designs[place]
    own = [one for one in ranking.designs if one.law == design.law]
    values = {"y_s": design.y_s, **dict(design.gains)}
    ends = []
    for name, value in values.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            continue
        swept = sorted({float({"y_s": one.y_s, **dict(one.gains)}[name]) for one in own})
        if len(swept) > 1 and value in (swept[0], swept[-1]):
            ends.append(f"{name} {'below' if value == swept[0] else 'above'} {value:g}")
    if ends:
        yield f"The nearest design stands at an end of its sweep: try {_list(ends)}."
    else:
        yield f"{law_title(design)} comes closest; sweep its gains around the nearest design."


TOP: Final = 20  # rows of a notebook; the winner and the baseline follow where they are further down

RANKING_METRICS: Final = ("reduction", "a_y_added_peak_p95", "jerk_added_peak_p95", "needless")
"""Metrics beside S of every table that shows a ranking."""

COLUMNS_TEXT: Final = (
    "Less: reduction of mean S against no control. a_y, jerk: 95 % quantile of what control adds to the recorded path. "
    "Needless: share of departures with an intervention that stay within 0.3 m by themselves."
)
"""What the short headings mean."""


def ranking_table(ranking: RankedDesigns, places: Sequence[int]) -> Table:
    """Designs of a ranking by their places, for every reader."""
    heads = zip(("Less", "a_y", "Jerk", "Needless"), map(METRICS.__getitem__, RANKING_METRICS), strict=True)
    level = f"{100 * ranking.confidence:g} % interval"
    columns = [
        Column("Rank", key="rank"),
        Column("Law", text=True),
        Column("y_s", "m", "g", key="y_s", about="Trigger threshold"),
        Column("Gains", text=True, about="Gains that differ from their defaults"),
        Column("Mean S", "m\u00b7s", ".3f", key="S"),
        Column(level, "m\u00b7s", ".3f", about="Of mean S, for all designs at once"),
        *(Column(head, of.shown_unit, f".{of.digits}f", key=head.lower(), about=of.title) for head, of in heads),
        *([Column("Fresh S", "m\u00b7s", ".3f", key="fresh", about="Mean S on the fresh scenarios")]
          if ranking.fresh.scenarios else []),
        Column("Verdict", text=True),
    ]  # fmt: skip
    metrics = {name: METRICS[name].scale * metric_values(name, ranking) for name in RANKING_METRICS}
    rows = []
    for before, i in zip([-1, *places], places, strict=False):
        design, missed = ranking.designs[i], {miss.requirement.metric.name for miss in ranking.missed[i]}
        rank, S, low, high, fresh = (
            float(values[i])
            for values in (
                ranking.rank,
                ranking.metrics.S,
                ranking.inference.S_low,
                ranking.inference.S_high,
                ranking.fresh.S,
            )
        )
        cells: list[Cell | Value] = [
            int(rank) or math.nan, law_title(design), design.y_s, gains_text(design, "="), S, (low, high),
            *(Cell(float(values[i]), bad=name in missed) for name, values in metrics.items()),
            *([fresh] if ranking.fresh.scenarios else []),
            Cell(judged(ranking, i), bad=bool(missed)),
        ]  # fmt: skip
        kind = "winner" if i == ranking.winner else "baseline" if i == ranking.baseline else ""
        rows.append(Row(cells, kind, apart=i > before + 1))
    title = f"{len(ranking):,} design{'' if len(ranking) == 1 else 's'} by mean S, {ranking.label}"
    return Table(title, columns, rows, head=1)


def judged(ranking: RankedDesigns, place: int) -> str:
    """What a design is called in one phrase: winner, what it breaks, failures, baseline."""
    found = ["winner"] if place == ranking.winner else []
    if place == ranking.baseline:
        found.append("baseline")
    if ranking.missed[place]:
        sets = dict.fromkeys(miss.requirement.set or miss.requirement.text for miss in ranking.missed[place])
        most = max((miss.excess for miss in ranking.missed[place] if miss.requirement.limit), default=0.0)
        by = f" +{100 * most:.0f}%" if 0.005 <= most < 10 else ""
        found.append(f"breaks {', '.join(sets)}{by}")
    elif ranking.requirements:
        certain = not any(one.required and one.uncertain for one in ranking.estimates(place))
        found.append("meets all" if certain else "meets all, not with certainty")
    failed = failures(ranking, place)
    if failed:
        found.append(f"failed in {failed:,}")
    if (
        not ranking.missed[place]
        and place not in (ranking.winner, ranking.baseline)
        and ranking.inference.set_of_best[place]
    ):
        found.append("not separated")
    if ranking.pareto[place]:
        found.append("Pareto")
    return ", ".join(found)


def failures(ranking: RankedDesigns, place: int) -> int:
    """Scenarios of a design in which its law did not do its work."""
    counts = (
        ranking.metrics.solver_failed,
        ranking.metrics.diverged,
        ranking.metrics.timed_out,
        ranking.metrics.crashed,
    )
    return sum(int(count[place]) for count in counts)


def listed_places(ranking: RankedDesigns, most: int) -> list[int]:
    """Places of the first designs, the winner, the baseline and the best of each law."""
    named = {place for place in (ranking.winner, ranking.baseline) if place is not None}
    return sorted({*range(min(most, len(ranking))), *named, *ranking.best_of_each_law()[:most]})


def verdict_lines(found: Verdict) -> list[str]:
    """The verdict in its title, two sentences, its red and yellow lights, and what to try."""
    lights = [f"{light.name}: {light.text}" for light in found.lights if light.state in ("bad", "warning")]
    return [f"{found.title}.", *found.sentences, *lights, *found.try_next]


def set_of_best_line(ranking: RankedDesigns) -> str:
    """What these scenarios do not separate; empty where there is nothing to say of it."""
    size, level = int(ranking.inference.set_of_best.sum()), f"{100 * ranking.confidence:g} % confidence"
    if not ranking.ranked or len(ranking) == 1:
        return ""
    if size == 1:
        return f"Set of best: the first design alone, with {level}."
    return f"Set of best: {size:,} designs that these scenarios do not separate; with {level} the best is among them."


def more_lines(ranking: RankedDesigns) -> Iterator[str]:
    """What else a reader should know: the set of best, fresh scenarios, failures."""
    if set_of_best := set_of_best_line(ranking):
        yield set_of_best
    i, b = ranking.winner, ranking.baseline
    if i is not None and b is not None and b != i:
        fresh = bool(np.isfinite(ranking.fresh.baseline_difference[i]))
        of, name = ranking.fresh if fresh else ranking.inference, "baseline_difference"
        value, low, high = (float(getattr(of, name + end)[i]) for end in ("", "_low", "_high"))
        if math.isfinite(low):
            where = "fresh" if fresh else "study"
            yield (
                f"Winner minus baseline ({design_name(ranking.designs[b])}): {value:+.4f} m s ({low:+.4f} .. "
                f"{high:+.4f}) on the {where} scenarios."
            )
    if i is not None and ranking.fresh.scenarios and not np.isfinite(ranking.fresh.S[i]):
        yield "The winner was no finalist; it has no fresh score."
    if i is not None and np.isfinite(ranking.fresh.optimism[i]):
        yield optimism_text(ranking, i)
    if i is not None and ranking.fresh.difference[i] < 0 and ranking.fresh.difference_high[i] < 0:
        yield "It was not the first on the study scenarios: fresh scenarios separate the two."
    if i is not None and np.isfinite(ranking.replayed.S[i]):
        ends = (float(one[i]) for one in (ranking.replayed.S, ranking.replayed.low, ranking.replayed.high))
        own, lowest, highest = (f"{value:.3f}" for value in ends)
        saved = float(ranking.replayed.reduction[i])
        less = f", {100 * abs(saved):.1f} % {'less' if saved >= 0 else 'more'} than without control"
        yield (
            f"On {ranking.replayed.departures:,} replayed departures its mean S is {own} m s ({lowest} .. {highest})"
            f"{less if math.isfinite(saved) else ''}."
        )
        finalists = np.where(np.isfinite(ranking.fresh.S) & (ranking.rank > 0), ranking.replayed.S, np.inf)
        if (best := int(np.nanargmin(finalists))) != i:
            yield f"The first finalist there is {design_name(ranking.designs[best])}."
    if i is not None and (limited := [one for one in ranking.estimates(i) if one.required and one.interval]):
        texts = (one.with_interval(f"{100 * ranking.confidence:g} %") for one in limited)
        yield f"Required of the winner, on {ranking.sample(i)}: {'; '.join(texts)}."
    if ranking.ranked < len(ranking):
        left = len(ranking) - ranking.ranked
        yield f"{left:,} of {len(ranking):,} designs break a requirement and are not ranked."
    if ranking.pareto_metrics and ranking.pareto.any():
        yield (
            f"Pareto front over {', '.join(ranking.pareto_metrics)}: {int(ranking.pareto.sum())} designs, "
            "see ranking.csv."
        )
    if ranking.failed:
        yield f"{len(ranking.failed):,} design{'' if len(ranking.failed) == 1 else 's'} failed, without metrics."


def ranking_html(ranking: RankedDesigns, top: int = TOP) -> str:
    """What a notebook shows of a ranking."""
    table = ranking_table(ranking, listed_places(ranking, top))
    if ranking.winner is not None:
        best = f"Winner: {design_name(ranking.designs[ranking.winner])}."
    else:
        best = "No winner." if ranking.ranked else "None meets the requirements."
    return notebook_html((best, *more_lines(ranking)), ranking.warnings, table, len(ranking) - len(table.rows))
