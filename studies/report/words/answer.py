"""The answer of the report in sentences: what won, by how much, how sure, at what cost, among how many."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Iterator
from typing import Final

import numpy as np
from markupsafe import Markup

from ldctoolkit import controller_class
from ldctoolkit.departures import LEFT
from ldctoolkit.metrics import DTLE_LIMIT
from ldctoolkit.vehicle.parameters import GRAVITY
from studies.paper_design import PAPER_LAW
from studies.report.context import Context
from studies.report.figures.landscape import on_the_edge
from studies.report.inputs import ReportInput
from studies.report.tables.case_table import CaseTable
from studies.report.tables.reduction import ratio_interval
from studies.report.tables.row import Interval, Row, is_baseline
from studies.report.tables.tabulate import tried
from studies.report.words.metric_text import metric_name, requirement_text
from studies.report.words.prose import between, between_differences, between_percent, design_text, rank_text
from studies.report.words.text import compact, difference_text, number, percent, plural, symbols
from studies.results import Race
from studies.robustness.robustness import Robustness

_NAMED = 3


@dataclasses.dataclass(frozen=True)
class Paragraph:
    """One paragraph of the answer."""

    text: Markup
    warning: bool = False


@dataclasses.dataclass(frozen=True)
class Answer:
    """The answer in a few sentences.

    Attributes
    ----------
    shown : tuple of Paragraph
        What wins, its gain over no control and over the paper's controller, what else may be the best, what it costs,
        what other plants do to it, and what limits the choice.
    more : tuple of Markup
        What is there for those who ask.
    """

    shown: tuple[Paragraph, ...]
    more: tuple[Markup, ...]


def answer(context: Context) -> Answer:
    """The answer of the primary case.

    Parameters
    ----------
    context : Context
    """
    shown = (Paragraph(text, warning=warning) for text, warning in _shown(context))
    return Answer(tuple(one for one in shown if one.text), tuple(text for text in _more(context) if text))


def _shown(context: Context) -> Iterator[tuple[Markup, bool]]:
    """Paragraphs, some of them empty, and whether each is a warning."""
    report, table = context.report, context.primary
    best = table.best
    acts = not is_baseline(best)
    *no_winner, lead = _lead(report, table)
    yield from ((text, False) for text in no_winner)
    yield Markup(" ").join((lead, _against_no_control(table))) if acts else lead, False
    if not acts:
        yield _no_improvement(table), False
    elif table.ranked:
        yield from ((_against(context, rival, words), False) for rival, words in _rivals(table))
    if acts and best.triggered == 0:
        yield (
            Markup("No departure went deep enough to trigger it, so the score is that of the uncorrected paths."),
            False,
        )
    if table.ranked:
        yield _set_of_best(table), False
    if acts:
        yield cost(context), False
        yield beyond_grip(context), True
        yield on_other_plants(context), False
    edge = on_the_edge(tried(report.results), best.index) if acts and table.ranked else ()
    if edge:
        said = Markup("{} sits at the end of what was tried for {}: a wider sweep may find a better one.")
        yield said.format(_capital(table.best_name), symbols(", ".join(edge))), False
    yield missed_requirements(table), False
    yield from ((text, False) for text in race_sentences(report, table))


def _more(context: Context) -> Iterator[Markup]:
    """Paragraphs, some of them empty."""
    table = context.primary
    winner = table.winner
    if winner is not None and winner.fresh is not None:
        yield _where_chosen(context.report, table, winner)
        if winner.place:
            yield _not_the_first(table.first, winner)
    yield _against_baseline(table)
    yield price_of_requirements(table)
    yield _pareto(table)


def _capital(text: str) -> str:
    return text[0].upper() + text[1:]


def among(table: CaseTable) -> str:
    """Of how many designs the first one has the lowest mean S: ``the 3 designs that a race left of 675 tried``."""
    d, ranked, all_of = len(table.rows), table.ranked, f"{table.tried:,} tried"
    raced = table.race is not None and bool(table.race.dropped)
    if 0 < ranked < d:
        meets = f"the {plural(ranked, 'design that meets', 'designs that meet')} the requirements"
        return f"{meets}, of {d:,} that a race left and {all_of}" if raced else f"{meets}, of {all_of}"
    if raced:
        return f"the {plural(d, 'design')} that a race left of {all_of}"
    return plural(d, "design") + (f" with results, of {all_of}" if table.tried > d else "")


def _lead(report: ReportInput, table: CaseTable) -> Iterator[Markup]:
    """What wins, with its score; before that, that there is no winner."""
    first, winner = table.first, table.winner
    if winner is not None and winner.fresh is not None:
        said = Markup(
            "<strong>{}</strong> is the winner: on {} fresh departures, on which no design was chosen, its mean score "
            "is <strong>S&nbsp;=&nbsp;{}&nbsp;m·s</strong> ({} interval {}, for all finalists at once)."
        )
        yield said.format(
            design_text(winner), f"{table.fresh_scenarios:,}", number(winner.fresh.value), percent(table.confidence, 0),
            between(winner.fresh),
        )  # fmt: skip
        return
    if winner is None and not table.ranked:
        yield Markup("<strong>No design meets the requirements</strong> ({}), so none is ranked and none wins.").format(
            requirements_text(table)
        )
    elif winner is None and table.require:
        yield Markup(
            "<strong>There is no winner</strong>: no finalist meets the requirements ({}) on the fresh departures."
        ).format(requirements_text(table))
    elif winner is None:
        yield Markup("<strong>There is no winner</strong>: see the warning above.")
    equal = sum(row.rank == first.rank for row in table.rows[1:]) if first.rank else 0
    alone = (table.ranked or len(table.rows)) == 1
    has = f"shares with {plural(equal, 'other')} the lowest" if equal else "has the lowest"
    name = design_text(first)
    said = Markup("{} {}: <strong>S&nbsp;=&nbsp;{}&nbsp;m·s</strong> ({} interval {}) {}.")
    yield said.format(
        name if winner is None else Markup("<strong>{}</strong>").format(name),
        f"is {_the_one(table)}, with mean score" if alone else f"{has} mean score of {among(table)}",
        number(first.S.value), percent(table.confidence, 0), between(first.S), _where(report, table),
    )  # fmt: skip


def _the_one(table: CaseTable) -> str:
    """What the only design is, of those that `among` counts."""
    return "the only design" if table.tried == 1 else among(table).replace("1 design", "only design", 1)


def _where(report: ReportInput, table: CaseTable) -> str:
    side = report.results.scenarios.side
    left = int((side == LEFT).sum())
    same = ", the same for all designs" if table.tried > 1 else ""
    return f"over {plural(side.size, 'generated departure')} ({left:,} left, {side.size - left:,} right{same})"


def _where_chosen(report: ReportInput, table: CaseTable, winner: Row) -> Markup:
    """What a winner with a fresh score had where designs were chosen."""
    place = f"the lowest of {among(table)}" if winner.rank == 1 else f"rank {winner.rank} of {among(table)}"
    said = Markup("Where designs were chosen, {}, its mean S is {} m·s ({} interval {}), {}.{}")
    return said.format(
        _where(report, table), number(winner.S.value), percent(table.confidence, 0), between(winner.S), place,
        _optimism(winner, paired=table.optimism_paired),
    )  # fmt: skip


def _optimism(winner: Row, *, paired: bool) -> str:
    if winner.optimism is None:
        return ""
    value, low, high = winner.optimism.value, winner.optimism.low, winner.optimism.high
    what = "Its difference to the baseline" if paired else "Its mean S"
    verdict = "no more than chance explains" if low <= 0 <= high else "more than chance explains"
    better = f"{_size(value)} m·s {'better' if value >= 0 else 'worse'}"
    interval = between_differences(winner.optimism)
    return f" {what} was {better} there than on the fresh ones (interval {interval}), {verdict}."


def _not_the_first(first: Row, winner: Row) -> Markup:
    """Why the winner is not the first of the ranking."""
    apart = winner.fresh_difference
    if first.fresh_unmet:
        why = f"misses {', '.join(requirement_text(one) for one in first.fresh_unmet)} on the fresh departures"
    elif first.fresh is None or apart is None:
        why = "has no fresh score"
    else:
        why = f"is worse on the fresh departures (difference of the winner to it {between_differences(apart)} m·s)"
    said = Markup("The lowest mean S there, {} m·s, has {}, which {}.")
    return said.format(number(first.S.value), design_text(first), symbols(why))


def _no_improvement(table: CaseTable) -> Markup:
    if any(row.S.value < table.best.S.value for row in table.rows):
        return Markup("No design that may win improves on leaving the departures alone.")
    return Markup("No design of this study improves on leaving the departures alone.")


def _against_no_control(table: CaseTable) -> Markup:
    """The gain, on fresh departures where there are some, and what it was where designs were chosen."""
    best = table.best
    if best.fresh_reduction is not None and best.fresh_uncorrected is not None:
        said = Markup("Against no control there ({} m·s) that is {}; where designs were chosen it was {}.")
        return said.format(number(best.fresh_uncorrected), _less(best.fresh_reduction), _share(best.reduction))
    where = ", where designs were chosen," if best.fresh is not None else ""
    said = Markup("Against no control ({} m·s){} that is {}.")
    return said.format(number(table.uncorrected), where, _less(best.reduction))


def _share(reduction: Interval) -> str:
    return f"{percent(abs(reduction.value))} {'less' if reduction.value >= 0 else 'more'}"


def _less(reduction: Interval) -> Markup:
    worse = reduction.value < 0
    shown = Interval(-reduction.value, -reduction.high, -reduction.low) if worse else reduction
    return Markup("<strong>{}</strong> (interval {})").format(_share(reduction), between_percent(shown))


def _against_baseline(table: CaseTable) -> Markup:
    """Empty where it is told already, as a share, or there is none."""
    best, baseline = table.best, table.baseline
    difference = best.fresh_to_baseline or best.to_baseline
    fresh = best.fresh_to_baseline is not None
    told = baseline is not None and is_baseline(baseline) and not fresh
    if baseline is None or baseline is best or difference is None or told or not table.ranked or is_baseline(best):
        return Markup("")
    said = Markup("{} difference to the baseline, {}, is {} m·s (interval {} m·s, for all {} at once).")
    return said.format(
        "On the fresh departures its" if fresh else "Its", design_text(baseline), difference_text(difference.value, 3),
        between_differences(difference), "finalists" if fresh else "designs",
    )  # fmt: skip


def _rivals(table: CaseTable) -> Iterator[tuple[Row, str]]:
    """The paper's own controller and the best design of its law; of another law where the study has none, or it won."""
    best, paper, tuned = table.best, table.paper_design, table.best_of(PAPER_LAW)
    if paper is not None and paper is not best:
        yield paper, "the paper\u2019s controller, Table I"
    if tuned is not None and tuned is not paper and best.design.law != PAPER_LAW:
        yield tuned, "the best design of the paper\u2019s law"
    if tuned is None or best.design.law == PAPER_LAW:
        others = [r for r in table.best_of_each_law if r.design.law != best.design.law and not is_baseline(r)]
        if others:
            yield others[0], "the best design of any other law"


