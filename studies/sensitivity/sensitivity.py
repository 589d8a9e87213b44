"""Which gain matters: Sobol indices of mean S over each block of a study's designs."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.errors import LdcError
from ldctoolkit.gains import GainValue
from studies.design import Design
from studies.design_space.design_block import DesignBlock
from studies.design_space.law_space import THRESHOLD, LawSpace
from studies.ranking.bootstrap import bootstrap_deviations
from studies.ranking.row_blocks import row_means
from studies.results import CaseResults, StudyResults
from studies.sensitivity.sobol_indices import Indices, factorial_indices, rbd_fast_indices, saltelli_indices
from studies.study_file.ranking_settings import RankingSettings
from studies.study_file.spec import Study

Method = Literal["factorial", "saltelli", "rbd_fast"]

_SAME = 1e-6
"""Differences of mean S [m s] below this are solver tolerance: there is no variance to share out."""

_MOST_MEANS = 20_000_000
"""Resampled means held at once (160 MB)."""

_MOST_PRODUCTS = 20_000_000_000
"""Scores times resamples of one grid: some seconds. 5,000 designs on 10,000 scenarios get 400 resamples."""

_SALIB_SAMPLES = 200
"""Resamples behind an interval of a sample's index: it is a standard error, which needs no more."""


@dataclasses.dataclass(frozen=True)
class BlockSensitivity:
    """Sobol indices of mean S over the designs of one law in one ``[[design]]`` table, or why there are none.

    Attributes
    ----------
    block : int
        Position of the table in the study file, from 0.
    law : str
        Registry name.
    names : tuple of str
        The k dimensions that vary, ``"y_s"`` and gains.
    designs : int
        How many designs the indices come from.
    method : {"factorial", "saltelli", "rbd_fast"} or None
        How they were found; None where there are none.
    indices : Indices or None
    reason : str
        Why there are none; empty otherwise.
    note : str
        What a reader must know of them; may be empty.
    """

    block: int
    law: str
    names: tuple[str, ...]
    designs: int
    method: Method | None = None
    indices: Indices | None = None
    reason: str = ""
    note: str = ""

    @property
    def interval_over(self) -> str:
        """What the intervals are taken over: ``"scenarios"`` of a grid, ``"designs"`` of a sample."""
        return {"factorial": "scenarios", None: ""}.get(self.method, "designs")


def gain_value(design: Design, name: str) -> GainValue:
    """Value of a dimension: the threshold under ``"y_s"``, or a gain.

    Examples
    --------
    >>> gain_value(Design.from_gains("lqr", 0.1, {}), "y_s")
    0.1
    """
    return design.y_s if name == THRESHOLD else dict(design.gains)[name]


def sensitivity(results: StudyResults, study: Study, *, case: int = 0) -> tuple[BlockSensitivity, ...]:
    """Sobol indices of mean S, block by block and law by law.

    Parameters
    ----------
    results : StudyResults
        Of the study.
    study : Study
    case : int
        Which case; the primary one by default.

    Returns
    -------
    tuple of BlockSensitivity
        One for each law of each ``[[design]]`` table with more than one design. The designs of a full grid give exact
        first-order and total indices of the grid, those of a Saltelli sample estimates of both, those of a Latin
        hypercube or Sobol sample estimates of the first-order ones.

    Notes
    -----
    S counts as in the ranking: failed scenarios at least as bad as without control, undrivable ones for no design.
    """
    chosen = results.cases[case]
    drivable = chosen.drivable
    side = results.scenarios.side[drivable]
    chosen = chosen if drivable.all() else chosen.take(drivable)
    return tuple(
        _of_block(results, study, chosen, side, number, block, law)
        for number, block in enumerate(study.design)
        for law, space in enumerate(block.space())
        if space.varying
    )


class _NoIndices(Exception):
    """Says why there are none."""


@dataclasses.dataclass(frozen=True)
class _Scores:
    """The designs of one block and law, in the order of its table, and which rows of all scores are theirs."""

    space: LawSpace
    designs: tuple[Design, ...]
    rows: IntArray
    counted: FloatArray
    side: IntArray
    settings: RankingSettings
    seed: int

    @functools.cached_property
    def S(self) -> FloatArray:
        return row_means(self.counted, self.rows)


