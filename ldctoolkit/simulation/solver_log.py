"""Every solver call of a run: who, when, how it ended."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Self

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.control import SolverCalls


@dataclasses.dataclass(frozen=True)
class SolverLog:
    """The solver calls of a run, by scenario and then by sample; no rows for a law without a solver.

    Attributes
    ----------
    row : (k,) int
        The scenario: in a run its place among the triggered ones, in an outcome its row number.
    sample : (k,) int
        0 is the trigger.
    status : (k,) int
        How the call ended, in the law's own numbers: its docstring names them.
    iterations : (k,) int
    primal_residual, dual_residual : (k,)
        In the law's own units; NaN where the solver does not tell.
    """

    row: IntArray
    sample: IntArray
    status: IntArray
    iterations: IntArray
    primal_residual: FloatArray
    dual_residual: FloatArray

    @classmethod
    def of(cls, calls: Sequence[tuple[IntArray, int, SolverCalls]]) -> Self:
        """From the calls of each sample, with their scenarios and the sample's number."""
        row = _whole([rows for rows, _, _ in calls])
        sample = _whole([np.full(rows.size, sample) for rows, sample, _ in calls])
        order = np.lexsort((sample, row))  # stable: two calls for one command stay in their order
        made = [one for *_, one in calls]
        return cls(
            row=row[order],
            sample=sample[order],
            status=_whole([one.status for one in made])[order],
            iterations=_whole([one.iterations for one in made])[order],
            primal_residual=_real([one.primal_residual for one in made])[order],
            dual_residual=_real([one.dual_residual for one in made])[order],
        )

    def renamed(self, rows: IntArray) -> SolverLog:
        """The same with the scenarios' numbers from `rows`."""
        renamed = dataclasses.replace(self, row=rows[self.row])
        order = np.lexsort((renamed.sample, renamed.row))
        return SolverLog(**{f.name: getattr(renamed, f.name)[order] for f in dataclasses.fields(renamed)})


def _whole(parts: list[IntArray]) -> IntArray:
    return np.concatenate([np.zeros(0, dtype=np.int64), *parts]).astype(np.int64)


def _real(parts: list[FloatArray]) -> FloatArray:
    return np.concatenate([np.zeros(0), *parts])
