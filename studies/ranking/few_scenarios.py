"""What a reader must know of intervals from few scenarios, or from critical values of few designs."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from ldctoolkit.departures import LEFT
from studies.ranking.inference import Inference
from studies.ranking.standard_error import spread_is_known

FEW = 50
"""Scenarios below which intervals are too short by a figure that matters, see docs/ranking.md."""

FEW_OF_A_SIDE = 10


def warnings_of_sample(side: npt.NDArray[np.signedinteger], inference: Inference) -> Iterator[str]:
    """Sentences on a sample that is too small, and on references that were left out.

    Parameters
    ----------
    side : (n,) int
        Stratum of each scenario.
    inference : Inference
        What was made of them.
    """
    sides, counts = np.unique(side, return_counts=True)
    numbers = " and ".join(
        f"{count} {'left' if which == LEFT else 'right'}"
        for which, count in zip(sides[::-1], counts[::-1], strict=True)
    )
    if not spread_is_known(side):
        yield (
            f"There is no interval and nothing is told apart: a side has one scenario only ({numbers}), which shows no "
            "spread."
        )
    elif side.size < FEW or counts.min() < FEW_OF_A_SIDE:
        yield (
            f"Intervals are too short with so few scenarios ({numbers}): below {FEW}, or {FEW_OF_A_SIDE} of a side, "
            "they hold less often than they say. None of them counts the sampling error of the scenario model itself."
        )
    if inference.references < inference.may_be_best:
        yield (
            f"Critical values of the comparisons with the best come from {inference.references} of "
            f"{inference.may_be_best} designs that may be the best: intervals of the differences to the best may be "
            "too short."
        )
