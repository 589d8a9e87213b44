"""What a scenario model is made of: one side's mixture and constants, provenance, and the physical bounds."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.departures import PARAMETER_NAMES
from ldctoolkit.errors import InputError, ModelError
from ldctoolkit.mixture import BoundedGaussianMixture

FloatArray = npt.NDArray[np.float64]

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
class SideSummary:
    """How one side was fitted.

    Attributes
    ----------
    events : int
        Departures used.
    n_components : tuple of int
        The K that were tried.
    bic, log_likelihood : tuple of float
        Criterion, and log-likelihood per event [nats], of each.
    converged : bool
        Whether the chosen fit reached its tolerance.
    moved_inside : tuple of (str, int)
        Events that lay exactly on a bound, per parameter.
    redrawn_share : float
        Share of drawn events that fall below the speed floor and are drawn again.
    """

    events: int
    n_components: tuple[int, ...]
    bic: tuple[float, ...]
    log_likelihood: tuple[float, ...]
    converged: bool
    moved_inside: tuple[tuple[str, int], ...]
    redrawn_share: float


@dataclasses.dataclass(frozen=True)
class ModelProvenance:
    """Where a scenario model comes from.

    Attributes
    ----------
    source : mapping
        JSON values that describe the data.
    synthetic : bool
        True where the data were drawn from a stated population and not recorded.
    created : str
        Time in UTC, ISO 8601.
    software : str
        Name and version of the program that fitted it.
    seed : int
        Seed of the fit.
    warnings : tuple of str
        What a user of the model should know.
    left, right : SideSummary, optional
        How each side was fitted.
    """

    source: Mapping[str, Any]
    synthetic: bool = False
    created: str = ""
    software: str = ""
    seed: int = 0
    warnings: tuple[str, ...] = ()
    left: SideSummary | None = None
    right: SideSummary | None = None


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
        """Lower and upper bounds of `names`."""
        return np.asarray(self.mixture.lower, dtype=float), np.asarray(self.mixture.upper, dtype=float)


def check_usable(mixture: BoundedGaussianMixture) -> None:
    """Refuse a mixture that cannot be sampled; a fit and a file go through this one check.

    Raises
    ------
    ModelError
        Naming the component, or what overflows.
    """
    if not np.isfinite(mixture.log_probabilities_).all():
        k = int(np.argmin(np.isfinite(mixture.log_probabilities_)))
        raise ModelError(f"component {k}: the probability of its box is not a number that a computer can hold")
    try:
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            mixture.distribution.check_samplable()
    except (FloatingPointError, np.linalg.LinAlgError) as error:
        raise ModelError(f"the mixture cannot be sampled, its numbers are too far apart ({error})") from None


def whole_number(name: str, value: Any) -> int:
    """An integer >= 0, or an `InputError` that names it."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 0:
        raise InputError(f"{name}: {value!r}; allowed: an integer >= 0")
    return int(value)
