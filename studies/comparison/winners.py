"""The winners of two studies against each other: has anything been found that beats what was best before?"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from ldctoolkit.errors import StoreError
from studies.comparison.paired_verdicts import Verdict, paired_differences
from studies.comparison.shared_scenarios import SharedScenarios
from studies.design import Design
from studies.ranking.ranking import Ranking
from studies.results import Case, CaseResults, StudyResults
from studies.storage.manifest import Manifest
from studies.storage.store import Store
from studies.study_file.spec import Study


@dataclasses.dataclass(frozen=True)
class FinishedStudy:
    """A study that ran to its end."""

    source: str  # What messages call it: its folder
    manifest: Manifest
    study: Study
    results: StudyResults

    @classmethod
    def read(cls, folder: str | Path) -> FinishedStudy:
        """Read the folder of a study."""
        store = Store.open(folder)
        if not store.manifest.finished:
            raise StoreError(f"{folder}: the study is not finished; run it into this folder again to go on")
        return cls(str(folder), store.manifest, store.manifest.read_study(), store.results())


def held_designs(results: StudyResults) -> dict[str, Design]:
    """All designs that a study met, by identifier: with results, failed, or given up in a race."""
    dropped = results.race.dropped if results.race is not None else ()
    every = (*results.designs, *(one.design for one in results.failed), *(one.design for one in dropped))
    return {design.id: design for design in every}


def input_differences(old: FinishedStudy, new: FinishedStudy) -> tuple[str, ...]:
    """What decides the numbers of two studies and is not the same, as ``"vehicle.m: 1000.0 -> 1100.0"``."""
    return tuple(_differences(old, new))


def _differences(old: FinishedStudy, new: FinishedStudy) -> Iterator[str]:
    was, now = old.manifest, new.manifest
    if was.model_hash != now.model_hash:
        texts = [f"{m.model} (content {m.model_hash[:12]})" for m in (was, now)]
        yield f"scenarios.model: {texts[0]} -> {texts[1]}"
    own = "ldctoolkit"
    yield from _changes({own: was.versions.get(own)}, {own: now.versions.get(own)}, "")
    yield from _changes(old.study.inputs(), new.study.inputs(), "")
    before, after = (held_designs(side.results) for side in (old, new))
    if before.keys() != after.keys():
        yield f"designs: {len(before)} -> {len(after)}, {len(before.keys() & after.keys())} of them in both"
    packages = [{k: v for k, v in m.versions.items() if k != own} | {"Python": m.python} for m in (was, now)]
    yield from _changes(packages[0], packages[1], "")


def _changes(old: dict[str, Any], new: dict[str, Any], prefix: str) -> Iterator[str]:
    for key in {**old, **new}:
        was, now = old.get(key), new.get(key)
        if was == now:
            continue
        if isinstance(was, dict) and isinstance(now, dict):
            yield from _changes(was, now, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}: {_text(was)} -> {_text(now)}"


def _text(value: Any) -> str:
    return "not set" if value is None else str(value)


_RIVALS: Final = 30
"""Designs of each study that could have won: all their pairs share the confidence."""

_MOST_ENTRIES: Final = 20_000_000
"""Differences of pairs held at once (160 MB); fewer rivals where there are more scenarios."""


@dataclasses.dataclass(frozen=True)
class Winners:
    """The new study's winner against the old study's."""

    # What each study's own ranking calls its winner
    old: Design
    new: Design
    # [m s] Mean over the shared scenarios
    S_old: float
    S_new: float
    # [m s] S_new - S_old, and its interval, valid although both were chosen by their scores; NaN as in
    # `PairedDifferences`
    difference: float
    low: float
    high: float
    verdict: Verdict
    scenarios: int  # How many scenarios they were compared on
    fresh: bool  # Whether these are fresh scenarios of both studies, on which no design was chosen

    @property
    def same_design(self) -> bool:
        """The same design won both."""
        return self.old.id == self.new.id


def compare_winners(
    before: FinishedStudy,
    after: FinishedStudy,
    case: Case,
    shared: SharedScenarios,
    fresh: SharedScenarios | None,
    *,
    bootstrap: int,
    confidence: float,
) -> Winners | None:
    """Compare the winners of two studies in one case.

    Winners are chosen by their scores, so an interval for one pair that was fixed beforehand would be too narrow.
    The interval here holds for all pairs of a design that could have won the old study and one that could have won
    the new one: the finalists on fresh scenarios, or else those that rank first, up to 30 of each.
    """
    rankings = (_ranking(before, case), _ranking(after, case))
    if rankings[0].winner is None or rankings[1].winner is None:
        return None
    results = (before.results, after.results)
    again = (_with_winner(before, rankings[0]), _with_winner(after, rankings[1]))
    on_fresh = False
    if fresh is not None and again[0] is not None and again[1] is not None:
        results, shared, on_fresh = (again[0], again[1]), fresh, True
    most = max(1, min(_RIVALS, math.isqrt(_MOST_ENTRIES // shared.n)))
    rivals = [_rivals(ranking, one, most) for ranking, one in zip(rankings, results, strict=True)]
    scores_old, scores_new = (
        _find(one, ranking.case).counted[chosen][:, rows]
        for one, ranking, chosen, rows in zip(results, rankings, rivals, (shared.old, shared.new), strict=True)
    )
    pairs = paired_differences(
        np.repeat(scores_old, len(scores_new), axis=0),
        np.tile(scores_new, (len(scores_old), 1)),
        shared.side,
        seed=after.study.seed,
        bootstrap=bootstrap,
        confidence=confidence,
    )
    old, new = (one.designs[chosen[0]] for one, chosen in zip(results, rivals, strict=True))
    return Winners(
        old=old,
        new=new,
        S_old=float(pairs.S_old[0]),
        S_new=float(pairs.S_new[0]),
        difference=float(pairs.difference[0]),
        low=float(pairs.low[0]),
        high=float(pairs.high[0]),
        verdict=pairs.verdict[0],
        scenarios=shared.n,
        fresh=on_fresh,
    )


def _find(results: StudyResults, case: Case) -> CaseResults:
    return next(one for one in results.cases if one.case == case)


def _ranking(side: FinishedStudy, case: Case) -> Ranking:
    """The study's own ranking, as far as it decides who wins."""
    study = side.study
    return Ranking.of(
        side.results,
        _find(side.results, case),
        seed=study.seed,
        bootstrap=study.ranking.bootstrap,
        confidence=study.ranking.confidence,
        D_y=study.report.D_y,
        require=study.ranking.require,
        setup=study.setup(),
        vehicles=study.vehicles,
    )


def _with_winner(side: FinishedStudy, ranking: Ranking) -> StudyResults | None:
    """The finalists' fresh results; None without the winner: other cases may have one that is no finalist."""
    fresh = side.results.fresh
    if fresh is None or ranking.winner is None:
        return None
    return fresh if ranking.designs[ranking.winner] in fresh.designs else None


def _rivals(ranking: Ranking, results: StudyResults, most: int) -> list[int]:
    """Positions of ranked designs in the results, the winner first."""
    place = {design.id: i for i, design in enumerate(results.designs)}
    ranked = sorted(range(ranking.ranked), key=lambda i: i != ranking.winner)
    at = [place[ranking.designs[i].id] for i in ranked if ranking.designs[i].id in place]
    return at[:most]