def _against(context: Context, rival: Row, words: str) -> Markup:
    best = context.primary.best
    change = ratio_interval(context.S(best), context.S(rival), context.scenarios.side, context.primary.confidence)
    # one comparison that was named beforehand; those of the ranking hold for all designs at once
    said = Markup("Against {} ({}; {}, {} m·s){} it is <strong>{} m·s or {}</strong> (interval {}).{}")
    worse = change.value < 0
    shown = Interval(-change.value, -change.high, -change.low) if worse else change
    both = best.in_set and rival.in_set
    return said.format(
        words, design_text(rival), rank_text(rival), number(rival.S.value),
        " where designs were chosen" if best.fresh is not None else "", _size(rival.S.value - best.S.value),
        _share(change), between_percent(shown), " The two cannot be told apart on these departures." if both else "",
    )  # fmt: skip


def _size(difference: float) -> str:
    return difference_text(abs(difference), 3).removeprefix("+")


def _set_of_best(table: CaseTable) -> Markup:
    if len(table.rows) == 1:
        return Markup("It is the only design that was run to the end." if table.tried > 1 else
                      "It is the only design of this study.")  # fmt: skip
    best = table.best
    confidence = f"with {percent(table.confidence, 0)} confidence"
    if table.race is not None and table.race.dropped:
        both = max(0.0, 1.0 - 2.0 * (1.0 - table.confidence))
        confidence += f" (at least {percent(both, 0)} for race and ranking together)"
    design = "ranked design" if table.ranked < len(table.rows) else "design"
    others = [row for row in table.set_of_best if row is not best]
    listed = Markup("; ").join(Markup("{} ({})").format(design_text(row), rank_text(row)) for row in others[:_NAMED])
    listed += f"; and {len(others) - _NAMED:,} more" if len(others) > _NAMED else ""
    if not best.in_set:
        said = Markup("<strong>{} is not in the set of best</strong>, which holds {}: {}. The truly best {} is {} {}.")
        one = "that one" if len(others) == 1 else "one of these"
        return said.format(_capital(table.best_name), plural(len(others), "design"), listed, design, one, confidence)
    if not others:
        return Markup("No other {} is in the set of best: {}, no other {} is better in truth.").format(
            design, confidence, design
        )
    said = Markup(
        "<strong>{}</strong> {} in the set of best with it: the truly best {} is one of these {:,} {}, and these "
        "departures do not tell which. The {}: {}."
    )
    are, rest = ("is", "other") if len(others) == 1 else ("are", "others")
    return said.format(plural(len(others), "other design"), are, design, len(others) + 1, confidence, rest, listed)


