"""Checks that frozen option values share."""

from __future__ import annotations

import math

from ldctoolkit.errors import InputError, plain


def is_number(value: object) -> bool:
    """Whether a value is a finite number, and no truth value."""
    return not isinstance(value, bool) and isinstance(value, int | float) and math.isfinite(value)


def number(
    owner: object,
    table: str,
    name: str,
    *,
    above: float | None = None,
    least: float | None = None,
    most: float | None = None,
) -> None:
    """Check a number of a frozen value and make it a float."""
    value = plain(getattr(owner, name))
    bounds = [f"{sign} {bound:g}" for sign, bound in ((">", above), (">=", least), ("<=", most)) if bound is not None]
    allowed = " ".join(["a finite number", *([" and ".join(bounds)] if bounds else [])])
    inside = is_number(value)
    inside = inside and (above is None or value > above)
    inside = inside and (least is None or value >= least)
    inside = inside and (most is None or value <= most)
    if not inside:
        raise InputError(f"{table}.{name}: {value!r}; allowed: {allowed}")
    object.__setattr__(owner, name, float(value))
