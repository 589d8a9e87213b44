"""A search: batches of designs are asked for, run, and told how good they were, until all trials are used."""

from __future__ import annotations

from collections.abc import Sequence

from studies.design import Design
from studies.ranking.ranking import Ranking
from studies.ranking.requirements import metric_values, requirements_of
from studies.running.campaign import Campaign
from studies.search.search import Search, Values


def run_search(campaign: Campaign) -> Sequence[Design]:
    """Run the search of a study; the designs that were tried.

    What the store holds is not run again: the same study asks for the same designs.
    """
    study, store, n = campaign.study, campaign.store, len(campaign.scenarios)
    search = Search(study)
    stored = store.known_designs()
    while batch := search.ask():
        campaign.table.add_designs(batch)
        # what an earlier run asked for is asked for again: its table stays until there is more to say
        if stored[: len(search.asked)] != search.asked:
            store.write_designs(search.asked)
        campaign.complete(batch, n, f"designs {len(search.asked) - len(batch) + 1} to {len(search.asked)}")
        search.tell(*_values_and_margins(campaign, batch))
    return search.asked


_RESAMPLES = 100
"""Of an interval that nobody reads: figures do not depend on it."""


def _values_and_margins(
    campaign: Campaign, batch: Sequence[Design]
) -> tuple[dict[str, Values | None], dict[str, Values]]:
    """The objectives of each design by its identifier, None for one that failed; and how far it misses requirements."""
    study, store = campaign.study, campaign.store
    values: dict[str, Values | None] = {design.id: None for design in batch}
    margins: dict[str, Values] = {}
    conventions = study.simulation.convention
    ran = [design for design in batch if not any(campaign.table.missing((design.id, c)) for c in conventions)]
    if not ran:
        return values, margins
    results = campaign.table.results(campaign.scenarios, store.times, {}, source=str(store.folder), designs=ran)
    ranking = Ranking.of(
        results, results.cases[0], seed=study.seed, bootstrap=_RESAMPLES, D_y=study.report.D_y, setup=study.setup()
    )
    columns = [metric_values(name, ranking) for name in study.search.objectives] if study.search else []
    wanted = requirements_of(study.ranking.require, study.plant)
    excess = [one.excess(metric_values(one.metric.name, ranking)) for one in wanted]
    for i, design in enumerate(ranking.designs):
        values[design.id] = tuple(float(column[i]) for column in columns)
        margins[design.id] = tuple(float(one[i]) for one in excess)
    return values, margins
