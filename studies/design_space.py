"""Design spaces: the tables ``[[design]]`` of a study file, and what each of their entries stands for."""

import dataclasses
import itertools
import math
from collections.abc import Hashable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal, Self

import numpy as np
from pydantic import Field, InstanceOf, PrivateAttr, ValidationInfo, model_serializer, model_validator

from ldctoolkit.arrays import FloatArray
from ldctoolkit.code_content import content_of, from_file
from ldctoolkit.control import Controller
from ldctoolkit.declared import (
    Gain,
    GainValue,
    Scale,
    checked_choice,
    checked_number,
    checked_whole,
    declared_gains,
    find_gain,
)
from ldctoolkit.errors import InputError, LdcError
from ldctoolkit.registry import code_of, controller_class, controller_names, laws_inside, register
from ldctoolkit.validation import Part

from .design import CONVENTION_GAIN, Design

THRESHOLD: Final = "y_s"  # name of the trigger threshold among the dimensions
Y_S: Final = Gain(name=THRESHOLD, unit="m", default=0.2, lower=-10.0)

RANGE_KEYS: Final = ("count", "from", "scale", "to")
_WRITTEN: Final = "a range is written {from = ..., to = ..., count = ...}"
MOST_VALUES: Final = 10_000  # largest number of values of one entry; more is a slip of the pen


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
    scale: Scale = "linear"
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
            return int(min(max(round(_interpolated(low, high, share, self.scale)), self.low), self.high))
        return min(max(rounded(_interpolated(a, b, share, self.scale)), self.low), self.high)

    def share(self, value: float) -> float:
        """Share of the way from the first end to the last at which a value lies; the inverse of `at`."""
        if self.scale == "log":
            return float(np.log(value / self.first) / np.log(self.last / self.first))
        return (value - self.first) / (self.last - self.first)


Dimension = Choices | Span


def rounded(value: float) -> float:
    """A number with twelve significant digits: 0.3 and not 0.30000000000000004 in names and identities."""
    return float(f"{value:.12g}") + 0.0


def next_value(values: Sequence[float], gain: Gain, *, upper: bool) -> GainValue | None:
    """The value beyond an end of a list of two numbers or more; None where the gain's declaration allows none.

    The list's own ratio or difference goes on, where one of them is constant, else the last step at that end, in the
    gain's scale. A gain keeps its sign, and the last step before a limit ends at it.
    """
    ordered = sorted(values, reverse=not upper)
    before, last = ordered[-2:]
    signed = ordered[0] * ordered[-1] > 0
    spacings = np.diff(ordered), np.diff(np.log(np.abs(ordered))) if signed else np.arange(2.0)
    even, geometric = (
        len(ordered) > 2 and np.allclose(spacing, spacing[0], rtol=1e-3, atol=0.0) for spacing in spacings
    )
    value = last + (last - before)
    if signed and (geometric or (gain.scale == "log" and not even) or (gain.name != THRESHOLD and value * last <= 0)):
        value = last * (last / before)
    value = min(max(rounded(value), gain.lower), gain.upper)
    value = round(value) if gain.whole else value
    return None if value == last else value


def _interpolated(a: float, b: float, share: float, scale: Scale) -> float:
    """The point at a share of the way from a to b, on a linear or logarithmic scale."""
    if scale == "linear":
        return a * (1 - share) + b * share
    logarithm = math.log(abs(a)) * (1 - share) + math.log(abs(b)) * share
    return math.copysign(math.exp(logarithm), a)


def read_entry(entry: Any, scale: Scale = "linear", *, whole: bool = False) -> Dimension:
    """The dimension of a design space that one entry stands for."""
    if not isinstance(entry, dict) or "count" in entry:
        return Choices(expand(entry, scale, whole=whole))
    first, last, spacing = _ends(entry, scale)
    if first == last:
        raise InputError("", "is given as from and as to", value=first, allowed="two different numbers")
    return Span(first, last, spacing, whole)


