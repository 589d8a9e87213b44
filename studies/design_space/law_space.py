"""The space of one law's designs: what each entry of a study file stands for, and which gains count when."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from ldctoolkit.errors import InputError, nearest
from ldctoolkit.gains import GainValue
from studies.design import Design

if TYPE_CHECKING:
    import numpy.typing as npt

THRESHOLD: Final = "y_s"
"""Name of the trigger threshold among the dimensions."""

RANGE_KEYS: Final = ("count", "from", "scale", "to")
MOST_VALUES: Final = 10_000
"""Largest number of values of one entry; more is a slip of the pen."""


@dataclasses.dataclass(frozen=True)
class Choices:
    """A list of values, one or more."""

    values: tuple[GainValue, ...]  # Different values, in the order written

    @property
    def size(self) -> int:
        """Number of different values."""
        return len(self.values)

    def at(self, share: float) -> GainValue:
        """The value at a share of the list, every value over an equal part."""
        return self.values[min(int(share * len(self.values)), len(self.values) - 1)]


@dataclasses.dataclass(frozen=True)
class Span:
    """Every number between two ends, or every whole one; both ends belong to it."""

    # The ends as written, in either order, different
    first: float
    last: float
    # What is even: the numbers, or their logarithms (then both ends have one sign)
    scale: Literal["linear", "log"] = "linear"
    whole: bool = False  # Whole numbers only; the ends are whole

    @property
    def low(self) -> float:
        """The smaller end."""
        return min(self.first, self.last)

    @property
    def high(self) -> float:
        """The larger end."""
        return max(self.first, self.last)

    @property
    def size(self) -> int | None:
        """Number of different values; None where there is no end to them."""
        return int(self.high - self.low) + 1 if self.whole else None

    def at(self, share: float) -> GainValue:
        """The value at a share of the way from the first end to the last."""
        a, b = float(self.first), float(self.last)
        if self.whole:
            # half a number beyond each end: the ends get as much room as the others
            low, high = (a - 0.5, b + 0.5) if a < b else (a + 0.5, b - 0.5)
            return int(min(max(round(_between(low, high, share, self.scale)), self.low), self.high))
        return min(max(rounded(_between(a, b, share, self.scale)), self.low), self.high)


Dimension = Choices | Span


def rounded(value: float) -> float:
    """A number with twelve significant digits: 0.3 and not 0.30000000000000004 in names and identities."""
    return float(f"{value:.12g}") + 0.0


def _between(a: float, b: float, share: float, scale: Literal["linear", "log"]) -> float:
    if scale == "linear":
        return a * (1 - share) + b * share
    logarithm = math.log(abs(a)) * (1 - share) + math.log(abs(b)) * share
    return math.copysign(math.exp(logarithm), a)


class EntryError(InputError):
    """An entry of a study file is wrong; `path` says where inside the entry."""

    def __init__(self, path: str, message: str) -> None:
        super().__init__(message)
        self.path = path


def read_entry(entry: Any, scale: Literal["linear", "log"] = "linear", *, whole: bool = False) -> Dimension:
    """The dimension of a design space that one entry stands for."""
    if not isinstance(entry, dict) or "count" in entry:
        return Choices(expand(entry, scale, whole=whole))
    first, last, spacing = _ends(entry, scale)
    if first == last:
        raise EntryError("", f"from and to are both {first!r}; allowed: two different numbers")
    return Span(first, last, spacing, whole)


def expand(entry: Any, scale: Literal["linear", "log"] = "linear", *, whole: bool = False) -> tuple[Any, ...]:
    """The values of one entry, in the order written, each once."""
    if isinstance(entry, dict):
        values = _range(entry, scale, whole)
    elif isinstance(entry, list | tuple):
        if not entry:
            raise EntryError("", "an empty list; allowed: one value or more")
        if len(entry) > MOST_VALUES:
            raise EntryError("", f"{len(entry)} values; allowed: at most {MOST_VALUES}")
        values = list(entry)
    else:
        values = [entry]
    seen: list[Any] = []
    for value in values:
        # True == 1 in Python, not in a study file
        if not any(value == other and type(value) is type(other) for other in seen):
            seen.append(value)
    return tuple(seen)


def _range(entry: dict[str, Any], scale: Literal["linear", "log"], whole: bool) -> list[Any]:
    first, last, scale = _ends(entry, scale)
    if "count" not in entry:
        raise EntryError(".count", "missing; a range is written {from = ..., to = ..., count = ...}")
    count = entry["count"]
    if isinstance(count, bool) or not isinstance(count, int) or not 2 <= count <= MOST_VALUES:
        raise EntryError(".count", f"{count!r}; allowed: a whole number from 2 to {MOST_VALUES}")
    points = np.geomspace(first, last, count) if scale == "log" else np.linspace(first, last, count)
    values = [rounded(value) for value in points.tolist()]
    values[0], values[-1] = float(first), float(last)  # the ends stay as written
    return [round(value) for value in values] if whole else values


def _ends(entry: dict[str, Any], scale: Literal["linear", "log"]) -> tuple[float, float, Literal["linear", "log"]]:
    """Ends and spacing of a table."""
    for key in entry:
        if key not in RANGE_KEYS:
            raise EntryError(f".{key}", f"no such key; {nearest(key, RANGE_KEYS)}")
    for key in ("from", "to"):
        if key not in entry:
            raise EntryError(f".{key}", "missing; a range is written {from = ..., to = ..., count = ...}")
        value = entry[key]
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise EntryError(f".{key}", f"{value!r}; allowed: a finite number")
    first, last = entry["from"], entry["to"]
    one_sign = (first > 0) == (last > 0) and first != 0 and last != 0
    chosen = entry.get("scale", scale if one_sign else "linear")
    if chosen not in ("linear", "log"):
        raise EntryError(".scale", f"{chosen!r}; {nearest(str(chosen), ('linear', 'log'))}")
    if chosen == "log" and not one_sign:
        raise EntryError(".scale", f"'log' from {first!r} to {last!r}; allowed: both ends of one sign, neither zero")
    return first, last, "log" if chosen == "log" else "linear"


@dataclasses.dataclass(frozen=True)
class Condition:
    """A gain that varies only while another has one of some values; otherwise it keeps its default."""

    gain: str  # The gain that varies
    on: str  # The other gain, which has no condition of its own
    values: tuple[GainValue, ...]  # Values of the other one


@dataclasses.dataclass(frozen=True)
class LawSpace:
    """What a ``[[design]]`` table says about one law."""

    law: str  # Registry name
    y_s: Dimension  # Trigger thresholds
    # The gains that are set, in the order written; the others keep their defaults
    gains: tuple[tuple[str, Dimension], ...] = ()
    conditions: tuple[Condition, ...] = ()

    @property
    def dimensions(self) -> tuple[tuple[str, Dimension], ...]:
        """Threshold and gains, the threshold first."""
        return ((THRESHOLD, self.y_s), *self.gains)

    @property
    def varying(self) -> tuple[str, ...]:
        """Names of the dimensions with more than one value."""
        return tuple(name for name, dimension in self.dimensions if dimension.size != 1)

    @property
    def size(self) -> int | None:
        """Number of designs, conditions not counted; None where there is no end to them."""
        sizes = [dimension.size for _, dimension in self.dimensions]
        return None if None in sizes else math.prod(size for size in sizes if size is not None)

    def grid(self) -> Iterator[Design]:
        """Every design once, the threshold slowest, in the order written."""
        names, lists = [], []
        for name, dimension in self.dimensions:
            if not isinstance(dimension, Choices):
                raise InputError(f"{name}: a range without a count makes no grid")
            names.append(name)
            lists.append(dimension.values)
        every = (self.active(dict(zip(names, values, strict=True))) for values in itertools.product(*lists))
        if not self.conditions:  # then all differ
            return map(self._design, every)
        return map(self._design, {tuple(values.items()): values for values in every}.values())

    def at(self, shares: npt.NDArray[np.float64]) -> tuple[Design, ...]:
        """The designs at points of the unit cube; two points may be one design."""
        varying = self.varying
        fixed = {name: dimension.at(0.0) for name, dimension in self.dimensions}
        dimensions = [dimension for name, dimension in self.dimensions if name in varying]
        rows = (zip(varying, dimensions, row, strict=True) for row in shares.tolist())
        return tuple(self.design(fixed | {name: dim.at(share) for name, dim, share in row}) for row in rows)

    def design(self, values: Mapping[str, GainValue]) -> Design:
        """The design of one value for each dimension."""
        single = {name: dimension.at(0.0) for name, dimension in self.dimensions if name not in self.varying}
        return self._design(self.active(single | dict(values)))

    def holds(self, gain: str, values: Mapping[str, GainValue]) -> bool:
        """Whether the conditions on a gain hold, given the values of the gains that they ask for."""
        return all(c.on in values and values[c.on] in c.values for c in self.conditions if c.gain == gain)

    def active(self, values: Mapping[str, GainValue]) -> dict[str, GainValue]:
        """The values without those of gains whose condition does not hold."""
        return {name: value for name, value in values.items() if self.holds(name, values)}

    def _design(self, values: Mapping[str, GainValue]) -> Design:
        gains = {name: value for name, value in values.items() if name != THRESHOLD}
        return Design.from_gains(self.law, float(values[THRESHOLD]), gains)
