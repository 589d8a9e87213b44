"""A race: rounds of nested scenarios, after each of which designs that are clearly not the best are given up."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray
from studies.design import Design
from studies.racing.race import race_round
from studies.ranking.baseline import find_baseline
from studies.ranking.ranking import Ranking
from studies.ranking.requirements import metric_values, requirements_of
from studies.results import Dropped, Race, StudyResults
from studies.running.campaign import Campaign
from studies.storage.folder_tables import write_race
from studies.study_file.spec import Study


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
        counted = case.counted[:, drivable]
        raced = _raced(study, results, counted.mean(axis=1))
        decision = race_round(
            counted[raced],
            results.scenarios.side[drivable],
            round=i,
            rounds=len(rounds),
            seed=study.seed,
            confidence=study.ranking.confidence,
            samples=study.ranking.bootstrap,
            started=len(study.designs),
        )
        reference = find_baseline(study.ranking.baseline, results)
        for k, place in enumerate(raced.tolist()):
            # the baseline is in no race: all others are compared with it at the end
            if not decision.keep[k] and place != reference:
                numbers = (float(values[k]) for values in (decision.mean, decision.difference, decision.low))
                dropped.append(Dropped(results.designs[place], i, size, *numbers))
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


_SPARE = 0.1
"""Part of every limit that the design compared with keeps in reserve: more scenarios may cost it."""


def _raced(study: Study, results: StudyResults, mean: FloatArray) -> IntArray:
    """Designs that a round may give up: those no better than the best one that clearly meets the requirements.

    A better one that misses a requirement now may meet it on more scenarios; one that is worse can only lose. Without
    requirements these are all; where none meets them, it is none but the best by S.
    """
    if not study.ranking.require:
        return np.arange(len(mean))
    figures = Ranking.of(results, results.cases[0], bootstrap=100, setup=study.setup(), D_y=study.report.D_y)
    worst = np.full(len(mean), -np.inf)
    for one in requirements_of(study.ranking.require, study.plant):
        excess = one.excess(metric_values(one.metric.name, figures))
        # a count of none, and a margin that no more scenarios change, have nothing to spare
        spare = 0.0 if not one.limit or one.metric.group == "loop" else _SPARE
        worst[figures.index] = np.maximum(worst[figures.index], np.where(np.isneginf(excess), -1.0, excess) + spare)
    acting = np.array([not design.is_baseline for design in results.designs])
    clear = np.flatnonzero((worst <= 0.0) & acting)
    best = mean.argmin() if not clear.size else clear[mean[clear].argmin()]
    return np.flatnonzero(mean >= mean[best]) if clear.size else np.array([best])
