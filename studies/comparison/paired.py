"""Two studies on shared scenarios: paired differences of mean S, and the comparison of their winners."""

from __future__ import annotations

import dataclasses
import enum
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.clusters import cluster_values, several
from ldctoolkit.departures import LEFT, RIGHT
from ldctoolkit.errors import InputError, StoreError
from ldctoolkit.paths.uncorrected import RandomStream
from ldctoolkit.plant_options import PlantOptions
from ldctoolkit.scenarios import Scenarios

from ..design import Design
from ..ranking.inference import SAME, bootstrap_means, check_confidence, error_parts, lengths, row_means
from ..ranking.ranking import Ranking
from ..results import StudyResults
from ..storage.checked_parts import differences
from ..storage.manifest import Manifest
from ..storage.store import Store
from ..study_file import Study


@dataclasses.dataclass(frozen=True)
class SharedScenarios:
    """Scenarios that are in two sets, as positions in each set."""

    # (n,) Position of each in the old and in the new set, in the order of the new one
    old: IntArray
    new: IntArray
    side: IntArray  # (n,) ``LEFT`` (+1) or ``RIGHT`` (-1)
    cluster: IntArray | None = None  # (n,) As `Scenarios.cluster`
    # Scenarios whose departure is in both sets, but with different random draws; they are not shared
    other_draws: int = 0

    @property
    def n(self) -> int:
        """Number of shared scenarios."""
        return int(self.old.size)

    @property
    def left(self) -> int:
        """Number of shared scenarios to the left."""
        return int(np.sum(self.side == LEFT))

    @property
    def right(self) -> int:
        """Number of shared scenarios to the right."""
        return int(np.sum(self.side == RIGHT))

    def take(self, rows: BoolArray) -> SharedScenarios:
        """The shared scenarios in these rows."""
        cluster = None if self.cluster is None else self.cluster[rows]
        return dataclasses.replace(self, old=self.old[rows], new=self.new[rows], side=self.side[rows], cluster=cluster)


def drawn_streams(options: PlantOptions) -> frozenset[RandomStream]:
    """The random streams that a plant draws for each scenario beside its parameters."""
    ranges = (getattr(options.mismatch, field.name) for field in dataclasses.fields(options.mismatch))
    uses = {
        RandomStream.MISMATCH: any(low != high for low, high in ranges),
        RandomStream.RESIDUAL_Y: options.residuals.y,
        RandomStream.RESIDUAL_V: options.residuals.v,
        RandomStream.CAMERA: options.sensors.e_y_noise > 0 or options.sensors.e_psi_noise > 0,
        RandomStream.CURVATURE: options.sensors.curvature_noise > 0,
        RandomStream.DRIVER: not options.driver.ideal,
    }
    return frozenset(stream for stream, used in uses.items() if used)


def share_scenarios(
    old: Scenarios, new: Scenarios, *, both_draw: bool = False, same_seed: bool = True
) -> SharedScenarios:
    """The scenarios that two sets share, compared by content."""
    group = _same_rows(np.concatenate([_parameter_rows(old), _parameter_rows(new)]))
    old_at, new_at = _pairs(group[: old.n], group[old.n :])
    every = new_at.size
    if both_draw:
        drawn = _same_rows(np.column_stack([group, np.concatenate([old.index, new.index])]))
        old_at, new_at = _pairs(drawn[: old.n], drawn[old.n :])
        if not same_seed:
            old_at, new_at = old_at[:0], new_at[:0]
    cluster = None if new.cluster is None else new.cluster[new_at]
    return SharedScenarios(old_at, new_at, new.side[new_at], cluster, every - new_at.size)


def _parameter_rows(scenarios: Scenarios) -> FloatArray:
    """Side and parameters of each scenario, (n, 9): equal rows are equal departures."""
    return np.column_stack([scenarios.side.astype(np.float64), scenarios.matrix()]) + 0.0  # -0.0 is 0.0


def _same_rows(table: npt.NDArray[np.generic]) -> IntArray:
    """A group number for each row; rows with the same bytes have the same number."""
    table = np.ascontiguousarray(table)
    whole = table.view(np.dtype((np.void, table.dtype.itemsize * table.shape[1]))).ravel()
    return np.unique(whole, return_inverse=True)[1].astype(np.int64).ravel()