def _pareto(table: CaseTable) -> Markup:
    if not table.pareto_figures or not table.ranked:
        return Markup("")
    count = sum(row.pareto for row in table.rows)
    said = Markup("The Pareto front over {} holds {} of the {}; the <a href='#ranking'>ranking</a> marks {}.{}")
    return said.format(
        symbols(", ".join(metric_name(name) for name in table.pareto_figures)),
        plural(count, "design"),
        f"{table.ranked:,} ranked",
        "it" if count == 1 else "them",
        " The winner is not on it." if table.winner is not None and not table.winner.pareto else "",
    )


_GRIP: Final = 0.9
"""Of the acceleration of gravity: what tyres give on a good road."""


def cost(context: Context) -> Markup:
    """One sentence; empty for a design that never took over.

    Parameters
    ----------
    context : Context
    """
    figures, best = context.ranking.release, context.primary.best
    comfortable = float(figures.comfortable[best.place])
    if math.isnan(comfortable):
        return Markup("")
    said = symbols(
        f"What it costs{' where designs were chosen' if best.fresh else ''}: peak a_y up to "
        f"{number(float(figures.a_y_peak_max[best.place]), 1)}\u00a0m/s\u00b2, steering rate up to "
        f"{number(math.degrees(float(figures.delta_rate_peak_max[best.place])), 1)}\u00a0\u00b0/s, "
        f"{percent(comfortable)} of interventions within the comfort limits of ISO 11270, and needless interventions "
        f"in {percent(float(figures.needless[best.place]))} of all departures (not deeper than "
        f"{compact(-DTLE_LIMIT)}\u00a0m without control)."
    )
    return said + Markup(" <a href='#limits'>What a release asks for</a>.")


