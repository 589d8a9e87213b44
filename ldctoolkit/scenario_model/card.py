"""The card of a scenario model: from what, how and with what it was fitted."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import platform
from collections.abc import Mapping
from typing import Any

from ldctoolkit.scenario_model.source_summary import SourceSummary
from ldctoolkit.version import __version__


@dataclasses.dataclass(frozen=True)
class SideSummary:
    """How one side was fitted. Tuples over K are empty where a criterion was not computed.

    Attributes
    ----------
    events : int
        Departures used.
    n_components : tuple of int
        The K that were fitted.
    bic, log_likelihood : tuple of float
        Criterion, and log-likelihood per event [nats], of each.
    converged : bool
        Whether the chosen fit reached its tolerance.
    moved_inside : tuple of (str, int)
        Events that lay exactly on a bound, per parameter.
    redrawn_share : float
        Share of drawn events that fall below the speed floor and are drawn again.
    n_parameters : tuple of int
        Free parameters of each K.
    aic, icl : tuple of float
        Other criteria of each K, lower is better.
    held_out : tuple of float
        Log-likelihood per event [nats] on events that were kept out of the fit.
    criterion : str
        By which K was taken; ``""`` where one K was fitted as asked.
    reason : str
        Why this K, in words.
    failed : tuple of (int, str)
        The K that could not be fitted, and why.
    passes : int, optional
        Of the chosen fit.
    stop_reason : str
        Of the chosen fit, as in `BoundedGaussianMixture`.
    weight : float, optional
        Sum of the weights, where the departures had any.
    bounds_from : tuple of (str, str, str)
        Parameter, and where its lower and upper bound come from: ``"given"``, ``"extraction criteria"``,
        ``"physical"`` or ``"auto"``.
    source_summary : SourceSummary, optional
        How the departures spread; None where weights rest on too few departures.
    """

    events: int
    n_components: tuple[int, ...]
    bic: tuple[float, ...]
    log_likelihood: tuple[float, ...]
    converged: bool
    moved_inside: tuple[tuple[str, int], ...]
    redrawn_share: float
    n_parameters: tuple[int, ...] = ()
    aic: tuple[float, ...] = ()
    icl: tuple[float, ...] = ()
    held_out: tuple[float, ...] = ()
    criterion: str = ""
    reason: str = ""
    failed: tuple[tuple[int, str], ...] = ()
    passes: int | None = None
    stop_reason: str = ""
    weight: float | None = None
    bounds_from: tuple[tuple[str, str, str], ...] = ()
    source_summary: SourceSummary | None = None


@dataclasses.dataclass(frozen=True)
class FitSettings:
    """Settings of the fits, the same for both sides.

    Attributes
    ----------
    criterion : {"bic", "aic", "icl", "held_out"}
        What K is chosen by.
    slack : float, optional
        The smallest K within this distance of the best criterion is taken; None is the criterion's own.
    indifference : float
        The same in nats per event; the larger of the two counts.
    prior_strength : float
        Pseudo-events per component.
    tol : float
        Gain per pass [nats an event] below which a fit has converged.
    n_init : int
        Starts.
    max_iter : int
        Most passes.
    """

    criterion: str
    slack: float | None
    indifference: float
    prior_strength: float
    tol: float
    n_init: int
    max_iter: int


@dataclasses.dataclass(frozen=True)
class ModelProvenance:
    """Where a scenario model comes from.

    Attributes
    ----------
    source : mapping
        JSON values that describe the data; ``"criteria"`` and ``"refused"`` are those of the extraction.
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
    versions : mapping of str to str
        Software behind the numbers, see `software_versions`.
    settings : FitSettings, optional
        Of the fits.
    """

    source: Mapping[str, Any]
    synthetic: bool = False
    created: str = ""
    software: str = ""
    seed: int = 0
    warnings: tuple[str, ...] = ()
    left: SideSummary | None = None
    right: SideSummary | None = None
    versions: Mapping[str, str] = dataclasses.field(default_factory=dict)
    settings: FitSettings | None = None


def software_versions() -> dict[str, str]:
    """Versions of what a fit's numbers come from."""
    packages = {name: importlib.metadata.version(name) for name in ("numpy", "scipy", "numba")}
    return {"ldctoolkit": __version__, "python": platform.python_version()} | packages