def _pairs(old: IntArray, new: IntArray) -> tuple[IntArray, IntArray]:
    """Positions of equal numbers in the order of `new`; the k-th occurrence in `old` matches the k-th in `new`."""
    most = max(old.size, new.size, 1)
    _, old_at, new_at = np.intersect1d(
        old * most + _occurrence(old), new * most + _occurrence(new), assume_unique=True, return_indices=True
    )
    order = np.argsort(new_at, kind="stable")
    return old_at[order].astype(np.int64), new_at[order].astype(np.int64)


def _occurrence(group: IntArray) -> IntArray:
    """Number of earlier occurrences of each number."""
    order = np.argsort(group, kind="stable")
    ordered = group[order]
    first = np.searchsorted(ordered, ordered, side="left")
    count = np.empty(group.size, dtype=np.int64)
    count[order] = np.arange(group.size) - first
    return count


_STREAM: Final = 0x636D70  # separates these resamples from those of the rankings
_FLAT: Final = 1e-9  # deviations [m s] up to this are rounding: all scenarios of the row changed equally
_ROWS: Final = 500  # rows resampled at once; a constant, so that results do not depend on the machine


class Verdict(enum.StrEnum):
    """The verdict of the interval of a difference of mean S, new minus old."""

    BETTER = "better"
    WORSE = "worse"
    NOT_SEPARATED = "not separated"
    SAME = "same"


@dataclasses.dataclass(frozen=True)
class PairedDifferences:
    """Differences, new minus old, of k rows on n shared scenarios."""

    # (k,) [m s] Means over the shared scenarios
    S_old: FloatArray
    S_new: FloatArray
    difference: FloatArray  # (k,) [m s] S_new - S_old
    # (k,) [m s] Its interval, simultaneous over all rows of a comparison; NaN where too few scenarios changed
    low: FloatArray
    high: FloatArray
    changed: IntArray  # (k,) Scenarios that differ by more than 1e-6 m s
    largest: FloatArray  # (k,) [m s] The largest change of one scenario, with its sign; 0 where nothing changed
    largest_at: IntArray  # (k,) Position of that scenario among the shared ones
    verdict: tuple[Verdict, ...]


def paired_differences(
    old: FloatArray,
    new: FloatArray,
    side: IntArray,
    *,
    seed: int,
    cluster: IntArray | None = None,
    bootstrap: int = 2000,
    confidence: float = 0.95,
) -> PairedDifferences:
    """Compare k rows pair by pair, with simultaneous intervals; recorded departures by whole clusters (n,).

    The intervals are those of the studentised bootstrap (Efron and Tibshirani, An Introduction to the Bootstrap,
    1993, section 12.5), symmetric, with the largest |t| over all rows in place of that of each row (max-t; Romano and
    Wolf, Econometrica 73, 2005), so that they hold for all rows simultaneously. Unequal tails would follow the few
    scenarios that changed most: where only some scenarios change, they miss too often. A row is *the same* where no
    scenario changed by more than 1e-6 m s, or its interval lies within that of 0; *better* or *worse* where the
    interval lies beyond it. Where only m scenarios changed, even equal signs come about by chance with 2^(1 - m);
    rows where that is above (1 - confidence) / k have no interval and *not separated*.
    """
    check_confidence(confidence)
    if not (np.isfinite(old).all() and np.isfinite(new).all()):
        raise InputError("S is not finite in some scenario; a mean would drop or hide it")
    k, n = new.shape
    change = new - old
    moved = np.abs(change) > SAME
    changed = moved.sum(axis=1)
    largest_at = np.abs(change).argmax(axis=1) if n else np.zeros(k, dtype=np.int64)
    difference = row_means(change)
    low, high = difference.copy(), difference.copy()
    fewest = 1.0 + math.log2(max(k, 1) / (1.0 - confidence))
    too_few = (changed > 0) & (changed < fewest)
    low[too_few] = high[too_few] = np.nan
    rows = np.flatnonzero(changed >= fewest)
    if rows.size:
        values, strata = change[rows], side
        if (cluster := several(cluster)) is not None:
            values = cluster_values(values, cluster)
            strata = np.zeros(values.shape[1], dtype=np.int64)
        half = _half_widths(values, strata, bootstrap, seed, confidence)
        low[rows] -= half
        high[rows] += half
    return PairedDifferences(
        S_old=row_means(old),
        S_new=row_means(new),
        difference=difference,
        low=low,
        high=high,
        changed=changed.astype(np.int64),
        largest=np.where(changed > 0, change[np.arange(k), largest_at], 0.0),
        largest_at=largest_at.astype(np.int64),
        verdict=tuple(map(_interval_verdict, changed > 0, low, high)),
    )