def _of_block(
    results: StudyResults, study: Study, case: CaseResults, side: IntArray, number: int, block: DesignBlock, law: int
) -> BlockSensitivity:
    space = block.space()[law]
    found = BlockSensitivity(number, space.law, space.varying, 0)
    try:
        if study.search is not None:
            raise _NoIndices("a search asks for designs where S is small; they are no sample of the space")
        sample = None if block.sample is None else block.samples()[law]
        designs = tuple(space.grid()) if sample is None else sample.designs
        kept = _with_results(results, designs, some=block.sample is not None and block.sample.method != "saltelli")
        row = {design.id: i for i, design in enumerate(results.designs)}
        rows = np.array([row[designs[i].id] for i in kept], dtype=np.int64)
        chosen = tuple(designs[i] for i in kept)
        scores = _Scores(space, chosen, rows, case.counted, side, study.ranking, study.seed)
        if np.ptp(scores.S) <= _SAME:
            raise _NoIndices("all its designs have the same mean S; there is no variance to share out")
        found = dataclasses.replace(found, designs=len({design.id for design in scores.designs}))
        if sample is None or block.sample is None:
            note = "exact for the grid's points, every one as likely as the others"
            return dataclasses.replace(found, method="factorial", indices=_of_grid(scores), note=note)
        if block.sample.method == "saltelli":
            return dataclasses.replace(found, method="saltelli", indices=_of_saltelli(scores))
        note = 'first order only; total indices need a full grid or sample.method = "saltelli"'
        note += f"; {len(designs) - len(kept)} failed designs are left out" if len(kept) < len(designs) else ""
        indices = _of_sample(scores, sample.shares[kept])
        return dataclasses.replace(found, method="rbd_fast", indices=indices, note=note)
    except (_NoIndices, LdcError) as error:
        return dataclasses.replace(found, reason=str(error))


def _with_results(results: StudyResults, designs: Sequence[Design], *, some: bool) -> list[int]:
    """Positions of the designs with results: all of them, unless a few that failed may be left out."""
    known = {design.id for design in results.designs}
    failed = {one.design.id for one in results.failed}
    given_up = {one.design.id for one in results.race.dropped} if results.race else set()
    ids = [design.id for design in designs]
    lost = set(ids) - known
    raced = len(lost & given_up)
    if raced:
        raise _NoIndices(f"the race gave up {raced} of its {len(set(ids))} designs; indices need a run without a race")
    if lost and not (some and lost <= failed):
        raise _NoIndices(f"{len(lost)} of its {len(set(ids))} designs have no results; indices need all of them")
    return [i for i, name in enumerate(ids) if name in known]


def _of_grid(scores: _Scores) -> Indices:
    columns = [[gain_value(design, name) for design in scores.designs] for name in scores.space.varying]
    positions = [{value: i for i, value in enumerate(dict.fromkeys(column))} for column in columns]
    levels = tuple(len(position) for position in positions)
    codes = [np.array([at[value] for value in column]) for at, column in zip(positions, columns, strict=True)]
    place = np.ravel_multi_index(tuple(codes), levels)
    if not np.array_equal(place, np.arange(math.prod(levels))):
        raise _NoIndices("conditions on gains leave some combinations out; it is no full grid")
    bound = min(_MOST_MEANS // place.size, _MOST_PRODUCTS // (place.size * scores.side.size))
    samples = max(100, min(scores.settings.bootstrap, bound))
    means = bootstrap_deviations(scores.counted, scores.side, samples=samples, seed=scores.seed, rows=scores.rows)
    means += scores.S
    return factorial_indices(scores.S, means, levels, confidence=scores.settings.confidence)


def _of_saltelli(scores: _Scores) -> Indices:
    return saltelli_indices(
        scores.S,
        len(scores.space.varying),
        confidence=scores.settings.confidence,
        samples=_SALIB_SAMPLES,
        seed=scores.seed,
    )


def _of_sample(scores: _Scores, shares: FloatArray) -> Indices:
    return rbd_fast_indices(
        shares, scores.S, confidence=scores.settings.confidence, samples=_SALIB_SAMPLES, seed=scores.seed
    )
