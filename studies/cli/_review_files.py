"""Reviews for machines."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from ldctoolkit.review import Review

UNITS: Final = {
    "v": "m_s",
    "bend": "rad_s",
    "slowest": "s",
    "gain_margin": "dB",
    "gain_reduction_margin": "dB",
    "phase_margin": "rad",
    "delay_margin": "s",
    "crossover": "rad_s",
    "bandwidth": "rad_s",
    "e_y_bend": "m",
    "e_y_bend_mismatched": "m",
}
"""Number of a loop -> unit at the end of its column; one that is not here is a pure number."""


def columns(review: Review) -> dict[str, list[Any]]:
    """Numbers of a loop by column, units in the names; empty without a loop."""
    if review.loop is None:
        return {}
    return {
        f"{field.name}_{UNITS[field.name]}" if field.name in UNITS else field.name: getattr(
            review.loop, field.name
        ).tolist()
        for field in dataclasses.fields(review.loop)
    }


def to_json(reviews: Sequence[tuple[str, tuple[str, ...], Review]]) -> str:
    """Reviews as JSON; NaN is null, an infinite number "inf" or "-inf"."""
    content = [
        {
            "design": label,
            "ids": list(ids),
            "law": review.law,
            "gains": dict(review.gains),
            "dt_s": review.dt,
            "findings": [dataclasses.asdict(finding) for finding in review.findings],
            "loop": columns(review),
        }
        for label, ids, review in reviews
    ]
    return json.dumps(_plain(content), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    return value