def _interval_verdict(any_changed: bool, low: float, high: float) -> Verdict:
    if not any_changed or (low >= -SAME and high <= SAME):
        return Verdict.SAME
    if high < -SAME:
        return Verdict.BETTER
    return Verdict.WORSE if low > SAME else Verdict.NOT_SEPARATED


def _half_widths(values: FloatArray, side: IntArray, samples: int, seed: int, confidence: float) -> FloatArray:
    """Half width of each row's interval, (k,); infinite where a side has fewer than two scenarios."""
    strata = [side == which for which in np.unique(side)]
    if min(rows.sum() for rows in strata) < 2:
        return np.full(len(values), np.inf)  # a single scenario has no spread
    centred = values - row_means(values)[:, None]
    centred[np.abs(centred).max(axis=1) <= _FLAT] = 0.0
    farthest = np.zeros(samples)
    for first in range(0, len(values), _ROWS):
        block = centred[first : first + _ROWS]
        parts = [np.where(rows, block**power, 0.0) for rows in strata for power in (1, 2)]
        # a single call, so that rows, powers and sides share the resamples
        moments = bootstrap_means(np.concatenate(parts), side, samples=samples, seed=seed, stream=_STREAM)
        moments = moments.reshape(samples, len(strata), 2, len(block))
        mean, error = np.abs(moments[:, :, 0].sum(axis=1)), _errors(moments, strata)
        # a resample without spread that is off the mean is infinitely many standard errors away
        t = np.divide(mean, error, out=np.where(mean > 0.0, np.inf, 0.0), where=error > 0.0)
        np.maximum(farthest, t.max(axis=1), out=farthest)
    # no interpolation, because t may be infinite
    critical = float(np.quantile(farthest, confidence, method="higher"))
    error = lengths(error_parts(centred, side))
    return np.multiply(critical, error, out=np.zeros_like(error), where=error > 0.0)


def _errors(moments: FloatArray, strata: list[BoolArray]) -> FloatArray:
    """Standard errors of resampled means, (b, k), from what each side adds to mean and mean square, (b, s, 2, k)."""
    share = np.array([rows.mean() for rows in strata])[:, None]
    count = np.array([rows.sum() for rows in strata])[:, None]
    mean, square = moments[:, :, 0] / share, moments[:, :, 1] / share
    variance = np.maximum(square - mean**2, 0.0)
    result: FloatArray = np.sqrt((share**2 * variance / (count - 1.0)).sum(axis=1))
    return result


@dataclasses.dataclass(frozen=True)
class FinishedStudy:
    """A study that ran to its end."""

    source: str  # Its folder, for messages
    manifest: Manifest
    study: Study
    results: StudyResults

    @classmethod
    def read(cls, folder: str | Path) -> FinishedStudy:
        """Read the folder of a study."""
        store = Store.open(folder, current=False)  # only numbers are read: no law is run
        if not store.manifest.finished:
            raise StoreError(folder, "the study is not finished", hint="run it into this folder again to go on")
        return cls(str(folder), store.manifest, store.study, store.results())


def held_designs(results: StudyResults) -> dict[tuple[Any, ...], Design]:
    """All designs of a study by `Design.key`, those that failed included."""
    return {design.key: design for design in (*results.designs, *(failure.design for failure in results.failed))}


def input_differences(old: FinishedStudy, new: FinishedStudy) -> Iterator[str]:
    """Differences between inputs that decide the numbers of two studies, as ``"vehicle.m: 1000.0 -> 1100.0"``."""
    was, now = old.manifest, new.manifest
    if was.model_hash != now.model_hash:
        texts = [f"{m.model} (content {m.model_hash[:12]})" for m in (was, now)]
        yield f"scenarios.model: {texts[0]} -> {texts[1]}"
    package = "ldctoolkit"
    yield from _changes(*({package: m.versions.get(package)} for m in (was, now)))
    yield from _changes(*(s.inputs() | {"scenarios": s.identity()["scenarios"]} for s in (old.study, new.study)))
    yield from (f"law {name}: other code" for name in was.laws if was.laws[name] != now.laws.get(name, was.laws[name]))
    before, after = (held_designs(side.results) for side in (old, new))
    if before.keys() != after.keys():
        yield f"designs: {len(before)} -> {len(after)}, {len(before.keys() & after.keys())} of them in both"
    others = ({k: v for k, v in m.versions.items() if k != package} | {"Python": m.python} for m in (was, now))
    yield from _changes(*others)


