"""What a comparison found, in sentences with their intervals."""

from __future__ import annotations

import math
from collections.abc import Iterator

from markupsafe import Markup

from studies.comparison.comparison import PHRASES, CaseComparison, Comparison
from studies.comparison.paired_verdicts import Verdict
from studies.comparison.winners import Winners
from studies.report.section import Tile
from studies.report.words.text import difference_text, number, percent, plural, signed, symbols


def interval_text(low: float, high: float) -> str:
    """Both ends of an interval, or why there is none.

    Examples
    --------
    >>> interval_text(-0.02, 0.01), interval_text(float("nan"), float("nan"))
    ('−0.0200 to +0.0100', 'too few departures changed')
    """
    if math.isnan(low) or math.isnan(high):
        return "too few departures changed"
    if math.isinf(low) or math.isinf(high):
        return "too few departures"
    return f"{difference_text(low)} to {difference_text(high)}"


def lead(comparison: Comparison) -> list[Markup]:
    """The answer, each sentence a paragraph: winners, designs, failures."""
    first = comparison.cases[0]
    said = [_of_winners(first), _of_designs(comparison, first)]
    said += [
        one
        for verdict, words in ((Verdict.WORSE, "worse"), (Verdict.BETTER, "better"))
        if (one := _most(first, verdict, words)) is not None
    ]
    said += _of_failures(comparison)
    return said


def winner_tile(comparison: Comparison) -> Tile | None:
    """How much S of the new winner is from that of the old one; None where winners are not compared."""
    winners = comparison.cases[0].winners
    if winners is None:
        return None
    verdict = {
        Verdict.BETTER: "better",
        Verdict.WORSE: "worse",
        Verdict.SAME: "the same",
        Verdict.UNTOLD: "cannot be told",
    }[winners.verdict]
    what = f"{winners.new.label}, winner of both" if winners.same_design else "new winner against the old one"
    interval = interval_text(winners.low, winners.high)
    return Tile(difference_text(winners.difference), "m·s", f"S, {what}: {verdict}", f"interval {interval}")


def winners_text(winners: Winners) -> Markup:
    """Who won, against whom, and what follows."""
    shared = f"{winners.scenarios:,} {'fresh ' if winners.fresh else ''}shared departures"
    told = Markup("S&nbsp;=&nbsp;{}&nbsp;m·s before, {}&nbsp;m·s now: {}&nbsp;m·s (interval {}) on {}").format(
        number(winners.S_old, 4), number(winners.S_new, 4), difference_text(winners.difference),
        interval_text(winners.low, winners.high), shared,
    )  # fmt: skip
    if winners.same_design:
        said = Markup("<strong>{}</strong> is the winner of both studies and {}: {}.")
        verdict = {
            Verdict.BETTER: "is better now",
            Verdict.WORSE: "is worse now",
            Verdict.SAME: "scores the same",
            Verdict.UNTOLD: "whether its score changed cannot be told",
        }[winners.verdict]
        return said.format(symbols(winners.new.label), verdict, told)
    verdict = {
        Verdict.BETTER: "is better than",
        Verdict.WORSE: "is worse than",
        Verdict.SAME: "is as good as",
        Verdict.UNTOLD: "cannot be told apart from",
    }[winners.verdict]
    said = Markup("The new winner <strong>{}</strong> {} the old one, <strong>{}</strong>: {}.")
    return said.format(symbols(winners.new.label), verdict, symbols(winners.old.label), told)


def no_winners_text(case: CaseComparison) -> str:
    """Why winners are not compared."""
    if case.raced_elsewhere:
        return (
            "Winners are not compared here: a race of one of the studies gave designs up by their scores in another "
            "case, and the best one of this case may be among them."
        )
    return "No design of one of the studies meets its requirements: there is no winner to compare."


def _of_winners(case: CaseComparison) -> Markup:
    return symbols(no_winners_text(case)) if case.winners is None else winners_text(case.winners)


def _of_designs(comparison: Comparison, case: CaseComparison) -> Markup:
    if not len(case):
        return Markup("No design is in both studies, so that nothing but their winners can be compared.")
    counts = ", ".join(f"{case.count(verdict)} {PHRASES[verdict]}" for verdict in Verdict)
    said = Markup(
        "Of {} in both studies, in the {}: <strong>{}</strong>. Intervals hold for all designs in all cases at once, "
        "with {} confidence: if nothing had changed in truth, no design at all would be called better or worse in {} "
        "of such comparisons."
    )
    level = percent(comparison.confidence, 0)
    return said.format(plural(len(case), "design"), symbols(case.case.label), counts, level, level)


def _most(case: CaseComparison, verdict: Verdict, words: str) -> Markup | None:
    """The design that changed most of those with this verdict."""
    found = [i for i in case.order if case.S.verdict[i] is verdict]
    if not found:
        return None
    i, S = found[0], case.S
    old = float(S.S_old[i])
    share = f", {signed(100.0 * float(S.difference[i]) / old, 1)}\u00a0%" if old > 0 else ""
    said = Markup("Most {}: {}, {}&nbsp;m·s{} (interval {}), changed in {}.")
    return said.format(
        words, symbols(case.designs[i].label), difference_text(float(S.difference[i])), share,
        interval_text(float(S.low[i]), float(S.high[i])), plural(int(S.changed[i]), "departure"),
    )  # fmt: skip


def _of_failures(comparison: Comparison) -> Iterator[Markup]:
    if comparison.new_failures:
        yield Markup("<strong>{}</strong> that ran before {} now.").format(
            plural(len(comparison.new_failures), "design"), "fails" if len(comparison.new_failures) == 1 else "fail"
        )
    if comparison.repaired:
        yield Markup("{} that failed before {} now.").format(
            plural(len(comparison.repaired), "design"), "runs" if len(comparison.repaired) == 1 else "run"
        )
