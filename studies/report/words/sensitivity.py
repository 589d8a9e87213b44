"""What Sobol indices say, in sentences."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from markupsafe import Markup

from ldctoolkit import controller_class
from studies.report.words.text import number, symbols
from studies.sensitivity.sensitivity import BlockSensitivity


def law_of(block: BlockSensitivity, blocks: tuple[BlockSensitivity, ...]) -> str:
    """Name of the law; with the number of its table where it has several."""
    title = controller_class(block.law).title
    several = sum(one.law == block.law for one in blocks) > 1
    return f"{title}, table {block.block + 1}" if several else title


def by_weight(block: BlockSensitivity) -> npt.NDArray[np.int64]:
    """Positions of the quantities, what matters most first: by the total index, without one by the first-order one."""
    if block.indices is None:
        return np.arange(0)
    return np.argsort(-weights(block), kind="stable")


def weights(block: BlockSensitivity) -> npt.NDArray[np.float64]:
    """How much each quantity matters: its total index, or the first-order one where there is none; NaN counts as 0."""
    if block.indices is None:
        return np.zeros(len(block.names))
    total = block.indices.total
    return np.nan_to_num(np.where(np.isnan(total), block.indices.first, total))


def sensitivity_sentence(block: BlockSensitivity, title: str) -> Markup:
    """Which gain matters most, and how sure that is; or why nothing can be said."""
    found = block.indices
    if found is None:
        return symbols(f"{title}: no indices: {block.reason}.")
    order = by_weight(block)
    first = int(order[0])
    total = not math.isnan(found.total[first])
    index, low, high = (
        (found.total, found.total_low, found.total_high) if total else (found.first, found.first_low, found.first_high)
    )
    interval = f"interval {number(float(low[first]), 2)} to {number(float(high[first]), 2)}"
    kind = "total" if total else "first-order"
    said = f"{title}: {block.names[first]} matters most ({kind} index {number(float(index[first]), 2)}, {interval})"
    if len(order) == 1:
        return symbols(f"{said}; nothing else varies.")
    second = int(order[1])
    apart = bool(low[first] > high[second])
    said += f", {'then' if apart else 'not clearly before'} {block.names[second]} ({number(float(index[second]), 2)})"
    if total and found.total[first] - found.first[first] > 0.1:
        said += (
            f"; what {block.names[first]} does depends on other gains (alone {number(float(found.first[first]), 2)})"
        )
    least = [block.names[i] for i in order[2:] if index[i] < 0.02 and high[i] < 0.05]
    if least:
        said += f"; {', '.join(least)} hardly matter{'s' if len(least) == 1 else ''}"
    return symbols(f"{said}.")