def expand(entry: Any, scale: Scale = "linear", *, whole: bool = False) -> tuple[Any, ...]:
    """The values of one entry, in the order written, each once."""
    values = entry if isinstance(entry, list | tuple) else [entry]
    if isinstance(entry, dict):
        first, last, spacing = _ends(entry, scale)
        if "count" not in entry:
            raise InputError("count", "missing", hint=_WRITTEN)
        count = checked_whole("count", entry["count"], lower=2, upper=MOST_VALUES)
        points = np.geomspace(first, last, count) if spacing == "log" else np.linspace(first, last, count)
        values = [float(first), *map(rounded, points[1:-1].tolist()), float(last)]  # the ends stay as written
        values = [round(value) for value in values] if whole else values
    if not 1 <= len(values) <= MOST_VALUES:
        raise InputError("", f"{len(values)} values", allowed=f"1 to {MOST_VALUES}")
    # True == 1 in Python, not in a study file; what cannot be a key is no value of a gain either
    first_of: dict[Any, Any] = {}
    for value in values:
        first_of.setdefault((type(value), value if isinstance(value, Hashable) else repr(value)), value)
    return tuple(first_of.values())


def _ends(entry: dict[str, Any], scale: Scale) -> tuple[float, float, Scale]:
    """Ends and spacing of a range."""
    for key in entry:
        if key not in RANGE_KEYS:
            raise InputError(key, "no such key", allowed=RANGE_KEYS)
    for key in ("from", "to"):
        if key not in entry:
            raise InputError(key, "missing", hint=_WRITTEN)
        checked_number(key, entry[key])
    first, last = entry["from"], entry["to"]
    one_sign = (first > 0) == (last > 0) and first != 0 and last != 0
    spacing = checked_choice("scale", entry.get("scale", scale if one_sign else "linear"), ("linear", "log"))
    if spacing == "log" and not one_sign:
        allowed = "both ends of one sign, neither zero"
        raise InputError("scale", f"from {first!r} to {last!r}", value="log", allowed=allowed)
    return first, last, "log" if spacing == "log" else "linear"


@dataclasses.dataclass(frozen=True)
class Condition:
    """A gain that varies only while another has one of some values; otherwise it keeps its default."""

    gain: str  # The gain that varies
    on: str  # The other gain, which has no condition of its own
    values: tuple[GainValue, ...]  # Values of the other one


@dataclasses.dataclass(frozen=True)
class LawSpace:
    """What a ``[[design]]`` table says about one law."""

    kind: type[Controller]
    y_s: Dimension  # Trigger thresholds
    # The gains that are set, in the order written; the others keep their defaults
    gains: tuple[tuple[str, Dimension], ...] = ()
    conditions: tuple[Condition, ...] = ()
    _codes: dict[Any, str] = dataclasses.field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def law(self) -> str:
        """Registry name."""
        return self.kind.name

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
        for name, dimension in self.dimensions:
            if isinstance(dimension, Span):
                raise InputError(name, "a range without a count makes no grid")
        names = [name for name, _ in self.dimensions]
        lists = [dimension.values for _, dimension in self.dimensions if isinstance(dimension, Choices)]
        every = (self.active(dict(zip(names, values, strict=True))) for values in itertools.product(*lists))
        return map(self._design, {tuple(values.items()): values for values in every}.values())

    def at(self, shares: FloatArray) -> tuple[Design, ...]:
        """The designs at points of the unit cube; two points may be one design."""
        varying = [(name, dimension) for name, dimension in self.dimensions if dimension.size != 1]
        rows = (zip(varying, row, strict=True) for row in shares.tolist())
        return tuple(self.design({name: dimension.at(share) for (name, dimension), share in row}) for row in rows)

    def design(self, values: Mapping[str, GainValue]) -> Design:
        """The design of one value for each dimension."""
        single = {name: dimension.at(0.0) for name, dimension in self.dimensions if name not in self.varying}
        return self._design(self.active(single | dict(values)))

    def holds(self, gain: str, values: Mapping[str, GainValue]) -> bool:
        """Whether the conditions on a gain hold, given the values of the gains that they require."""
        return all(c.on in values and values[c.on] in c.values for c in self.conditions if c.gain == gain)

    def active(self, values: Mapping[str, GainValue]) -> dict[str, GainValue]:
        """The values without those of gains whose condition does not hold."""
        return {name: value for name, value in values.items() if self.holds(name, values)}

    def _design(self, values: Mapping[str, GainValue]) -> Design:
        gains = {name: value for name, value in values.items() if name != THRESHOLD}
        inside = tuple(gains.get(name) for name in self.kind.law_options)
        if inside not in self._codes:
            self._codes[inside] = code_of(self.kind, gains)
        controller, follows = self.kind(**gains), CONVENTION_GAIN not in gains
        return Design.of(controller, float(values[THRESHOLD]), follow_study=follows, code=self._codes[inside])


