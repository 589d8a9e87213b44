"""Bounded Gaussian mixtures: truncated normals, truncated EM, choice of the number of components."""

from ldctoolkit.mixture._distribution import SAMPLE_BLOCK, Distribution
from ldctoolkit.mixture.bounded_gaussian_mixture import BoundedGaussianMixture
from ldctoolkit.mixture.selection import Failure, Selection, select_components
from ldctoolkit.mixture.truncated_normal import TruncatedNormal

__all__ = [
    "SAMPLE_BLOCK",
    "BoundedGaussianMixture",
    "Distribution",
    "Failure",
    "Selection",
    "TruncatedNormal",
    "select_components",
]
