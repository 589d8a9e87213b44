"""Bounded Gaussian mixtures: truncated normals, truncated EM, choice of the number of components."""

from ldctoolkit.mixture.bounded_gaussian_mixture import BoundedGaussianMixture
from ldctoolkit.mixture.selection import Selection, select_components
from ldctoolkit.mixture.truncated_normal import TruncatedNormal

__all__ = ["BoundedGaussianMixture", "Selection", "TruncatedNormal", "select_components"]
