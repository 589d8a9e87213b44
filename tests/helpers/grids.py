"""Grids of parameters, of which the default tier tries some pairs."""

import itertools
from collections.abc import Iterable
from typing import Any

import pytest


def grid(first: Iterable[Any], second: Iterable[Any], *default: tuple[Any, Any]) -> list[Any]:
    """Every pair; those that are not named are for the longer tier."""
    pairs = list(itertools.product(first, second))
    assert set(default) <= set(pairs)
    return [pair if pair in default else pytest.param(*pair, marks=pytest.mark.slow) for pair in pairs]


def some(cases: Iterable[Any], *default: Any) -> list[Any]:
    """Every case; those that are not named are for the longer tier."""
    listed = list(cases)
    assert set(default) <= set(listed)
    return [case if case in default else pytest.param(case, marks=pytest.mark.slow) for case in listed]
