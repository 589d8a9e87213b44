"""The answer of the report in sentences: what won, by how much, how sure, and among how many."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from markupsafe import Markup

from ldctoolkit import controller_class
from ldctoolkit.departures import LEFT
from studies.paper_design import PAPER_LAW
from studies.report.context import Context
from studies.report.figures.landscape import on_the_edge
from studies.report.inputs import ReportInput
from studies.report.tables.case_table import CaseTable
from studies.report.tables.reduction import ratio_interval
from studies.report.tables.row import Interval, Row, is_baseline
from studies.report.tables.tabulate import tried
from studies.report.words.prose import between, between_percent, design_text, rank_text
from studies.report.words.text import number, percent, plural, signed, symbols

_NAMED = 3


def answer(context: Context) -> list[Markup]:
    """The answer in a few sentences, each a paragraph.

    Parameters
    ----------
    context : Context

    Returns
    -------
    list of Markup
        Of the primary case: what wins, its gain over no control, over the paper's controller and over the
        baseline, what else may be the best, and what limits the choice.
    """
    report, table = context.report, context.primary
    best = table.best
    sentences = list(_lead(report, table))
    if is_baseline(best):
        sentences.append(_no_improvement(table))
    else:
        sentences.append(_against_no_control(table))
        sentences += _against_others(context)
        if best.triggered == 0:
            sentences.append(
                Markup("No departure went deep enough to trigger it, so the score is that of the uncorrected paths.")
            )
    if table.ranked:
        sentences.append(_set_of_best(table))
        edge = () if is_baseline(best) else on_the_edge(tried(report.results), best.index)
        if edge:
            said = Markup("{} sits at the end of what was tried for {}: a wider sweep may find a better one.")
            name = table.best_name[0].upper() + table.best_name[1:]
            sentences.append(said.format(name, symbols(", ".join(edge))))
    sentences += _requirements(table)
    sentences += _pareto(table)
    sentences += _race(report, table)
    return sentences


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
    n, first, winner = report.results.scenarios.n, table.first, table.winner
    left = int((report.results.scenarios.side == LEFT).sum())
    where = f"over {plural(n, 'generated departure')} ({left:,} left, {n - left:,} right), the same for all designs"
    if winner is not None and winner.fresh is not None:
        said = Markup(
            "<strong>{}</strong> is the winner. On {} fresh departures, on which no design was chosen, its mean score "
            "is <strong>S&nbsp;=&nbsp;{}&nbsp;m·s</strong> ({} interval {}, for all finalists at once)."
        )
        yield said.format(
            design_text(winner), f"{table.fresh_scenarios:,}", number(winner.fresh.value), percent(table.confidence, 0),
            between(winner.fresh),
        )  # fmt: skip
        said = Markup("On the departures that designs were chosen on its mean S is {} m·s ({} interval {}), {}, {}.{}")
        place = f"the lowest of {among(table)}" if winner.rank == 1 else f"rank {winner.rank} of {among(table)}"
        yield said.format(
            number(winner.S.value), percent(table.confidence, 0), between(winner.S), place, where,
            _optimism(winner, paired=table.optimism_paired),
        )  # fmt: skip
        if winner.place:
            yield _not_the_first(first, winner)
        return
    equal = sum(row.rank == first.rank for row in table.rows[1:]) if first.rank else 0
    has = f"shares with {plural(equal, 'other')}" if equal else "has"
    if winner is None and not table.ranked:
        yield Markup("<strong>No design meets the requirements</strong> ({}), so none is ranked and none wins.").format(
            symbols(" and ".join(table.require))
        )
    elif winner is None:
        yield Markup(
            "<strong>There is no winner</strong>: no finalist meets the requirements ({}) on the fresh departures."
        ).format(symbols(" and ".join(table.require)))
    said = Markup("{} {} the lowest mean score of {}: <strong>S&nbsp;=&nbsp;{}&nbsp;m·s</strong> ({} interval {}) {}.")
    name = design_text(first)
    yield said.format(
        name if winner is None else Markup("<strong>{}</strong>").format(name), has, among(table),
        number(first.S.value), percent(table.confidence, 0), between(first.S), where,
    )  # fmt: skip


def _optimism(winner: Row, *, paired: bool) -> str:
    if winner.optimism is None:
        return ""
    value, low, high = winner.optimism.value, winner.optimism.low, winner.optimism.high
    what = "Its difference to the baseline" if paired else "Its mean S"
    verdict = "no more than chance explains" if low <= 0 <= high else "more than chance explains"
    better = f"{number(abs(value))} m·s {'better' if value >= 0 else 'worse'}"
    return f" {what} was {better} there than on the fresh ones (interval {between(winner.optimism)}), {verdict}."


def _not_the_first(first: Row, winner: Row) -> Markup:
    """Why the winner is not the first of the ranking."""
    apart = winner.fresh_difference
    if first.fresh_unmet:
        why = f"misses {', '.join(first.fresh_unmet)} on the fresh departures"
    elif first.fresh is None or apart is None:
        why = "has no fresh score"
    else:
        why = f"is worse on the fresh departures (difference of the winner to it {between(apart)} m·s)"
    said = Markup("The lowest mean S there, {} m·s, has {}, which {}.")
    return said.format(number(first.S.value), design_text(first), symbols(why))


def _no_improvement(table: CaseTable) -> Markup:
    if any(row.S.value < table.best.S.value for row in table.rows):
        return Markup("No design that may win improves on leaving the departures alone.")
    return Markup("No design of this study improves on leaving the departures alone.")


def _against_no_control(table: CaseTable) -> Markup:
    change = table.best.reduction
    saved = change.value
    word = "less" if saved >= 0 else "more"
    shown = change if saved >= 0 else Interval(-saved, -change.high, -change.low)
    on = " on the same departures" if table.best.fresh is not None else ""
    return Markup("Against no control ({} m·s){} that is <strong>{} {}</strong> (interval {}).").format(
        number(table.uncorrected), on, percent(shown.value), word, between_percent(shown)
    )


def _against_others(context: Context) -> Iterator[Markup]:
    table = context.primary
    if not table.ranked:
        return
    for rival, words in _rivals(table):
        yield _against(context, rival, words)
    best, baseline = table.best, table.baseline
    difference = best.fresh_to_baseline or best.to_baseline
    if baseline is None or baseline is best or difference is None:
        return
    fresh = best.fresh_to_baseline is not None
    if is_baseline(baseline) and not fresh:
        return  # told already, as a share
    said = Markup("{} difference to the baseline, {}, is {} m·s (interval {} m·s, for all {} at once).")
    yield said.format(
        "On the fresh departures its" if fresh else "Its", design_text(baseline), signed(difference.value),
        between(difference), "finalists" if fresh else "designs",
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
    worse = change.value < 0
    shown = Interval(-change.value, -change.high, -change.low) if worse else change
    where = " on the same departures" if best.fresh is not None else ""
    # one comparison that was named beforehand; those of the ranking hold for all designs at once
    said = Markup("Against {} ({}; {}, {} m·s){} it is <strong>{} m·s or {} {}</strong> (interval {}).{}")
    return said.format(
        words, design_text(rival), rank_text(rival), number(rival.S.value), where,
        number(abs(rival.S.value - best.S.value)), percent(shown.value), "more" if worse else "less",
        between_percent(shown), " The two cannot be told apart on these departures." if rival.in_set else "",
    )  # fmt: skip


def _set_of_best(table: CaseTable) -> Markup:
    if len(table.rows) == 1:
        return Markup("It is the only design that was run to the end." if table.tried > 1 else
                      "It is the only design of this study.")  # fmt: skip
    confidence = f"with {percent(table.confidence, 0)} confidence"
    if table.race is not None and table.race.dropped:
        both = max(0.0, 1.0 - 2.0 * (1.0 - table.confidence))
        confidence += f" (at least {percent(both, 0)} for race and ranking together)"
    others = [row for row in table.set_of_best if row is not table.best]
    if not others:
        other = "other ranked design" if table.ranked < len(table.rows) else "other design"
        return Markup("No other design is in the set of best: {}, no {} is better in truth.").format(confidence, other)
    said = Markup(
        "<strong>{}</strong> {} in the set of best with it: the truly best {} is one of these {:,} {}, and these "
        "departures do not tell which. The others: {}{}."
    )
    return said.format(
        plural(len(others), "other design"),
        "is" if len(others) == 1 else "are",
        "ranked design" if table.ranked < len(table.rows) else "design",
        len(others) + 1,
        confidence,
        Markup("; ").join(Markup("{} ({})").format(design_text(row), rank_text(row)) for row in others[:_NAMED]),
        f"; and {len(others) - _NAMED:,} more" if len(others) > _NAMED else "",
    )


def _requirements(table: CaseTable) -> Iterator[Markup]:
    if not table.require:
        return
    missed = Counter(text for row in table.rows for text in row.unmet)
    if not missed:
        yield Markup("All {} meet the requirements ({}).").format(
            plural(len(table.rows), "design"), symbols(", ".join(table.require))
        )
        return
    listed = ", ".join(f"{text} ({count:,})" for text, count in missed.items())
    out = len(table.rows) - table.ranked
    said = Markup("{} of {} {} a requirement and {} not ranked: {}. Requirements are checked on the estimates.")
    yield said.format(
        f"{out:,}", plural(len(table.rows), "design"), "misses" if out == 1 else "miss", "is" if out == 1 else "are",
        symbols(listed),
    )  # fmt: skip
    if not table.ranked:
        return
    better = [row for row in table.rows if not row.rank and row.S.value < table.best.S.value]
    if better:
        said = Markup("{} of these {} a lower mean S than {}, the lowest {} m·s: {}.")
        yield said.format(
            f"{len(better):,}", "has" if len(better) == 1 else "have", table.best_name, number(better[0].S.value),
            design_text(better[0]),
        )  # fmt: skip


def _pareto(table: CaseTable) -> Iterator[Markup]:
    count = sum(row.pareto for row in table.rows)
    if not table.pareto_figures or not table.ranked:
        return
    said = Markup("The Pareto front over {} holds {} of the {}; the <a href='#ranking'>ranking</a> marks {}.{}")
    winner = table.winner is not None and not table.winner.pareto
    yield said.format(
        symbols(", ".join(table.pareto_figures)),
        plural(count, "design"),
        f"{table.ranked:,} ranked",
        "it" if count == 1 else "them",
        " The winner is not on it." if winner else "",
    )


def _race(report: ReportInput, table: CaseTable) -> Iterator[Markup]:
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
