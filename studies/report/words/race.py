"""How a race went, in sentences."""

from __future__ import annotations

from collections.abc import Iterator

from markupsafe import Markup

from ldctoolkit import controller_class
from studies.paper_design import PAPER_LAW
from studies.report.inputs import ReportInput
from studies.report.tables.case_table import CaseTable
from studies.report.words.text import difference_text, number, percent, plural, symbols
from studies.results import Race


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