def _changes(old: dict[str, Any], new: dict[str, Any]) -> Iterator[str]:
    """One line a difference between two groups of settings."""
    for key, *values in differences(old, new):
        was, now = ("not set" if value is None else str(value) for value in values)
        yield f"{key}: {was} -> {now}"


_RIVALS: Final = 30  # designs of each study that could have won: the interval holds for all their pairs

_MOST_ENTRIES: Final = 20_000_000
"""Differences of pairs in memory at once (160 MB); more scenarios leave fewer rivals."""


THRESHOLD: Final = 0.01
"""Differences of mean S [m s] below this do not matter in practice: 1 cm over 1 s."""


@dataclasses.dataclass(frozen=True)
class Winners:
    """The new study's winner against the old study's."""

    # The winner of each study's ranking
    old: Design
    new: Design
    # [m s] Mean over the shared scenarios
    S_old: float
    S_new: float
    # [m s] S_new - S_old, and its interval, valid although both were selected by their scores; NaN as in
    # `PairedDifferences`
    difference: float
    low: float
    high: float
    verdict: Verdict
    scenarios: int  # Number of scenarios of the comparison
    fresh: bool  # Whether these are fresh scenarios of both studies, which selected no design

    @property
    def same_design(self) -> bool:
        """Whether the same design is the winner of both studies."""
        return self.old.key == self.new.key

    @property
    def is_small(self) -> bool:
        """Whether the difference is too small to matter in practice."""
        return abs(self.difference) < THRESHOLD


def compare_winners(
    before: FinishedStudy,
    after: FinishedStudy,
    shared: SharedScenarios,
    fresh: SharedScenarios | None,
    *,
    bootstrap: int,
    confidence: float,
) -> Winners | None:
    """Compare the winners of two studies.

    Winners are selected by their scores, so an interval for a pair that is fixed beforehand would be too narrow.
    The interval here holds for all pairs of a design that could have won the old study and one that could have won
    the new one: the finalists on fresh scenarios, or else those that rank first, up to 30 of each.
    """
    rankings = (_ranking(before), _ranking(after))
    if rankings[0].winner is None or rankings[1].winner is None:
        return None
    results = (before.results, after.results)
    finalists = (_with_winner(before, rankings[0]), _with_winner(after, rankings[1]))
    on_fresh = False
    if fresh is not None and finalists[0] is not None and finalists[1] is not None:
        results, shared, on_fresh = (finalists[0], finalists[1]), fresh, True
    most = max(1, min(_RIVALS, math.isqrt(_MOST_ENTRIES // shared.n)))
    rivals = [_rivals(ranking, result, most) for ranking, result in zip(rankings, results, strict=True)]
    scores_old, scores_new = (
        result.counted[positions][:, rows]
        for result, positions, rows in zip(results, rivals, (shared.old, shared.new), strict=True)
    )
    pairs = paired_differences(
        np.repeat(scores_old, len(scores_new), axis=0),
        np.tile(scores_new, (len(scores_old), 1)),
        shared.side,
        cluster=shared.cluster,
        seed=after.study.seed,
        bootstrap=bootstrap,
        confidence=confidence,
    )
    old, new = (result.designs[positions[0]] for result, positions in zip(results, rivals, strict=True))
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


def _ranking(side: FinishedStudy) -> Ranking:
    """The study's ranking, with the settings that decide the winner."""
    study = side.study
    return Ranking.of(
        side.results,
        seed=study.seed,
        bootstrap=study.ranking.bootstrap,
        confidence=study.ranking.confidence,
        D_y=study.report.D_y,
        require=study.ranking.require,
        rank_by=study.ranking.rank_by,
        setup=study.setup(),
        vehicles=study.vehicles,
    )


def _with_winner(side: FinishedStudy, ranking: Ranking) -> StudyResults | None:
    """The results on fresh scenarios; None where the winner has none."""
    fresh = side.results.fresh
    if fresh is None or ranking.winner is None:
        return None
    return fresh if ranking.designs[ranking.winner] in fresh.designs else None


def _rivals(ranking: Ranking, results: StudyResults, most: int) -> list[int]:
    """Positions of ranked designs in the results, the winner first."""
    position = {design.id: i for i, design in enumerate(results.designs)}
    ranked = sorted(range(ranking.ranked), key=lambda i: i != ranking.winner)
    positions = [position[ranking.designs[i].id] for i in ranked if ranking.designs[i].id in position]
    return positions[:most]
