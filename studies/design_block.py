"""The tables ``[[design]]`` of a study file: a law and a space of its trigger threshold and gains."""

from __future__ import annotations

import itertools
import math
from typing import Any

from pydantic import Field, model_validator

from ldctoolkit import LdcError, controller_class
from ldctoolkit.gains import Gain, find_gain
from studies._part import Part, fail
from studies.design import Design
from studies.grid import EntryError, expand


class DesignBlock(Part):
    """``[[design]]``: a law and a grid over its trigger threshold and gains.

    Attributes
    ----------
    law : str
        Registry name.
    y_s : tuple of float [m]
        Trigger thresholds.
    gains : dict of str to tuple
        Values of every gain that is set; the others keep their defaults.
    """

    law: str
    y_s: tuple[float, ...] = (0.2,)
    gains: dict[str, tuple[Any, ...]] = Field(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _check(cls, block: Any) -> Any:
        if not isinstance(block, dict) or not isinstance(block.get("law"), str):
            return block  # the field's own message says what is missing
        checked = dict(block)
        try:
            kind = controller_class(block["law"])
        except LdcError as error:
            raise fail("law", str(error).removeprefix("law ")) from None
        if "y_s" in block:
            checked["y_s"] = tuple(_threshold(value) for value in _expand("y_s", block["y_s"]))
        gains = block.get("gains", {})
        if isinstance(gains, dict):
            checked["gains"] = {name: _gain_values(kind, name, entry) for name, entry in gains.items()}
        return checked

    def designs(self) -> list[Design]:
        """The full grid, thresholds slowest, in the order written."""
        names = list(self.gains)
        return [
            Design.from_gains(self.law, y_s, dict(zip(names, values, strict=True)))
            for y_s in self.y_s
            for values in itertools.product(*(self.gains[name] for name in names))
        ]


def _expand(path: str, entry: Any, declared: Gain | None = None) -> tuple[Any, ...]:
    try:
        if declared is None:
            return expand(entry)
        whole = isinstance(declared.default, int) and not isinstance(declared.default, bool)
        return expand(entry, declared.scale, whole=whole)
    except EntryError as error:
        raise fail(path + error.path, str(error)) from None


def _threshold(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not (math.isfinite(value) and value >= 0):
        raise fail("y_s", f"{value!r}; allowed: a finite number >= 0 [m]")
    return float(value) + 0.0


def _gain_values(kind: Any, name: str, entry: Any) -> tuple[Any, ...]:
    path = f"gains.{name}"
    try:
        declared = find_gain(kind, name, kind.name)
        return tuple(declared.check(value, kind.name) for value in _expand(path, entry, declared))
    except LdcError as error:
        # the path in the study file says more than the law's own prefix
        raise fail(path, str(error).removeprefix(f"{kind.name}.{name}: ")) from None
