"""What a diagnosis consists of: plain numbers, ready to be tabled or drawn."""

from __future__ import annotations

import dataclasses
from typing import Final, Literal

import numpy as np

from ldctoolkit.arrays import FloatArray


@dataclasses.dataclass(frozen=True)
class Marginal:
    """Histogram of one parameter, events beside model.

    Attributes
    ----------
    name : str
        The parameter.
    edges : (m + 1,) [SI units of the parameter]
        Edges of the bins; they may leave out the outermost tails.
    data, model : (m,)
        Share of the events, and of the model, in each bin.
    data_beyond, model_beyond : float
        Shares outside all bins.
    """

    name: str
    edges: FloatArray
    data: FloatArray
    model: FloatArray
    data_beyond: float
    model_beyond: float


@dataclasses.dataclass(frozen=True)
class Calibration:
    """Probability integral transform of one parameter: u = F(x), uniform where the model is right.

    Attributes
    ----------
    name : str
        The parameter.
    u : (m,)
        Grid from 0 to 1.
    difference : (m,)
        Share of events with F(x) <= u, minus u.
    distance : float
        Kolmogorov distance, the greatest absolute difference over all events.
    limit : float
        For as many events drawn from this very model, no parameter exceeds it in 95 % of cases.
    position : float [SI units of the parameter]
        Where the distance is reached.
    """

    name: str
    u: FloatArray
    difference: FloatArray
    distance: float
    limit: float
    position: float


@dataclasses.dataclass(frozen=True)
class Strip:
    """Share of events and of the model next to one finite bound.

    Attributes
    ----------
    name : str
        The parameter.
    end : {"lower", "upper"}
        Which bound.
    bound, edge : float [SI units of the parameter]
        The strip lies between them; `edge` is the 5 % (95 %) quantile of the events.
    data, model : float
        Shares in the strip.
    error : float
        ``model / data - 1``.
    standard_error : float
        Of `error`, binomial, for the effective number of events.
    """

    name: str
    end: Literal["lower", "upper"]
    bound: float
    edge: float
    data: float
    model: float
    error: float
    standard_error: float


@dataclasses.dataclass(frozen=True)
class Component:
    """One component of the mixture.

    Attributes
    ----------
    weight : float
        eta_k, its share of the events.
    log_probability : float
        ln P_k, the logarithm of its normal's probability of the box.
    outside : float
        How far mu_k lies outside the box, in standard deviations of Sigma_k, in the worst parameter; 0 inside.
    outside_name : str
        That parameter; empty inside.
    condition : float
        Condition number of the correlation matrix of Sigma_k.
    events : float
        Effective number of events, sum_i w_i r_ik.
    kish : float
        Kish's effective number, (sum_i w_i r_ik)^2 / sum_i (w_i r_ik)^2: how many whole events would tell as much.
    """

    weight: float
    log_probability: float
    outside: float
    outside_name: str
    condition: float
    events: float
    kish: float

    @property
    def probability(self) -> float:
        """P_k; zero where it is below the smallest number that a computer holds."""
        return float(np.exp(self.log_probability))


@dataclasses.dataclass(frozen=True)
class PairDensity:
    """Joint histogram of two parameters, events beside model.

    Attributes
    ----------
    first, second : str
        The parameters.
    first_edges : (a + 1,), second_edges : (b + 1,) [SI units]
        Edges of the bins.
    data, model : (a, b)
        Shares of the events and of the model in each bin.
    """

    first: str
    second: str
    first_edges: FloatArray
    second_edges: FloatArray
    data: FloatArray
    model: FloatArray


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Held-out log-likelihood of a bounded mixture, and of one fitted after a logarithm or logit of bounded parameters.

    Attributes
    ----------
    K : int
        Components of both.
    events_fit, events_held_out : int
        Sizes of the two halves, the same for both.
    transforms : tuple of (str, str)
        Parameter and its map in the second mixture.
    bounded, transformed : float
        Log-likelihood per held-out event, in the data's units [nats].
    difference : float
        transformed - bounded [nats per event].
    standard_error : float
        Of the difference, paired over the held-out events.
    """

    K: int
    events_fit: int
    events_held_out: int
    transforms: tuple[tuple[str, str], ...]
    bounded: float
    transformed: float
    difference: float
    standard_error: float


@dataclasses.dataclass(frozen=True)
class SideDiagnostics:
    """How well a mixture describes events.

    Attributes
    ----------
    label : str
        Which side; may be empty.
    names : tuple of str
        The d parameters of the mixture.
    events : int
        Events inside the box.
    effective_events : float
        Kish's effective number of them; equal to `events` without weights.
    outside : tuple of (str, int)
        Events outside the bounds, per parameter; they are left out.
    n_model : int
        Events drawn from the model.
    seed : int
        Seed of the draws.
    log_likelihood : float
        Per event, on these events [nats].
    marginals : tuple of Marginal
        One a parameter.
    calibrations : tuple of Calibration
        One a parameter.
    strips : tuple of Strip
        One for each finite bound that events come near to.
    far_bounds : tuple of (str, str)
        Parameter and end of the finite bounds that they do not come near to.
    components : tuple of Component
        In the order of the mixture.
    joint : PairDensity or None
        T against d_y, where both vary.
    comparison : Comparison or None
        None where it cannot be made; `comparison_note` says why.
    comparison_note : str
        Empty where it was made.
    warnings : tuple of str
        What a user should know, in words.
    """

    label: str
    names: tuple[str, ...]
    events: int
    effective_events: float
    outside: tuple[tuple[str, int], ...]
    n_model: int
    seed: int
    log_likelihood: float
    marginals: tuple[Marginal, ...]
    calibrations: tuple[Calibration, ...]
    strips: tuple[Strip, ...]
    far_bounds: tuple[tuple[str, str], ...]
    components: tuple[Component, ...]
    joint: PairDensity | None
    comparison: Comparison | None
    comparison_note: str
    warnings: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class ModelDiagnostics:
    """Both sides of a scenario model.

    Attributes
    ----------
    left, right : SideDiagnostics
        One a side.
    """

    left: SideDiagnostics
    right: SideDiagnostics


LEAST_PROBABILITY: Final = 1e-6
"""P of a component in the box."""

FAR_OUTSIDE: Final = 5.0
"""Standard deviations of a component's mean outside the box."""

ILL_CONDITIONED: Final = 1e4
"""Condition number of a component's correlation matrix."""

STRIP_ERROR: Final = 0.2
STRIP_STANDARD_ERRORS: Final = 4.0
"""Both must be exceeded by the error of the mass next to a bound."""

COMPARISON_STANDARD_ERRORS: Final = 2.0
"""By which one of two mixtures is better on held-out events."""


def strip_is_off(strip: Strip) -> bool:
    """Whether the mass next to a bound is clearly wrong."""
    return abs(strip.error) > max(STRIP_ERROR, STRIP_STANDARD_ERRORS * strip.standard_error)
