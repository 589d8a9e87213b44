"""Bounded Gaussian mixtures: truncated normals, truncated EM, choice of the number of components."""

from ldctoolkit.mixture._distribution import SAMPLE_BLOCK, Distribution
from ldctoolkit.mixture.bounded_gaussian_mixture import BoundedGaussianMixture
from ldctoolkit.mixture.selection import Selection, select_components
from ldctoolkit.mixture.sources import ArrayEvents, EventSource
from ldctoolkit.mixture.truncated_normal import TruncatedNormal

__all__ = [
    "SAMPLE_BLOCK",
    "ArrayEvents",
    "BoundedGaussianMixture",
    "Distribution",
    "EventSource",
    "Selection",
    "TruncatedNormal",
    "select_components",
]
