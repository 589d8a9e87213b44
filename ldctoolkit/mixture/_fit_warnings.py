"""What a user should know of a fit before trusting it, in sentences."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray
from ldctoolkit.mixture._distribution import Distribution
from ldctoolkit.mixture.checks import column_name
from ldctoolkit.mixture.events import Events, Profile, sums_of

_LEAST_LOG_P: Final = -20.0
"""Below this ln P the box lies some 6 standard deviations off: only the density inside still says something."""

_FAR_OUTSIDE: Final = 6.0
_SAME: Final = 0.9999
"""Correlation of two columns of which one could be left out."""

_THIN: Final = 5e-3
"""Standard deviation of a component, in the data's, below which it describes single values rather than a spread."""

_LOST_DIGITS: Final = 1e-8
"""Spread of a column over its size: half of a number's sixteen digits are used up by what is common to all rows."""

_OUTLYING: Final = 5.0
_SHARE_OF_ONE: Final = 0.5
_MOST: Final = 6
"""Components named in a sentence."""


def correlation_of(events: Events, profile: Profile) -> FloatArray:
    """Correlations (d, d) of the events' columns, by one pass."""
    d = events.dimension
    i, j = np.triu_indices(d)
    _, sums = sums_of(events, profile.mean, profile.scale, np.zeros((1, 1 + d + i.size)))
    out = np.empty((d, d))
    out[i, j] = out[j, i] = sums[0, 1 + d :] / sums[0, 0]
    return out


def fit_warnings(
    distribution: Distribution,
    profile: Profile,
    correlation: FloatArray,
    *,
    stop_reason: str,
    passes: int,
    names: Sequence[str] | None = None,
) -> tuple[str, ...]:
    """Sentences, the gravest first; none where nothing is to be said."""
    out = [_stopped(stop_reason, passes)] if stop_reason != "converged" else []
    out += _of_components(distribution, profile)
    out += _of_columns(profile, correlation, names)
    return tuple(out)


def _stopped(stop_reason: str, passes: int) -> str:
    if stop_reason == "max_iter":
        return f"Not converged in {passes} passes: raise max_iter or tol."
    if stop_reason == "stuck":
        return (
            f"Not converged: after {passes} passes no step raised the likelihood, though it is at no maximum; raise "
            "prior_strength or fit fewer components."
        )
    return (
        f"Not converged: after {passes} passes a component had become too thin for the arithmetic; raise "
        "prior_strength or fit fewer components."
    )


def _of_components(distribution: Distribution, profile: Profile) -> list[str]:
    t = distribution.truncated
    d = distribution.dimension
    out: list[str] = []
    if t.box is not None:
        lost = ~np.isfinite(t.box.log_peak) & (t.log_probability < np.log(0.25))
        if lost.any():
            out.append(f"{_which(lost)} cannot be sampled: the box is too far off.")
    parameters = d + d * (d + 1) // 2
    events = distribution.weights * profile.events
    few = events < parameters
    if few.any():
        out.append(
            f"{_which(few)} ({_figures(few, events)} events): fewer than the {parameters} parameters of a mean and a "
            "covariance; the prior decides the rest."
        )
    deviation = np.sqrt(np.diagonal(t.Sigma, axis1=1, axis2=2))
    outside = np.max(np.maximum(np.maximum(t.lower - t.mu, t.mu - t.upper) / deviation, 0.0), axis=1)
    far = (t.log_probability < _LEAST_LOG_P) | (outside > _FAR_OUTSIDE)
    if far.any():
        out.append(
            f"{_which(far)} (ln P {_figures(far, t.log_probability)}; {_figures(far, outside)} standard deviations "
            "outside the box): events pile up at a bound as an exponential does; mean and covariance before truncation "
            "say little, the density in the box holds."
        )
    scaled = t.Sigma / (profile.scale[:, None] * profile.scale)
    width = np.sqrt(np.maximum(np.linalg.eigvalsh(scaled)[:, 0], 0.0))
    thin = width < _THIN
    if thin.any():
        out.append(
            f"{_which(thin)} ({_figures(thin, width)} standard deviations of the data): hardly any width in some "
            "direction; look for repeated rows, columns that depend on each other, or events far off."
        )
    return out


def _of_columns(profile: Profile, correlation: FloatArray, names: Sequence[str] | None) -> list[str]:
    out: list[str] = []
    for a, b in zip(*(k.tolist() for k in np.triu_indices(correlation.shape[0], 1)), strict=True):
        r = float(correlation[a, b])
        if abs(r) > _SAME:
            one, other = column_name(a, names), column_name(b, names)
            out.append(f"{_capital(one)} and {other} are nearly the same (correlation {r:.9g}): leave one out.")
    above, below = (profile.most - profile.mean) / profile.scale, (profile.mean - profile.least) / profile.scale
    off = np.maximum(above, below)
    size = np.maximum(np.abs(profile.least), np.abs(profile.most))
    for j in range(size.size):
        name = _capital(column_name(j, names))
        share = min(float(off[j] ** 2) / profile.rows, 1.0)
        if profile.scale[j] < _LOST_DIGITS * size[j]:
            ratio = float(profile.scale[j] / size[j])
            out.append(f"{name} varies by {ratio:.1g} of its size: few digits are left; subtract what is common.")
        if off[j] > _OUTLYING and share > _SHARE_OF_ONE:
            value = float(profile.most[j] if above[j] >= below[j] else profile.least[j])
            out.append(f"{name}: one event, {value:.6g}, makes up {share:.0%} of the variance; is it real?")
    return out


def _which(mask: BoolArray) -> str:
    """Names of components: ``Component 2``, ``Components 2, 5``."""
    rows = np.flatnonzero(mask)
    more = ", ..." if rows.size > _MOST else ""
    return f"Component{'s' if rows.size > 1 else ''} {', '.join(str(k) for k in rows[:_MOST])}{more}"


def _figures(mask: BoolArray, values: FloatArray) -> str:
    """The same components' figures."""
    shown = values[mask]
    return ", ".join(f"{v:.3g}" for v in shown[:_MOST].tolist()) + (", ..." if shown.size > _MOST else "")


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