class SampleSettings(Part):
    """``[design.sample]``: how many points of the space are taken, and how they are spread."""

    # Latin hypercube: every dimension is cut into `count` equal parts and each part is met once. Sobol: the first
    # points of a scrambled Sobol sequence, best as a power of two. Saltelli: what Sobol indices are computed from
    method: Literal["latin_hypercube", "sobol", "saltelli"]
    # Points for each law; with ``"saltelli"`` the number N of base points, a power of two, which make N (d + 2) designs
    # in d dimensions
    count: int = Field(ge=1, le=100_000)
    seed: int = Field(default=0, ge=0, lt=2**63)  # Of the sample; nothing else decides the points

    @model_validator(mode="after")
    def _balanced(self) -> Self:
        if self.method == "saltelli" and self.count & (self.count - 1):
            below = 1 << (self.count.bit_length() - 1)
            allowed = f"a power of two, e.g. {below} or {2 * below}"
            raise InputError("count", "with method 'saltelli'", value=self.count, allowed=allowed)
        return self

    def points(self, dimensions: int) -> int:
        """Number of points in so many dimensions; one in a space without any."""
        if not dimensions:
            return 1
        return self.count * (dimensions + 2) if self.method == "saltelli" else self.count


def unit_points(sample: SampleSettings, dimensions: int) -> FloatArray:
    """The points of a sample in the unit cube."""
    if not dimensions:
        return np.zeros((1, 0))
    if sample.method == "saltelli":
        try:
            from SALib.sample import sobol
        except ImportError:
            problem, hint = "needs SALib, which is not installed", 'pip install "ldctoolkit[sensitivity]"'
            raise InputError("design.sample.method", problem, value="saltelli", hint=hint) from None
        names, bounds = [str(i) for i in range(dimensions)], [[0.0, 1.0]] * dimensions
        cube = {"num_vars": dimensions, "names": names, "bounds": bounds}
        points = sobol.sample(cube, sample.count, calc_second_order=False, seed=sample.seed)
        return np.asarray(points, dtype=np.float64)
    from scipy.stats import qmc

    rng = np.random.default_rng(sample.seed)
    if sample.method == "latin_hypercube":
        points = qmc.LatinHypercube(dimensions, rng=rng).random(sample.count)
    else:
        # drawn as a power of two and cut: the same points, and SciPy has nothing to warn of
        points = qmc.Sobol(dimensions, rng=rng).random_base2((sample.count - 1).bit_length())[: sample.count]
    return np.asarray(points, dtype=np.float64)


Kinds = Sequence[type[Controller]]


@dataclasses.dataclass(frozen=True)
class LawSample:
    """What ``[design.sample]`` makes of one law."""

    shares: FloatArray  # (m, d) Points of the unit cube, a column for each dimension that varies
    designs: tuple[Design, ...]  # The design of each row; rows may share one


