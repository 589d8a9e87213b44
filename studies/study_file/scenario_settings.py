"""The table ``[scenarios]`` of a study file."""

from __future__ import annotations

import math
from typing import Any, Self

from pydantic import Field, field_validator, model_validator

from ldctoolkit.errors import InputError
from ldctoolkit.scenario_model import conditions
from studies.study_file._part import Part, fail


def _condition(entry: Any) -> Any:
    """A value, or (lower, upper); an infinite end is open and stored as None, which JSON knows."""
    if not isinstance(entry, list | tuple):
        return entry
    return tuple(None if isinstance(end, float) and math.isinf(end) else end for end in entry)


class ScenarioSettings(Part):
    """``[scenarios]``: the model that generates them, how many of each side, and which ones.

    Attributes
    ----------
    model : str
        Bundled model, or the path of a model file relative to the study file.
    left, right : int
        Number of departures to each side.
    given : dict of str to float or (float, float)
        Only departures with these parameters: a value, or (lower, upper), None for open.
    """

    model: str = "reference"
    left: int = Field(default=500, ge=0, le=10_000_000)
    right: int = Field(default=500, ge=0, le=10_000_000)
    given: dict[str, float | tuple[float | None, float | None]] = Field(default_factory=dict)

    @field_validator("given", mode="before")
    @classmethod
    def _conditions(cls, entry: Any) -> Any:
        if not isinstance(entry, dict):
            return entry
        given = {}
        for name, value in entry.items():
            try:
                conditions({name: value})
            except InputError as error:
                key, _, message = str(error).partition(": ")
                raise fail("" if key == "given" else name, message) from None
            given[name] = _condition(value)
        return given

    @model_validator(mode="after")
    def _some(self) -> Self:
        if self.left + self.right == 0:
            raise fail("", "left and right are both 0; allowed: at least one scenario")
        return self
