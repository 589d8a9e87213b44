"""One sentence for the answer: what the worst single option of other plants does to the winner."""

from __future__ import annotations

from typing import Final

import numpy as np
from markupsafe import Markup

from studies.report.context import Context
from studies.report.words.text import difference_text, percent, plural
from studies.robustness.robustness import Robustness

_STUDY, _TOGETHER, _IDEAL = "study", "together", "ideal"
_SEVERAL: Final = (_STUDY, _TOGETHER, _IDEAL)
"""Plants that are not one option away from the study's own."""


def on_other_plants(context: Context) -> Markup:
    """Worst single option for the winner: its change and rank there, and whether it fails; empty where none was driven.

    Parameters
    ----------
    context : Context
    """
    found = context.report.robustness
    if found is None or not found.n or found.designs[:1] != (context.primary.best.design.id,):
        return Markup("")
    single = [k for k, name in enumerate(found.plants) if name not in _SEVERAL and np.isfinite(found.change[k, 0])]
    if not single:
        return Markup("")
    worst = max(single, key=lambda k: float(found.change[k, 0]))
    change, own = float(found.change[worst, 0]), float(found.S[0, 0])
    if change <= 0.0:
        hurts = f"On other plants, one option at a time, none of {len(single)} makes its mean S worse"
    else:
        share = f" ({percent(change / own)} of its S)" if own > 0.0 else ""
        interval = _interval(found, worst)
        rank, among = int(found.rank[worst, 0]), int(np.count_nonzero(found.rank[worst]))
        place = f"; it has rank {rank} of {among} there" if rank and among > 1 else ""
        hurts = (
            f"On other plants, one option at a time, \u201c{found.titles[worst]}\u201d hurts it most: "
            f"{difference_text(change, 3)} m\u00b7s{share}{interval}{place}"
        )
    said = Markup("{}. Of {} it fails {} (<a href='#robustness'>robustness</a>).")
    return said.format(hurts, plural(found.n, "departure"), _failures(found, worst))


def _interval(found: Robustness, k: int) -> str:
    low, high = float(found.low[k, 0]), float(found.high[k, 0])
    known = np.isfinite(low) and np.isfinite(high)
    return f", interval {difference_text(low, 3)} to {difference_text(high, 3)}" if known else ", interval not known"


def _failures(found: Robustness, worst: int) -> str:
    """Whether it fails there, and with many options at once."""
    there = int(found.failures[worst, 0])
    words = f"in {there:,} there" if there else "in none there"
    if _TOGETHER not in found.plants:
        return words
    k = found.plants.index(_TOGETHER)
    if not np.isfinite(found.S[k, 0]):
        return f"{words}, and its law does not run on \u201c{found.titles[k]}\u201d"
    many = int(found.failures[k, 0])
    return f"{words}, and in {f'{many:,}' if many else 'none'} on \u201c{found.titles[k]}\u201d"
