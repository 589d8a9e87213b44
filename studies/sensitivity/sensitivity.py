"""Which gain matters: Sobol indices of mean S over each block of a study's designs."""

from __future__ import annotations

import dataclasses
import importlib
import math
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.declared import GainValue
from ldctoolkit.errors import InputError, LdcError

from ..design import Design
from ..design_space import THRESHOLD, DesignBlock
from ..ranking.inference import bootstrap_deviations, check_confidence, row_means
from ..results import StudyResults
from ..study_file import Study

Method = Literal["factorial", "saltelli", "rbd_fast"]

_SAME = 1e-6  # differences of mean S [m s] below this are solver tolerance, not variance
_MOST_MEANS = 20_000_000  # resampled means held at once (160 MB)

_MOST_PRODUCTS = 20_000_000_000
"""Scores times resamples of a grid: a few seconds. 5,000 designs on 10,000 scenarios get 400 resamples."""

_SALIB_SAMPLES = 200  # resamples of the interval of a sample's index: a standard error needs no more


@dataclasses.dataclass(frozen=True)
class BlockSensitivity:
    """Sobol indices of mean S over the designs of a law in a ``[[design]]`` table, or the reason for their absence."""

    block: int  # Position of the table in the study file, from 0
    law: str  # Registry name
    names: tuple[str, ...]  # The k dimensions that vary, ``"y_s"`` and gains
    designs: int  # Number of designs behind the indices
    method: Method | None = None  # None where there are no indices
    indices: Indices | None = None
    reason: str = ""  # Why there are no indices; empty otherwise
    note: str = ""  # What a reader must know of the indices; may be empty

    @property
    def interval_over(self) -> str:
        """The population of the intervals: ``"scenarios"`` of a grid, ``"designs"`` of a sample."""
        return {"factorial": "scenarios", None: ""}.get(self.method, "designs")


def gain_value(design: Design, name: str) -> GainValue:
    """Value of a dimension: the threshold under ``"y_s"``, or a gain."""
    return design.y_s if name == THRESHOLD else dict(design.gains)[name]


def sensitivity(results: StudyResults, study: Study) -> tuple[BlockSensitivity, ...]:
    """Sobol indices of mean S, block by block and law by law.

    Parameters
    ----------
    results : StudyResults
    study : Study

    Returns
    -------
    tuple of BlockSensitivity
        One for each law of each ``[[design]]`` table with more than one design. The designs of a full grid give exact
        first-order and total indices of the grid, those of a Saltelli sample estimates of both, those of a Latin
        hypercube or Sobol sample estimates of the first-order ones. S counts as in the ranking: failed scenarios at
        least as bad as without control, undrivable ones for no design.
    """
    results = results.on_drivable()
    return tuple(
        _of_block(results, study, number, block, law)
        for number, block in enumerate(study.design)
        for law, space in enumerate(block.space())
        if space.varying
    )


