"""Types of arrays, whose shapes are given where they are used, and frozen dataclasses of arrays."""

from __future__ import annotations

import abc
import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ldctoolkit.errors import LdcError

if TYPE_CHECKING:
    import polars as pl

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]


def unmasked(values: Any) -> Any:
    """A masked array as a plain one whose masked entries are missing: NaN, or False; anything else as it is."""
    if not np.ma.isMaskedArray(values):
        return values
    if not np.ma.is_masked(values) or values.dtype.kind == "b":
        return np.ma.filled(values, False)
    return np.ma.filled(values.astype(np.float64 if values.dtype.kind in "iuf" else np.object_), np.nan)


class ReadOnly:
    """A frozen dataclass whose arrays cannot be written to: views, so that the caller's own arrays stay writable."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):  # type: ignore[arg-type]
            array = getattr(self, field.name)
            if isinstance(array, np.ndarray):
                array = unmasked(array).view()
                array.flags.writeable = False
                object.__setattr__(self, field.name, array)


class Frame(ReadOnly, abc.ABC):
    """What can be a data frame: a row a departure or design, columns with their unit at the end, ``deepest_m``."""

    @abc.abstractmethod
    def to_polars(self) -> pl.DataFrame:
        """A polars data frame."""

    def to_pandas(self) -> Any:
        """The same as a pandas data frame; pandas is not among the toolkit's own packages."""
        try:
            import pandas  # type: ignore[import-untyped,unused-ignore]
        except ImportError:
            raise LdcError("to_pandas", "needs pandas, which is not installed", hint="or use to_polars()") from None

        return pandas.DataFrame({name: column.to_numpy() for name, column in self.to_polars().to_dict().items()})
