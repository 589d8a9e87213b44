"""Arguments of the form NAME=VALUE, NAME=LOW:HIGH or NAME=WORD, where NAME is a parameter of a departure."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence

Interval = tuple[float | None, float | None]
"""Lower and upper end; None is open."""


def named(text: str) -> tuple[str, str]:
    """``NAME=REST``."""
    name, equals, rest = text.partition("=")
    if not equals or not name or not rest:
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: NAME=...")
    return name.strip(), rest.strip()


def _number(text: str, whole: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if math.isnan(value):
        raise argparse.ArgumentTypeError(f"{whole!r}: {text!r} is not a number")
    return value


def interval(text: str, whole: str) -> Interval:
    """``LOW:HIGH``, an empty end is open."""
    low, colon, high = text.partition(":")
    if not colon:
        raise argparse.ArgumentTypeError(f"{whole!r}; allowed: NAME=LOW:HIGH, an empty end is open")
    return tuple(_number(end, whole) if end.strip() else None for end in (low, high))  # type: ignore[return-value]


def condition(text: str) -> tuple[str, float | Interval]:
    """``NAME=VALUE`` or ``NAME=LOW:HIGH``."""
    name, rest = named(text)
    return name, interval(rest, text) if ":" in rest else _number(rest, text)


def bound(text: str) -> tuple[str, str | tuple[float | str | None, float | str | None]]:
    """``NAME=LOW:HIGH``, where either end may be ``auto``, or ``NAME=auto`` or ``NAME=physical``."""
    name, rest = named(text)
    if ":" not in rest:
        if rest not in ("auto", "physical"):
            raise argparse.ArgumentTypeError(
                f"{text!r}; allowed: NAME=LOW:HIGH (an empty end is open), NAME=auto or NAME=physical"
            )
        return name, rest
    low, _, high = rest.partition(":")
    ends = tuple(
        "auto" if end.strip() == "auto" else _number(end, text) if end.strip() else None for end in (low, high)
    )
    return name, (ends[0], ends[1])


def each_once(option: str, pairs: Sequence[tuple[str, object]] | None) -> None:
    """Refuse a name that is given twice.

    Raises
    ------
    InputError
        Naming the option and the name.
    """
    from ldctoolkit.errors import InputError

    names = [name for name, _ in pairs or ()]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{option} {name}: given {names.count(name)} times; allowed: once a name")