def beyond_grip(context: Context) -> Markup:
    """A warning where tyres that never saturate gave more than tyres can; else empty.

    Parameters
    ----------
    context : Context
    """
    largest = float(context.ranking.release.a_y_peak_max[context.primary.best.place])
    if not (context.report.setup.options.tyres.ideal and largest > _GRIP * GRAVITY):
        return Markup("")
    shown = number(largest, 1)
    return symbols(
        f"A peak a_y of {shown}\u00a0m/s\u00b2 is not to be had on a road: the plant\u2019s tyres do not saturate."
    )


def race_sentences(report: ReportInput, table: CaseTable) -> Iterator[Markup]:
    """How many designs were given up, and which laws with them; none without a race."""
    race = table.race
    if race is None:
        return
    if not race.dropped:
        yield Markup("The study was a race, which gave up no design.")
        return
    steps = ", ".join(f"{alive:,} after {size:,}" for size, alive in zip(race.rounds, race.alive, strict=True))
    said = Markup(
        "The study was a race: {} of {} were given up before all departures were run, each once it was separable from "
        "the best by mean S in the primary case. Designs left by number of departures: {}. That took {} of the runs. "
        "Designs that were given up are in no figure and no table here, whatever their other figures would have been."
    )
    yield said.format(
        f"{len(race.dropped):,}", plural(table.tried, "design"), steps,
        percent(race.runs / race.full_runs if race.full_runs else 1.0),
    )  # fmt: skip
    left = {design.law for design in report.results.designs}
    gone = dict.fromkeys(one.design.law for one in race.dropped if one.design.law not in left)
    if gone:
        titles = ", ".join(controller_class(law).title for law in gone)
        yield Markup("No design is left of: {}.").format(symbols(titles))
    if PAPER_LAW in gone:
        yield _best_of_the_papers_law(race)


def _best_of_the_papers_law(race: Race) -> Markup:
    """What was known of the design of the law that stayed longest, when it was given up."""
    of_law = [one for one in race.dropped if one.design.law == PAPER_LAW]
    best = min(of_law, key=lambda one: (-one.round, one.difference))
    said = Markup(
        "Of the paper\u2019s law {} stayed longest: when it was given up, its mean S on {} was {} m·s, {} m·s above "
        "that of the best design then."
    )
    gap = difference_text(best.difference, 3).removeprefix("+")
    return said.format(symbols(best.design.label), plural(best.scenarios, "departure"), number(best.S), gap)


