"""Bounded Gaussian mixtures: truncated normals, truncated EM, choice of the number of components."""

from ldctoolkit.mixture._distribution import SAMPLE_BLOCK, Distribution
from ldctoolkit.mixture._trial import Failure
from ldctoolkit.mixture.bounded_events import InsideBounds, inside_bounds
from ldctoolkit.mixture.bounded_gaussian_mixture import BoundedGaussianMixture
from ldctoolkit.mixture.bounds import auto_bounds
from ldctoolkit.mixture.dask_events import DaskEvents
from ldctoolkit.mixture.parquet_events import ParquetEvents
from ldctoolkit.mixture.selection import Selection, select_components
from ldctoolkit.mixture.sources import ArrayEvents, EventSource
from ldctoolkit.mixture.truncated_normal import TruncatedNormal

__all__ = [
    "SAMPLE_BLOCK",
    "ArrayEvents",
    "BoundedGaussianMixture",
    "DaskEvents",
    "Distribution",
    "EventSource",
    "Failure",
    "InsideBounds",
    "ParquetEvents",
    "Selection",
    "TruncatedNormal",
    "auto_bounds",
    "inside_bounds",
    "select_components",
]