class DesignBlock(Part):
    """``[[design]]``: one law or several, and a space of their trigger threshold and gains."""

    law: str | tuple[str, ...]  # Registry names. A gain goes to the laws that declare it
    # Trigger thresholds; a range without a count holds all between its ends
    y_s: tuple[float, ...] | InstanceOf[Span] = (0.2,)
    # Values of every gain that is set; the others keep their defaults
    gains: dict[str, tuple[Any, ...] | InstanceOf[Span]] = Field(default_factory=dict)
    # Conditions: gain -> other gain of the same law -> its values for which the first one varies
    when: dict[str, dict[str, tuple[Any, ...]]] = Field(default_factory=dict)
    sample: SampleSettings | None = None  # Take points of the space instead of the full grid
    files: dict[str, str] = Field(default_factory=dict)  # Where laws of files are found, by their names

    _kinds: tuple[type[Controller], ...] = PrivateAttr()

    def model_post_init(self, context: Any) -> None:
        """Keep the classes that the names stand for now."""
        self._kinds = _read_laws(self.law, context)[1]

    @model_validator(mode="before")
    @classmethod
    def _check(cls, block: Any, info: ValidationInfo) -> Any:
        if not isinstance(block, dict):
            return block
        if "law" not in block:  # the field's own message says so, or that the key is another
            return {key: block[key] for key in block.keys() - {"y_s", "gains", "when"}}
        checked = dict(block)
        names, kinds = _read_laws(block["law"], info.context)
        checked["law"] = names[0] if len(names) == 1 else names
        if "y_s" in block:
            checked["y_s"] = _read_thresholds(block["y_s"])
        gains = block.get("gains", {})
        if isinstance(gains, dict):
            checked["gains"] = {name: _read_gain(kinds, name, entry) for name, entry in gains.items()}
            when = block.get("when", {})
            if isinstance(when, dict):
                checked["when"] = _read_conditions(kinds, when, checked["gains"])
        return checked

    @model_serializer
    def _content(self) -> dict[str, Any]:
        gains = {name: _written(entry) for name, entry in self.gains.items()}
        content = {"law": self.law, "y_s": _written(self.y_s), "gains": gains}
        # a full grid is reported as it was before there were samples and conditions
        return content | {key: value for key in ("when", "sample", "files") if (value := getattr(self, key))}

    @property
    def laws(self) -> tuple[str, ...]:
        """Registry names, one or more."""
        return (self.law,) if isinstance(self.law, str) else self.law

    @property
    def kinds(self) -> tuple[type[Controller], ...]:
        """Their classes."""
        return self._kinds

    def contents(self) -> dict[str, str]:
        """Content of the code of each law that is not the toolkit's, by name; also of laws that options name."""
        kinds = [*self.kinds]
        for space in self.space():
            for name in space.kind.law_options:
                choices = dict(space.gains).get(name, Choices((getattr(space.kind, name),)))
                if isinstance(choices, Choices):  # the name of a law is no number between two ends
                    kinds += [law for value in choices.values for law in laws_inside(space.kind, {name: value})]
        return {kind.name: content for kind in kinds if (content := content_of(kind))}

    @property
    def size(self) -> int:
        """At most so many designs are made; 0 for a space that only a search can use."""
        spaces = self.space()
        if self.sample is not None:
            return sum(self.sample.points(len(space.varying)) for space in spaces)
        return 0 if self.uncounted else sum(space.size or 0 for space in spaces)

    @property
    def uncounted(self) -> str:
        """Key path of the first range without a count; empty where there is none."""
        if isinstance(self.y_s, Span):
            return "y_s"
        return next((f"gains.{name}" for name, entry in self.gains.items() if isinstance(entry, Span)), "")

    def space(self) -> tuple[LawSpace, ...]:
        """The space of each law, in the order written."""
        spaces = []
        for kind in self.kinds:
            names = set(declared_gains(kind))
            gains = tuple((name, _dimension(entry)) for name, entry in self.gains.items() if name in names)
            conditions = tuple(
                Condition(name, on, values)
                for name in self.when
                if name in names
                for on, values in self.when[name].items()
            )
            spaces.append(LawSpace(kind, _dimension(self.y_s), gains, conditions))
        return tuple(spaces)

    def designs(self) -> list[Design]:
        """The full grid, laws slowest, then thresholds, in the order written; or the sample, which may have doubles."""
        if self.sample is None:
            return [design for space in self.space() for design in space.grid()]
        return [design for sample in self.samples() for design in sample.designs]

    def samples(self) -> tuple[LawSample, ...]:
        """The sample of each law, in the order written; empty for a table without ``sample``."""
        if self.sample is None:
            return ()
        points = [(space, unit_points(self.sample, len(space.varying))) for space in self.space()]
        return tuple(LawSample(shares, space.at(shares)) for space, shares in points)


