"""Results as data frames: one row a departure or design, columns with their unit at the end."""

from __future__ import annotations

import abc
from typing import TYPE_CHECKING, Any

from ldctoolkit.arrays import ReadOnly
from ldctoolkit.errors import LdcError

if TYPE_CHECKING:
    import polars as pl


class Frame(ReadOnly, abc.ABC):
    """What can be a data frame."""

    @abc.abstractmethod
    def to_polars(self) -> pl.DataFrame:
        """A polars data frame, a unit at the end of each column's name: ``deepest_m``."""

    def to_pandas(self) -> Any:
        """The same as a pandas data frame; pandas is not among the toolkit's own packages."""
        try:
            import pandas  # type: ignore[import-untyped,unused-ignore]
        except ImportError:
            raise LdcError(
                "to_pandas", "pandas is not installed", allowed="pip install pandas, or to_polars()"
            ) from None

        return pandas.DataFrame({name: column.to_numpy() for name, column in self.to_polars().to_dict().items()})