def requirements_text(table: CaseTable, joint: str = " and ") -> Markup:
    """All requirements with their units."""
    return symbols(joint.join(requirement_text(text) for text in table.require))


def missed_requirements(table: CaseTable) -> Markup:
    """How many designs miss which requirement; empty where none does."""
    missed = Counter(text for row in table.rows for text in row.unmet)
    if not missed:
        return Markup("")
    listed = ", ".join(f"{requirement_text(text)} ({count:,})" for text, count in missed.items())
    out = len(table.rows) - table.ranked
    said = Markup("{} of {} {} a requirement and {} not ranked: {}. Requirements are checked on the estimates.")
    return said.format(
        f"{out:,}", plural(len(table.rows), "design"), "misses" if out == 1 else "miss", "is" if out == 1 else "are",
        symbols(listed),
    )  # fmt: skip


def price_of_requirements(table: CaseTable) -> Markup:
    """Which designs with a lower mean S they keep out, or that all designs meet them; empty where neither is so."""
    if not table.require:
        return Markup("")
    if all(not row.unmet for row in table.rows):
        of = plural(len(table.rows), "design")
        each = f"The {of} meets" if len(table.rows) == 1 else f"All {of} meet"
        return Markup("{} the requirements ({}).").format(each, requirements_text(table, ", "))
    better = [row for row in table.rows if not row.rank and row.S.value < table.best.S.value]
    if not table.ranked or not better:
        return Markup("")
    said = Markup("Of the designs that miss a requirement {} a lower mean S than {}, the lowest {} m·s: {}.")
    return said.format(
        f"{len(better):,} {'has' if len(better) == 1 else 'have'}", table.best_name, number(better[0].S.value),
        design_text(better[0]),
    )  # fmt: skip


_STUDY, _TOGETHER, _IDEAL = "study", "together", "ideal"
_SEVERAL: Final = (_STUDY, _TOGETHER, _IDEAL)
"""Plants that are not one option away from the study's own."""


def on_other_plants(context: Context) -> Markup:
    """Worst single option for the winner: its change and rank there, and whether it fails; empty where none was driven.

    Parameters
    ----------
    context : Context
    """
    found = context.report.robustness
    if found is None or not found.n or found.designs[:1] != (context.primary.best.design.id,):
        return Markup("")
    single = [k for k, name in enumerate(found.plants) if name not in _SEVERAL and np.isfinite(found.change[k, 0])]
    if not single:
        return Markup("")
    worst = max(single, key=lambda k: float(found.change[k, 0]))
    change, own = float(found.change[worst, 0]), float(found.S[0, 0])
    if change <= 0.0:
        hurts = f"On other plants, one option at a time, none of {len(single)} makes its mean S worse"
    else:
        share = f" ({percent(change / own)} of its S)" if own > 0.0 else ""
        interval = _interval(found, worst)
        rank, among = int(found.rank[worst, 0]), int(np.count_nonzero(found.rank[worst]))
        place = f"; it has rank {rank} of {among} there" if rank and among > 1 else ""
        hurts = (
            f"On other plants, one option at a time, \u201c{found.titles[worst]}\u201d hurts it most: "
            f"{difference_text(change, 3)} m\u00b7s{share}{interval}{place}"
        )
    said = Markup("{}. Of {} it fails {} (<a href='#robustness'>robustness</a>).")
    return said.format(hurts, plural(found.n, "departure"), _failures(found, worst))


def _interval(found: Robustness, k: int) -> str:
    low, high = float(found.low[k, 0]), float(found.high[k, 0])
    known = np.isfinite(low) and np.isfinite(high)
    return f", interval {difference_text(low, 3)} to {difference_text(high, 3)}" if known else ", interval not known"


def _failures(found: Robustness, worst: int) -> str:
    """Whether it fails there, and with many options at once."""
    there = int(found.failures[worst, 0])
    words = f"in {there:,} there" if there else "in none there"
    if _TOGETHER not in found.plants:
        return words
    k = found.plants.index(_TOGETHER)
    if not np.isfinite(found.S[k, 0]):
        return f"{words}, and its law does not run on \u201c{found.titles[k]}\u201d"
    many = int(found.failures[k, 0])
    return f"{words}, and in {f'{many:,}' if many else 'none'} on \u201c{found.titles[k]}\u201d"