def _of_block(results: StudyResults, study: Study, number: int, block: DesignBlock, law: int) -> BlockSensitivity:
    space, side = block.space()[law], results.scenarios.side
    result = BlockSensitivity(number, space.law, space.varying, 0)
    try:
        if study.search is not None:
            raise LdcError("a search asks for designs where S is small; they are no sample of the space")
        sample = None if block.sample is None else block.samples()[law]
        designs = tuple(space.grid()) if sample is None else sample.designs
        scored = _with_results(results, designs, partial=block.sample is not None and block.sample.method != "saltelli")
        row = {design.id: i for i, design in enumerate(results.designs)}
        rows = np.array([row[designs[i].id] for i in scored], dtype=np.int64)
        S, confidence = row_means(results.counted, rows), study.ranking.confidence
        if np.ptp(S) <= _SAME:
            raise LdcError("all its designs have the same mean S; there is no variance to share out")
        result = dataclasses.replace(result, designs=len({designs[i].id for i in scored}))
        if sample is None or block.sample is None:
            levels = _levels(designs, space.varying)
            bound = min(_MOST_MEANS // S.size, _MOST_PRODUCTS // (S.size * side.size))
            samples = max(100, min(study.ranking.bootstrap, bound))
            means = bootstrap_deviations(results.counted, side, samples=samples, seed=study.seed, rows=rows)
            means += S
            indices = factorial_indices(S, means, levels, confidence=confidence)
            note = "exact for the grid's points, every one as likely as the others"
            return dataclasses.replace(result, method="factorial", indices=indices, note=note)
        if block.sample.method == "saltelli":
            indices = saltelli_indices(S, len(space.varying), confidence=confidence, seed=study.seed)
            return dataclasses.replace(result, method="saltelli", indices=indices)
        note = 'first order only; total indices need a full grid or sample.method = "saltelli"'
        note += f"; {len(designs) - len(scored)} failed designs are left out" if len(scored) < len(designs) else ""
        indices = rbd_fast_indices(sample.shares[scored], S, confidence=confidence, seed=study.seed)
        return dataclasses.replace(result, method="rbd_fast", indices=indices, note=note)
    except LdcError as error:
        return dataclasses.replace(result, reason=str(error))


def _with_results(results: StudyResults, designs: Sequence[Design], *, partial: bool) -> list[int]:
    """Positions of the designs with results; only failed designs may lack them, and only if that is allowed."""
    known = {design.id for design in results.designs}
    failed = {failure.design.id for failure in results.failed}
    ids = [design.id for design in designs]
    missing = set(ids) - known
    if missing and not (partial and missing <= failed):
        raise LdcError(f"{len(missing)} of its {len(set(ids))} designs have no results; indices need all of them")
    return [i for i, name in enumerate(ids) if name in known]


def _levels(designs: Sequence[Design], names: Sequence[str]) -> tuple[int, ...]:
    """Number of values of each dimension of a full grid."""
    columns = [[gain_value(design, name) for design in designs] for name in names]
    positions = [{value: i for i, value in enumerate(dict.fromkeys(column))} for column in columns]
    levels = tuple(len(position) for position in positions)
    codes = [np.array([at[value] for value in column]) for at, column in zip(positions, columns, strict=True)]
    if not np.array_equal(np.ravel_multi_index(tuple(codes), levels), np.arange(math.prod(levels))):
        raise LdcError("conditions on gains leave some combinations out; it is no full grid")
    return levels


LEAST_RBD_FAST = 64
"""Designs below which RBD-FAST is not used: its harmonics, and its interval from halves of the sample, need room."""

_HARMONICS = 6
"""Harmonics of RBD-FAST: with ten its error on 64 designs is 1.5 times as large; from 256 designs on it is equal."""


@dataclasses.dataclass(frozen=True)
class Indices:
    """First-order and total Sobol indices of k dimensions, with intervals; NaN where a method gives none."""

    # (k,) Share of the variance that is due to a dimension alone, 0 to 1. An estimate may leave that range by its error
    first: FloatArray
    first_low: FloatArray
    first_high: FloatArray
    # (k,) Share that remains when all other dimensions are known: `first` and all interactions with others
    total: FloatArray
    total_low: FloatArray
    total_high: FloatArray


def factorial_shares(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Exact first-order and total indices of numbers on full grids whose points are equally likely.

    With V the variance over the grid: V[E[Y | x_i]] / V, and E[V[Y | all but x_i]] / V. They are the sums of
    squares of the factorial's analysis of variance, of the main effect and of every term that x_i is part of.
    """
    axes = range(1, values.ndim)
    centred = values - values.mean(axis=tuple(axes), keepdims=True)
    variance = (centred**2).mean(axis=tuple(axes))
    variance = np.where(variance > 0.0, variance, np.nan)
    first = [centred.mean(axis=tuple(a for a in axes if a != i)) for i in axes]
    total = [centred - centred.mean(axis=i, keepdims=True) for i in axes]
    return (
        np.stack([(mean**2).mean(axis=1) / variance for mean in first], axis=1),
        np.stack([(rest**2).mean(axis=tuple(axes)) / variance for rest in total], axis=1),
    )


def factorial_indices(S: FloatArray, resampled: FloatArray, levels: Sequence[int], *, confidence: float) -> Indices:
    """Indices on a full grid, with intervals over scenarios."""
    first, total = (shares[0] for shares in factorial_shares(S.reshape(1, *levels)))
    # a resample without variance has no indices
    shares_of_resamples = factorial_shares(resampled.reshape(-1, *levels))
    firsts, totals = (shares[~np.isnan(shares).any(axis=1)] for shares in shares_of_resamples)
    if not len(firsts):
        raise InputError("S", "the same for all designs in every resample", hint="there is no variance to share out")
    check_confidence(confidence)
    tail = 0.5 * (1.0 - confidence)
    low, high, total_low, total_high = (
        q for shares in (firsts, totals) for q in np.quantile(shares, [tail, 1.0 - tail], axis=0)
    )
    return Indices(first, low, high, total, total_low, total_high)


def saltelli_indices(S: FloatArray, k: int, *, confidence: float, seed: int) -> Indices:
    """Indices from a Saltelli sample, by SALib; intervals over the sample's base points."""
    if S.ndim != 1 or S.size < 2 * (k + 2) or S.size % (k + 2):
        raise InputError("S", f"shape {S.shape}", allowed=f"a whole number of times k + 2 = {k + 2} rows, at least two")
    analysis = _analysed("sobol", k, S, confidence=confidence, seed=seed, calc_second_order=False)
    return Indices(*_around(analysis["S1"], analysis["S1_conf"]), *_around(analysis["ST"], analysis["ST_conf"]))


def rbd_fast_indices(x: FloatArray, S: FloatArray, *, confidence: float, seed: int) -> Indices:
    """First-order indices from any uniform sample, by SALib's RBD-FAST, which gives no total indices."""
    if S.size < LEAST_RBD_FAST:
        least = f"at least {LEAST_RBD_FAST} for first-order indices of a sample"
        raise InputError("designs", value=S.size, allowed=least)
    k = x.shape[1]
    analysis = _analysed("rbd_fast", k, x, S, confidence=confidence, seed=seed, M=_HARMONICS)
    undefined = np.full(k, np.nan)
    return Indices(*_around(analysis["S1"], analysis["S1_conf"]), undefined, undefined, undefined)


def _around(index: Any, half: Any) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Index, and the ends of its interval."""
    middle, width = np.asarray(index, dtype=np.float64), np.asarray(half, dtype=np.float64)
    return middle, middle - width, middle + width


def _analysed(method: str, k: int, *sample: FloatArray, confidence: float, seed: int, **options: Any) -> Any:
    """The analysis of SALib for k dimensions on the unit cube."""
    try:
        analyze = importlib.import_module(f"SALib.analyze.{method}").analyze
    except ImportError:
        hint = 'install the extra: pip install "ldctoolkit[sensitivity]"'
        raise LdcError("", "SALib is not installed, and Sobol indices of a sample need it", hint=hint) from None
    cube = {"num_vars": k, "names": [str(i) for i in range(k)], "bounds": [[0.0, 1.0]] * k}
    # odd, because SALib treats 0 as no seed
    seed = int(np.random.SeedSequence([seed, 0x736F626F]).generate_state(1)[0]) | 1
    return analyze(cube, *sample, num_resamples=_SALIB_SAMPLES, conf_level=confidence, seed=seed, **options)
