"""What a comparison of generated departures consists of."""

from __future__ import annotations

import dataclasses
import math
from typing import Literal

from ldctoolkit.arrays import FloatArray

Origin = Literal["table", "summary", "none"]
"""Where the source departures are known from: a departures table, the model's file, or not at all."""


@dataclasses.dataclass(frozen=True)
class Distance:
    """A Kolmogorov distance beside the one that chance exceeds in 5 % of cases in one of the parameters or more."""

    value: float
    limit: float

    @property
    def beyond(self) -> bool:
        """Whether it is more than chance."""
        return self.value > self.limit


@dataclasses.dataclass(frozen=True)
class Margin:
    """One parameter.

    Attributes
    ----------
    name : str
        The parameter.
    edges : (m + 1,) [SI units]
        Of the bins.
    generated, source, model : (m,)
        Shares in each bin; source and model are None where they are not known.
    generated_at, source_at : (3,) [SI units]
        Quantiles of 5, 50 and 95 %.
    to_source, to_model : Distance, optional
        Of the generated departures.
    """

    name: str
    edges: FloatArray
    generated: FloatArray
    source: FloatArray | None
    model: FloatArray | None
    generated_at: FloatArray
    source_at: FloatArray | None
    to_source: Distance | None
    to_model: Distance | None


@dataclasses.dataclass(frozen=True)
class Pair:
    """Two parameters.

    Attributes
    ----------
    first, second : str
        The parameters.
    first_edges, second_edges : (b + 1,) [SI units]
        Of the cells.
    generated, reference : (b, b)
        Shares in each cell; the reference are the source departures or, where these are not known, the model.
    generated_rank, reference_rank : float
        Spearman's rank correlation.
    limits : (low, high), optional
        What chance takes the generated one beyond in 5 % of cases in one of the pairs or more.
    """

    first: str
    second: str
    first_edges: FloatArray
    second_edges: FloatArray
    generated: FloatArray
    reference: FloatArray | None
    generated_rank: float
    reference_rank: float | None
    limits: tuple[float, float] | None

    @property
    def beyond(self) -> bool:
        """Whether the rank correlations differ by more than chance."""
        return self.limits is not None and not self.limits[0] <= self.generated_rank <= self.limits[1]

    @property
    def off(self) -> float:
        """Distance of the generated rank correlation from the reference's; 1 is where chance ends, 0 if not known."""
        if self.limits is None or self.reference_rank is None:
            return 0.0
        gap = self.generated_rank - self.reference_rank
        reach = self.limits[1] - self.reference_rank if gap > 0.0 else self.reference_rank - self.limits[0]
        return abs(gap) / reach if reach > 0.0 else (math.inf if gap else 0.0)


@dataclasses.dataclass(frozen=True)
class Drawing:
    """What the draws of a side's mixture come to.

    Attributes
    ----------
    K : int
        Components.
    within_bounds : float
        Share of the mixture's draws without bounds that lie within them.
    redrawn : float
        Share of draws within the bounds that are too slow to be replayed, and drawn again.
    met : float, optional
        Share of the model's departures that meets the study's conditions; None without conditions, or where a
        parameter has one value.
    """

    K: int
    within_bounds: float
    redrawn: float
    met: float | None


@dataclasses.dataclass(frozen=True)
class SideMatch:
    """One side.

    Attributes
    ----------
    key : {"left", "right"}
        The side.
    generated : int
        Departures of the study.
    source : int or None
        Source departures that they are compared with.
    origin : {"table", "summary", "none"}
        Where these are known from.
    reason : str
        Why the source departures are not known, or not all; a sentence, may be empty.
    margins : tuple of Margin
    pairs : tuple of Pair
    drawing : Drawing, optional
        None without a model.
    """

    key: str
    generated: int
    source: int | None
    origin: Origin
    reason: str
    margins: tuple[Margin, ...]
    pairs: tuple[Pair, ...]
    drawing: Drawing | None

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters that vary."""
        return tuple(margin.name for margin in self.margins)

    @property
    def widest_pair(self) -> Pair | None:
        """The pair whose rank correlation is furthest from the reference's, measured by what chance makes."""
        known = [pair for pair in self.pairs if pair.reference_rank is not None]
        return max(known, key=lambda pair: pair.off, default=None)
