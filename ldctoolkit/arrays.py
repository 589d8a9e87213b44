"""Types of arrays, masked arrays and arrays that cannot be written to; shapes are given where they are used."""

import dataclasses
from typing import Any

import numpy as np
import numpy.typing as npt

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
