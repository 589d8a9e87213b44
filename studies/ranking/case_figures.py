"""What a ranking tells of each design by itself: means, tails, shares and counts over the scenarios of one case."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from ldctoolkit import EventStatus, Scenarios, Setup
from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.departures import LEFT, RIGHT
from ldctoolkit.errors import InputError, nearest
from ldctoolkit.metrics import DTLE_LIMIT
from ldctoolkit.paths.uncorrected import UncorrectedPath
from studies.design import NO_CONTROL, Design
from studies.ranking.release import ReleaseFigures, release_metrics
from studies.ranking.requirements import friction
from studies.ranking.row_blocks import row_blocks, row_means
from studies.results import CaseResults, StudyResults

_FEWEST_DIGITS = 6
"""Of an identifier, so that no law's name is taken for one."""


def find_baseline(baseline: str, results: StudyResults) -> int | None:
    """Position of the baseline in `results.designs`."""
    here = _found(baseline or NO_CONTROL, results.designs)
    if here:
        return here[0]
    dropped = () if results.race is None else results.race.dropped
    gone = [*(one.design for one in results.failed), *(one.design for one in dropped)]
    if not baseline or _found(baseline, gone):
        return None
    laws = list(dict.fromkeys(design.law for design in (*results.designs, *gone)))
    raise InputError(
        f"ranking.baseline: {baseline!r} is no law of this study, nor the start of a design's identifier "
        f"({_FEWEST_DIGITS} digits or more); {nearest(baseline, laws)}"
    )


def _found(baseline: str, designs: Sequence[Design]) -> list[int]:
    of_law = [i for i, design in enumerate(designs) if design.law == baseline]
    if of_law or not re.fullmatch(rf"[0-9a-f]{{{_FEWEST_DIGITS},12}}", baseline):
        return of_law
    of_start = [i for i, design in enumerate(designs) if design.id.startswith(baseline)]
    if len(of_start) > 1:
        raise InputError(
            f"ranking.baseline: {baseline!r} is the start of {len(of_start)} identifiers; allowed: more digits, as "
            f"{designs[of_start[0]].id!r}"
        )
    return of_start


_BLOCK_ENTRIES = 500_000
"""Scores sorted at once (4 MB)."""


