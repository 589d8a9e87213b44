"""``sensitivity.csv``: one row an index, and one row a value of a profile; units in the names of the columns."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from studies.sensitivity.sensitivity import BlockSensitivity
from studies.sensitivity.winner_profile import Profile
from studies.storage.files import write_text

COLUMNS: Final = (
    *("kind", "block", "law", "dimension", "unit", "method", "designs", "index", "index_low", "index_high"),
    *("interval_over", "value", "design", "S_m_s", "difference_m_s", "difference_low_m_s", "difference_high_m_s"),
    *("stored", "note"),
)
"""``kind`` is ``first``, ``total``, ``none`` (``note`` says why) or ``profile``; what a kind does not have is empty."""


def write_sensitivity(blocks: Sequence[BlockSensitivity], profiles: Sequence[Profile], path: str | Path) -> None:
    """Write indices and profiles as one CSV file, whole or not at all.

    Parameters
    ----------
    blocks : sequence of BlockSensitivity
    profiles : sequence of Profile
    path : path

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=COLUMNS, restval="", lineterminator="\n")
    writer.writeheader()
    for block in blocks:
        writer.writerows(_index_rows(block))
    for profile in profiles:
        writer.writerows(_profile_rows(profile))
    write_text(Path(path), text.getvalue())


def _index_rows(block: BlockSensitivity) -> Iterator[dict[str, Any]]:
    shared = {"block": block.block, "law": block.law}
    found = block.indices
    if found is None:
        yield {"kind": "none", **shared, "note": block.reason}
        return
    kinds = {
        "first": (found.first, found.first_low, found.first_high),
        "total": (found.total, found.total_low, found.total_high),
    }
    for i, name in enumerate(block.names):
        for kind, numbers in kinds.items():
            if np.isnan(numbers[0][i]):
                continue
            index, low, high = (_field(values[i]) for values in numbers)
            yield {
                "kind": kind,
                **shared,
                "dimension": name,
                "method": block.method,
                "designs": block.designs,
                "index": index,
                "index_low": low,
                "index_high": high,
                "interval_over": block.interval_over,
                "note": block.note,
            }


def _profile_rows(profile: Profile) -> Iterator[dict[str, Any]]:
    for i, (design, value) in enumerate(zip(profile.designs, profile.values, strict=True)):
        yield {
            "kind": "profile",
            "law": design.law,
            "dimension": profile.name,
            "unit": profile.unit,
            "value": _field(value),
            "design": design.id,
            "S_m_s": _field(profile.S[i].item()),
            "difference_m_s": _field(profile.difference[i].item()),
            "difference_low_m_s": _field(profile.low[i].item()),
            "difference_high_m_s": _field(profile.high[i].item()),
            "stored": _field(bool(profile.stored[i])),
            "note": profile.failures[i],
        }


def _field(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return "" if value != value else str(value)
