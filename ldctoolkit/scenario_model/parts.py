"""What a scenario model is made of: one side's mixture and constants, and the physical bounds."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Final

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.departures import PARAMETER_NAMES
from ldctoolkit.errors import ModelError
from ldctoolkit.mixture import BoundedGaussianMixture

PHYSICAL_BOUNDS: Final[Mapping[str, tuple[float, float]]] = {
    "T": (0.5, 10.0),  # s, the extraction criteria
    "d_y": (0.0, np.inf),  # m
    "sigma_y": (0.0, np.inf),  # m
    "v_mean": (5.0, np.inf),  # m/s, the extraction criteria
    "a_mean": (-9.81, 9.81),  # m/s^2, what tyres can do; the extraction refuses more as implausible
    "sigma_v": (0.0, np.inf),  # m/s
    "c_0": (-np.inf, np.inf),  # 1/m
    "dc": (-np.inf, np.inf),  # 1/m
}
"""Default box of the eight parameters, SI units; infinite means open."""

LEAST_LOWER: Final[Mapping[str, float]] = {"T": 0.0, "d_y": 0.0, "sigma_y": 0.0, "v_mean": 0.0, "sigma_v": 0.0}
"""No model may reach below these: such a departure cannot be replayed."""


@dataclasses.dataclass(frozen=True)
class SideModel:
    """One side: a mixture over the parameters that vary, and the values of those that do not.

    Attributes
    ----------
    mixture : BoundedGaussianMixture
        Over `names`, in that order.
    names : tuple of str
        Parameters that vary, in the order of `PARAMETER_NAMES`.
    constants : tuple of (str, float)
        The other parameters.
    """

    mixture: BoundedGaussianMixture
    names: tuple[str, ...]
    constants: tuple[tuple[str, float], ...] = ()

    def columns(self, x: FloatArray) -> dict[str, FloatArray]:
        """All eight parameters of drawn events x (n, len(names))."""
        out = {name: np.full(x.shape[0], value) for name, value in self.constants}
        out |= {name: x[:, j] for j, name in enumerate(self.names)}
        return {name: out[name] for name in PARAMETER_NAMES}

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds of `names`, in the data's units."""
        transform = self.mixture.distribution.transform
        return transform.lower, transform.upper

    def transform(self) -> tuple[str, ...]:
        """How each of `names` was mapped before the fit: ``"none"``, ``"log"`` or ``"logit"``."""
        return self.mixture.distribution.transform.kinds


def check_usable(mixture: BoundedGaussianMixture) -> None:
    """Refuse a mixture that cannot be sampled; a fit and a file go through this one check."""
    if not np.isfinite(mixture.log_probabilities_).all():
        k = int(np.argmin(np.isfinite(mixture.log_probabilities_)))
        raise ModelError(f"component {k}: the probability of its box is not a number that a computer can hold")
    try:
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            mixture.distribution.check_samplable()
    except (FloatingPointError, np.linalg.LinAlgError) as error:
        raise ModelError(f"the mixture cannot be sampled, its numbers are too far apart ({error})") from None
