"""The space of one law's designs: its trigger threshold, its gains, and which gains count only under a condition."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Final

from ldctoolkit.errors import InputError
from ldctoolkit.gains import GainValue
from studies.design import Design
from studies.design_space.dimensions import Choices, Dimension

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

THRESHOLD: Final = "y_s"
"""Name of the trigger threshold among the dimensions."""


@dataclasses.dataclass(frozen=True)
class Condition:
    """A gain that varies only while another has one of some values; otherwise it keeps its default.

    Attributes
    ----------
    gain : str
        The gain that varies.
    on : str
        The other gain, which has no condition of its own.
    values : tuple of float, int, str or bool
        Values of the other one.
    """

    gain: str
    on: str
    values: tuple[GainValue, ...]


@dataclasses.dataclass(frozen=True)
class LawSpace:
    """What a ``[[design]]`` table says about one law.

    Attributes
    ----------
    law : str
        Registry name.
    y_s : Choices or Span [m]
        Trigger thresholds.
    gains : tuple of (str, Choices or Span)
        The gains that are set, in the order written; the others keep their defaults.
    conditions : tuple of Condition

    Examples
    --------
    >>> space = LawSpace("lqr", Choices((0.1, 0.2)), (("r_delta", Choices((50.0, 500.0))),))
    >>> [design.y_s for design in space.grid()]
    [0.1, 0.1, 0.2, 0.2]
    """

    law: str
    y_s: Dimension
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
        """Every design once, the threshold slowest, in the order written.

        Raises
        ------
        InputError
            If a dimension is a range without a count.
        """
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
        """The designs at points of the unit cube; two points may be one design.

        Parameters
        ----------
        shares : (m, d)
            One column for each name in `varying`, from 0 to 1.
        """
        varying = self.varying
        fixed = {name: dimension.at(0.0) for name, dimension in self.dimensions}
        dimensions = [dimension for name, dimension in self.dimensions if name in varying]
        rows = (zip(varying, dimensions, row, strict=True) for row in shares.tolist())
        return tuple(self.design(fixed | {name: dim.at(share) for name, dim, share in row}) for row in rows)

    def design(self, values: Mapping[str, GainValue]) -> Design:
        """The design of one value for each dimension.

        Parameters
        ----------
        values : mapping
            Name of a dimension -> value. A dimension that is left out takes its first value if it has one only, and
            otherwise the gain's default; a gain whose condition does not hold keeps its default in any case.
        """
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
