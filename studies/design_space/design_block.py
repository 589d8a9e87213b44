"""The tables ``[[design]]`` of a study file: laws, and a space of their trigger threshold and gains."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

from pydantic import (
    Field,
    InstanceOf,
    SerializerFunctionWrapHandler,
    field_serializer,
    model_serializer,
    model_validator,
)

from ldctoolkit import controller_class
from ldctoolkit.gains import Gain, declared_gains
from studies.design import Design
from studies.design_space.design_entries import read_conditions, read_gain, read_laws, read_thresholds
from studies.design_space.dimensions import Choices, Dimension, Span
from studies.design_space.law_space import Condition, LawSpace
from studies.design_space.sampling import SampleSettings, unit_points
from studies.study_file._part import Part, fail


@dataclasses.dataclass(frozen=True)
class LawSample:
    """What ``[design.sample]`` makes of one law.

    Attributes
    ----------
    space : LawSpace
    shares : (m, d)
        Points of the unit cube, a column for each name in ``space.varying``.
    designs : tuple of Design
        The design of each row; rows may share one.
    """

    space: LawSpace
    shares: Any
    designs: tuple[Design, ...]


class DesignBlock(Part):
    """``[[design]]``: one law or several, and a space of their trigger threshold and gains.

    Attributes
    ----------
    law : str or tuple of str
        Registry names. A gain goes to the laws that declare it.
    y_s : tuple of float, or Span [m]
        Trigger thresholds; a range without a count holds all between its ends.
    gains : dict of str to tuple or Span
        Values of every gain that is set; the others keep their defaults.
    when : dict of str to dict
        Conditions: gain -> other gain of the same law -> its values for which the first one varies.
    sample : SampleSettings or None
        Take points of the space instead of the full grid.

    Examples
    --------
    >>> block = DesignBlock(law=("lqr", "linear_mpc"), gains={"r_delta": (50.0, 500.0), "horizon": (10, 20, 30)})
    >>> [(space.law, space.size) for space in block.space()]
    [('lqr', 2), ('linear_mpc', 6)]
    """

    law: str | tuple[str, ...]
    y_s: tuple[float, ...] | InstanceOf[Span] = (0.2,)
    gains: dict[str, tuple[Any, ...] | InstanceOf[Span]] = Field(default_factory=dict)
    when: dict[str, dict[str, tuple[Any, ...]]] = Field(default_factory=dict)
    sample: SampleSettings | None = None

    @model_validator(mode="before")
    @classmethod
    def _check(cls, block: Any) -> Any:
        if not isinstance(block, dict) or "law" not in block:
            return block  # the field's own message says what is missing
        checked = dict(block)
        names, kinds = read_laws(block["law"])
        checked["law"] = names[0] if len(names) == 1 else names
        if "y_s" in block:
            checked["y_s"] = read_thresholds(block["y_s"])
        gains = block.get("gains", {})
        if isinstance(gains, dict):
            checked["gains"] = {name: read_gain(kinds, name, entry) for name, entry in gains.items()}
            when = block.get("when", {})
            if isinstance(when, dict):
                checked["when"] = read_conditions(kinds, when, checked["gains"])
        return checked

    @field_serializer("y_s")
    def _written_threshold(self, entry: Any) -> Any:
        return _written(entry)

    @field_serializer("gains")
    def _written_gains(self, gains: dict[str, Any]) -> dict[str, Any]:
        return {name: _written(entry) for name, entry in gains.items()}

    @model_serializer(mode="wrap")
    def _without_defaults(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        # a full grid is told as it was before there were samples and conditions
        content: dict[str, Any] = handler(self)
        return {key: value for key, value in content.items() if value or key not in ("sample", "when")}

    @property
    def laws(self) -> tuple[str, ...]:
        """Registry names, one or more."""
        return (self.law,) if isinstance(self.law, str) else self.law

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
        for law in self.laws:
            declared = {gain.name: gain for gain in declared_gains(controller_class(law))}
            gains = tuple(
                (name, _as_declared(declared[name], entry)) for name, entry in self.gains.items() if name in declared
            )
            conditions = tuple(
                Condition(name, on, values)
                for name, every in self.when.items()
                if name in declared
                for on, values in every.items()
            )
            spaces.append(LawSpace(law, _dimension(self.y_s), gains, conditions))
        return tuple(spaces)

    def designs(self) -> list[Design]:
        """The full grid, laws slowest, then thresholds, in the order written; or the sample, in which one may be twice.

        Raises
        ------
        InputError
            For a range without a count in a table without a sample, and for a sample whose library is missing.
        """
        if self.sample is None:
            return [design for space in self.space() for design in space.grid()]
        return [design for sample in self.samples() for design in sample.designs]

    def samples(self) -> tuple[LawSample, ...]:
        """The sample of each law, in the order written; empty for a table without ``sample``.

        Raises
        ------
        InputError
            For a sample whose library is missing.
        """
        if self.sample is None:
            return ()
        found = []
        for space in self.space():
            shares = unit_points(self.sample, len(space.varying))
            found.append(LawSample(space, shares, space.at(shares)))
        return tuple(found)


def check_blocks(blocks: Sequence[DesignBlock], *, searched: bool) -> None:
    """Refuse tables that do not fit a study with a search, or one without.

    Parameters
    ----------
    blocks : sequence of DesignBlock
        The study's tables.
    searched : bool
        Whether the study asks for its designs.

    Raises
    ------
    pydantic_core.PydanticCustomError
        For a range without a count that is neither sampled nor searched, and for a sample in a search; with the key
        path from the study on.
    """
    for i, block in enumerate(blocks):
        if searched and block.sample is not None:
            message = "a study with [search] asks for its designs itself; allowed: no sample"
            raise fail(f"design[{i}].sample", message)
        if not searched and block.sample is None and block.uncounted:
            message = "missing; allowed without it: a table with [design.sample], or a study with [search]"
            raise fail(f"design[{i}].{block.uncounted}.count", message)


def _written(entry: Any) -> Any:
    if isinstance(entry, Span):
        return {"from": entry.first, "to": entry.last, "scale": entry.scale}
    return entry


def _dimension(entry: tuple[Any, ...] | Span) -> Dimension:
    return entry if isinstance(entry, Span) else Choices(entry)


def _as_declared(declared: Gain, entry: tuple[Any, ...] | Span) -> Dimension:
    """Values in the gain's own type: laws may differ in whether a gain is whole."""
    if isinstance(entry, Span):
        return entry
    return Choices(tuple(declared.check(value, "") for value in entry))