def check_blocks(blocks: Sequence[DesignBlock], *, searched: bool) -> None:
    """Refuse tables that do not fit a study with a search, or one without."""
    for i, block in enumerate(blocks):
        if searched and block.sample is not None:
            raise InputError(f"design[{i}].sample", "is not possible with [search]", allowed="no sample")
        if not searched and block.sample is None and block.uncounted:
            hint = "only a [design.sample] and a study with [search] need no count"
            raise InputError(f"design[{i}].{block.uncounted}.count", "missing", hint=hint)


def _written(entry: Any) -> Any:
    if isinstance(entry, Span):
        return {"from": entry.first, "to": entry.last, "scale": entry.scale}
    return entry


def _dimension(entry: tuple[Any, ...] | Span) -> Dimension:
    return entry if isinstance(entry, Span) else Choices(entry)


_LAW: Final = "FILE.py:NAME of a controller or its class"


def named_laws(
    table: dict[str, Any], classes: dict[str, type[Controller]], folder: Path = Path(), path: str = "design"
) -> dict[str, Any]:
    """A design table with names for laws that were given as designs, classes or FILE.py:NAME; they are registered.

    Its ``files`` are the places of the last, by name: another process finds them there.
    """
    if "law" not in table:
        return table
    laws, files, names, gains = table["law"], table.get("files", {}), list[Any](), dict[str, Any]()
    listed = list(laws) if isinstance(laws, list | tuple) else [laws]
    stored = [place for name, place in files.items() if name not in classes] if isinstance(files, dict) else []
    for law in [*stored, *listed]:
        of_file = isinstance(law, str) and ".py:" in law
        given = from_file(path, law, folder, _LAW) if of_file else law
        if isinstance(given, Controller):
            values = {gain.name: getattr(given, gain.name) for gain in given.gains()}
            if len(listed) == 1:
                gains |= values
            elif values != {gain.name: gain.default for gain in given.gains()}:
                problem, hint = "a design with changed gains in a list of laws", "write a design table for each law"
                raise InputError(path, problem, value=given, allowed="names, classes, unchanged designs", hint=hint)
            given = type(given)
        if isinstance(given, type) and issubclass(given, Controller):
            if given.name not in controller_names() or controller_class(given.name) is not given:
                register(given)
            if content_of(classes.setdefault(given.name, given)) != content_of(given):
                raise InputError(path, "names two different laws", value=given.name, allowed="a name for each")
            files = {**files, given.name: str((folder / law).resolve())} if of_file else files
            given = given.name
        elif of_file:
            raise InputError(path, "is not a known control law", value=law, allowed=_LAW)
        names.append(given)
    names, written = names[len(stored) :], table.get("gains", {})
    table = table | {"law": names if isinstance(laws, list | tuple) else names[0]} | ({"files": files} if files else {})
    return table | ({"gains": gains | written} if gains and isinstance(written, dict) else {})


def load_laws(content: dict[str, Any], folder: Path, classes: dict[str, type[Controller]]) -> dict[str, Any]:
    """What a study file holds, with its laws known to this process and named."""
    if not isinstance(tables := content.get("design"), list | tuple):
        return content
    named = [
        named_laws(table, classes, folder, f"design[{i}].law") if isinstance(table, dict) else table
        for i, table in enumerate(tables)
    ]
    return content | {"design": named}


def _read_laws(entry: Any, classes: Mapping[str, type[Controller]] | None) -> tuple[tuple[str, ...], tuple[Any, ...]]:
    """The laws of a table: names, and classes, from those given or else by name."""
    names = (entry,) if isinstance(entry, str) else entry
    if not isinstance(names, list | tuple) or not names or not all(isinstance(name, str) for name in names):
        raise InputError("law", value=entry, allowed="text, or a list of different laws")
    if len(set(names)) != len(names):
        raise InputError("law", value=entry, allowed="each law once")
    kinds = []
    for i, name in enumerate(names):
        try:
            kinds.append((classes or {}).get(name) or controller_class(name))
        except LdcError as error:
            raise InputError.of(error).at("law" if isinstance(entry, str) else f"law[{i}]") from None
    return tuple(names), tuple(kinds)


def _read_thresholds(entry: Any) -> tuple[float, ...] | Span:
    """The trigger thresholds [m] of a table."""
    try:
        dimension = read_entry(entry)
    except InputError as error:
        raise error.within("y_s") from None
    if isinstance(dimension, Span):
        return dataclasses.replace(dimension, first=_threshold(dimension.first), last=_threshold(dimension.last))
    return tuple(_threshold(value) for value in dimension.values)


