"""A race: rounds of nested scenarios, after each of which designs that are clearly not the best are given up."""

from __future__ import annotations

from collections.abc import Sequence

from studies.design import Design
from studies.racing.race import race_round
from studies.ranking.baseline import find_baseline
from studies.results import Dropped, Race
from studies.running.campaign import Campaign
from studies.storage.folder_tables import write_race


def run_race(campaign: Campaign) -> tuple[Sequence[Design], Race]:
    """Run the race of a study; the designs that are left, and how it went."""
    study, store, rounds = campaign.study, campaign.store, campaign.prefixes.stops
    alive, dropped, counts, runs = list(study.designs), [], [], 0
    failed: list[Design] = []  # not run again in every round
    before = 0
    for i, size in enumerate(rounds, start=1):
        campaign.complete(alive, size, f"round {i} of {len(rounds)}, {len(alive)} designs")
        runs += len(alive) * (size - before)
        before = size
        results = campaign.table.results(
            campaign.scenarios,
            {},
            store.failures,
            source=str(store.folder),
            designs=alive,
            rows=campaign.prefixes.rows(size),
        )
        case = results.cases[0]
        drivable = case.drivable
        decision = race_round(
            case.counted[:, drivable],
            results.scenarios.side[drivable],
            round=i,
            rounds=len(rounds),
            seed=study.seed,
            confidence=study.ranking.confidence,
            samples=study.ranking.bootstrap,
            started=len(study.designs),
        )
        reference = find_baseline(study.ranking.baseline, results)
        for k, design in enumerate(results.designs):
            # the baseline is in no race: all others are compared with it at the end
            if not decision.keep[k] and k != reference:
                figures = (float(values[k]) for values in (decision.mean, decision.difference, decision.low))
                dropped.append(Dropped(design, i, size, *figures))
        failed += [one.design for one in results.failed]
        gone = {design.id for design in (*(one.design for one in dropped), *failed)}
        alive = [design for design in alive if design.id not in gone]
        counts.append(len(alive))
    full = len(study.designs) * len(campaign.scenarios)
    conventions = len(study.simulation.convention)
    race = Race(rounds, tuple(counts), tuple(dropped), runs * conventions, full * conventions)
    write_race(store.folder, race, study.ranked_as)
    left = {design.id for design in (*alive, *failed)}
    return [design for design in study.designs if design.id in left], race