def tail_figures(values: FloatArray, percent: int = 95) -> tuple[FloatArray, FloatArray]:
    """Quantile, and mean beyond it, of every row."""
    d, n = values.shape
    quantile, cvar = np.empty(d), np.empty(d)
    whole, rest = divmod(n * (100 - percent), 100)  # in whole numbers: 0.05 n is not exact
    size = max(1, _BLOCK_ENTRIES // n)
    place = percent * (n - 1) / 100
    low = math.floor(place)
    high = min(low + 1, n - 1)
    needed = sorted({low, high, max(n - whole - 1, 0), min(n - whole, n - 1)})
    for first in range(0, d, size):
        ordered = np.partition(values[first : first + size], needed, axis=1)
        rows = slice(first, first + size)
        quantile[rows] = ordered[:, low] + (ordered[:, high] - ordered[:, low]) * (place - low)
        # in order: a sum depends on it in the last bit
        worst = np.ascontiguousarray(np.sort(ordered[:, n - whole :], axis=1)).sum(axis=1)
        if rest:
            worst = worst + ordered[:, n - whole - 1] * (rest / 100)
        cvar[rows] = worst * (100 / (n * (100 - percent)))
    return quantile, cvar


@dataclasses.dataclass(frozen=True)
class CaseFigures:
    """Figures of d designs, arrays of d. S is S as it counts: a failed scenario (solver failed, diverged, timed out,
    crashed) at least as bad as without control, and never left out. Scenarios that cannot be driven under some
    design have no S: they are left out for all designs and counted in `invalid`.
    """

    # (d,) [m s] Mean over all scenarios and over those of a side; NaN for a side without scenarios
    S: FloatArray
    S_left: FloatArray
    S_right: FloatArray
    # (d,) [m s] 95 % quantile of S, and mean of the worst 5 %
    S_p95: FloatArray
    S_cvar95: FloatArray
    S_uncorrected: FloatArray  # (d,) [m s] Mean without control, over the same window
    # (d,) 1 - mean S / mean S_uncorrected
    reduction: FloatArray
    reduction_left: FloatArray
    reduction_right: FloatArray
    triggered: FloatArray  # (d,) Share of scenarios in which the design took over
    deeper: FloatArray  # (d,) Share of scenarios deeper than D_y
    # (d,) Scenarios with that status
    solver_failed: IntArray
    diverged: IntArray
    timed_out: IntArray
    crashed: IntArray
    beyond_delta_max: IntArray
    invalid: IntArray
    failed_solves: IntArray  # (d,) Commands that were not finite, or came from a fallback
    release: ReleaseFigures  # What is reported beside S


@dataclasses.dataclass(frozen=True)
class DrivableCase:
    """A case on the scenarios that can be driven under every design."""

    case: CaseResults
    scenarios: Scenarios  # The n of them
    counted: FloatArray  # (d, n) [m s] `CaseResults.counted`
    status: npt.NDArray[np.int8]  # (d, m) Of all scenarios, those that cannot be driven included

    @classmethod
    def of(cls, case: CaseResults, scenarios: Scenarios) -> Self:
        """Leave out what cannot be driven."""
        status, rows = case.status, case.drivable
        if not rows.any():
            raise InputError("results: no scenario could be driven under every design; there is nothing to rank")
        if not rows.all():
            case, scenarios = case.take(rows), scenarios.take(np.flatnonzero(rows))
        counted = case.counted
        if not np.isfinite(counted).all():
            raise InputError("results: S is not finite in some scenario; a mean would drop or hide it")
        return cls(case, scenarios, counted, status)

    @property
    def left_out(self) -> int:
        """Number of scenarios that are left out."""
        return int(self.status.shape[1]) - len(self.scenarios)


Margins = Mapping[str, tuple[float, float, float, float]]
"""Design -> gain and phase margin [rad] of its linear loop, S_worst [m s] and comfortable_worst of named vehicles."""

_BESIDE = ("gain_margin", "phase_margin", "S_worst", "comfortable_worst")


def case_figures(
    drivable: DrivableCase,
    designs: Sequence[Design],
    D_y: float,
    margins: Margins | None = None,
    setup: Setup | None = None,
) -> CaseFigures:
    """Figures of the designs of a case, in its order."""
    case, scenarios, counted = drivable.case, drivable.scenarios, drivable.counted
    every = np.ones(len(scenarios), dtype=np.bool_)
    rows = (every, scenarios.side == LEFT, scenarios.side == RIGHT)
    S, S_left, S_right = (_mean(counted, side) for side in rows)
    before, before_left, before_right = (_mean(case.S_uncorrected, side) for side in rows)
    S_p95, S_cvar95 = tail_figures(counted)
    taken = release_metrics(case, designs, scenarios.d_y, D_y=D_y)
    passive = [i for i, design in enumerate(designs) if design.is_baseline]
    kept = taken["within_dtle"][passive[0]] if passive else np.mean(-scenarios.d_y >= DTLE_LIMIT)
    taken["within_dtle_gain"] = taken["within_dtle"] - kept
    allowed = np.ones(len(scenarios), dtype=np.bool_) if setup is None else ~beyond_friction(scenarios, setup)
    taken["lost"] = ((case.status == EventStatus.DIVERGED) & allowed).sum(axis=1).astype(np.float64)
    nothing = (np.nan,) * len(_BESIDE)
    beside = np.array([(margins or {}).get(design.id, nothing) for design in designs], dtype=np.float64)
    taken |= dict(zip(_BESIDE, beside.reshape(-1, len(_BESIDE)).T, strict=True))

    def count(status: EventStatus) -> IntArray:
        result: IntArray = (drivable.status == status).sum(axis=1).astype(np.int64)
        return result

    return CaseFigures(
        S=S,
        S_left=S_left,
        S_right=S_right,
        S_p95=S_p95,
        S_cvar95=S_cvar95,
        S_uncorrected=before,
        reduction=mean_reduction(S, before),
        reduction_left=mean_reduction(S_left, before_left),
        reduction_right=mean_reduction(S_right, before_right),
        triggered=(case.status != EventStatus.NEVER_TRIGGERED).mean(axis=1),
        deeper=taken.pop("deeper"),
        solver_failed=count(EventStatus.SOLVER_FAILED),
        diverged=count(EventStatus.DIVERGED),
        timed_out=count(EventStatus.TIMED_OUT),
        crashed=count(EventStatus.CRASHED),
        beyond_delta_max=count(EventStatus.BEYOND_DELTA_MAX),
        invalid=count(EventStatus.INVALID),
        failed_solves=case.failed_solves.sum(axis=1).astype(np.int64),
        release=ReleaseFigures(**taken),
    )


def beyond_friction(scenarios: Scenarios, setup: Setup) -> BoolArray:
    """Departures whose recorded path alone needs more than the tyres of a plant give, (n,)."""
    path = UncorrectedPath.of(scenarios, setup.options.residuals, setup.seed)
    t = np.linspace(0.0, 1.0, 33) * scenarios.T[:, None]
    a_y = path.lateral_acceleration(t) + path.speed(t) ** 2 * path.curvature(t)
    result: BoolArray = np.abs(a_y).max(axis=1) > friction(setup.options)
    return result


def in_order(figures: CaseFigures, order: IntArray) -> dict[str, Any]:
    """Every figure by name, for some of the designs in the order given."""
    values = {field.name: getattr(figures, field.name) for field in dataclasses.fields(CaseFigures)}
    return {name: v.take(order) if isinstance(v, ReleaseFigures) else v[order] for name, v in values.items()}


def _mean(values: FloatArray, rows: BoolArray) -> FloatArray:
    if not rows.any():
        return np.full(values.shape[0], np.nan)
    if rows.all():
        return row_means(values)
    result = np.empty(values.shape[0])
    for places, block in row_blocks(values):
        result[places] = row_means(block[:, rows])
    return result


def mean_reduction(S: FloatArray, before: FloatArray) -> FloatArray:
    """Reduction 1 - S/before of means; 0 where there was nothing to reduce, NaN where there are no scenarios."""
    out = np.where(np.isnan(before), np.nan, 0.0)
    return 1.0 - np.divide(S, before, out=1.0 - out, where=before > 0)