def _threshold(value: Any) -> float:
    return checked_number("y_s", value, lower=Y_S.lower, unit="m, below 0 before the line") + 0.0


def _read_gain(kinds: Kinds, name: str, entry: Any) -> tuple[Any, ...] | Span:
    """The values of a gain, which the laws that declare it must take for the same."""
    readings = {kind.name: _reading(kind, name, entry, len(kinds) > 1) for kind in _declaring(kinds, name, "gains")}
    (first, reading), *others = readings.items()
    for law, other in others:
        if other != reading:
            allowed = "a list, a range with scale, or a [[design]] for each law"
            raise InputError(f"gains.{name}", f"{first!r} and {law!r} space this range differently", allowed=allowed)
    return reading


def _declaring(kinds: Kinds, name: str, table: str) -> Kinds:
    """The laws that have a gain of this name; raises `InputError` where none has."""
    declaring = [kind for kind in kinds if name in declared_gains(kind)]
    if not declaring:
        every = {name for kind in kinds for name in declared_gains(kind)}
        raise InputError(f"{table}.{name}", "no such gain", allowed=every)
    return declaring


def _reading(kind: type[Controller], name: str, entry: Any, name_law: bool) -> tuple[Any, ...] | Span:
    """What one law takes an entry for, every value checked."""
    declared = find_gain(kind, name)
    path = f"gains.{name}"
    try:
        dimension = read_entry(entry, declared.scale, whole=declared.whole)
    except InputError as error:
        raise error.within(path) from None
    try:
        for end in (entry["from"], entry["to"]) if isinstance(entry, dict) else ():  # not what they are rounded to
            declared.check(end, kind.name)
        if not isinstance(dimension, Span):
            return tuple(declared.check(value, kind.name) for value in dimension.values)
    except InputError as error:
        outside = error.at(path)
        outside.problem = f"for {kind.name!r}" if name_law else ""
        raise outside from None
    number = int if declared.whole else float
    return dataclasses.replace(dimension, first=number(dimension.first), last=number(dimension.last))


def _read_conditions(
    kinds: Kinds, when: dict[str, Any], gains: dict[str, Any]
) -> dict[str, dict[str, tuple[Any, ...]]]:
    """``[design.when]``: gain -> other gain -> the values of the other for which the gain varies."""
    conditions: dict[str, dict[str, tuple[Any, ...]]] = {}
    for name, table in when.items():
        path = f"when.{name}"
        if name not in gains:
            raise InputError(path, "no such gain in [design.gains]", allowed=[*gains])
        if not isinstance(table, dict) or not table:
            raise InputError(path, value=table, allowed="a table of other gains and their values")
        for on in table:
            if on not in gains or on == name:
                others = [other for other in gains if other != name]
                raise InputError(f"{path}.{on}", "no such other gain in [design.gains]", allowed=others)
            if on in when:
                raise InputError(f"{path}.{on}", "has a condition itself", allowed="a gain without one")
        conditions[name] = {on: _condition(kinds, name, on, entry, gains[on]) for on, entry in table.items()}
    return conditions


def _condition(kinds: Kinds, name: str, on: str, entry: Any, known: tuple[Any, ...] | Span) -> tuple[Any, ...]:
    """The values of the gain `on` for which the gain `name` varies, each among the `known` ones."""
    path = f"when.{name}.{on}"
    if isinstance(known, Span):
        raise InputError(path, f"gains.{on} is a range without a count", allowed="a gain with a list of values")
    for kind in _declaring(kinds, name, "when"):
        if on not in declared_gains(kind):
            raise InputError(path, f"no gain of {kind.name!r}, which has {name!r}", allowed="a gain of the same law")
    try:
        values = expand(entry)
    except InputError as error:
        raise error.within(path) from None
    for value in values:
        if not any(value == other and isinstance(value, bool) == isinstance(other, bool) for other in known):
            raise InputError(path, f"is not among gains.{on}", value=value, allowed=[*map(str, known)])
    return values
