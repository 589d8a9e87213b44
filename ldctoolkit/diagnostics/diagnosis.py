"""The whole diagnosis of a mixture, or of both sides of a scenario model."""

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, unmasked
from ldctoolkit.departures import LEFT, RIGHT, Departures
from ldctoolkit.diagnostics._marginals import (
    BINS,
    FAR_OUTSIDE,
    ILL_CONDITIONED,
    LEAST_PROBABILITY,
    Calibration,
    Component,
    Marginal,
    ModelDiagnostics,
    SideDiagnostics,
    Strip,
    bin_edges,
    box_share,
    calibrate,
    joint_density,
    kolmogorov_limit,
    marginal,
    model_marginal,
    strip_is_off,
)
from ldctoolkit.errors import InputError
from ldctoolkit.mixture import BoundedGaussianMixture, Distribution
from ldctoolkit.mixture.checks import Events as Rows
from ldctoolkit.mixture.checks import check_number, check_weights, inside_bounds
from ldctoolkit.scenario_model import ScenarioModel, SideModel, SideSummary

LEAST_EVENTS: Final = 10


@dataclasses.dataclass(frozen=True)
class Events:
    """Events strictly inside the box."""

    x: FloatArray  # (n, d): rows
    weight: FloatArray  # (n,): events that each row stands for
    outside: tuple[tuple[str, int], ...]  # (str, int): rows left out since they lie outside a bound, per parameter

    @property
    def share(self) -> FloatArray:
        """Weights that sum to one."""
        out: FloatArray = self.weight / self.weight.sum()
        return out

    @property
    def effective(self) -> float:
        """Kish's effective number of events."""
        return float(self.weight.sum() ** 2 / (self.weight**2).sum())


def checked_events(
    distribution: Distribution, names: tuple[str, ...], X: npt.ArrayLike, weights: npt.ArrayLike | None
) -> Events:
    """Check, leave out what is outside the box, and move what is on a bound just inside, as the fit does."""
    try:
        x = np.array(unmasked(X), dtype=float)
    except (TypeError, ValueError):
        raise InputError("X", "not a table of numbers", allowed="(n, d), one row an event") from None
    d = distribution.dimension
    if x.ndim != 2 or x.shape[1] != d:
        raise InputError("X", f"shape {x.shape}", allowed=f"(n, {d}), the columns {', '.join(names)}")
    if not np.isfinite(x).all():
        row, j = (int(i) for i in np.argwhere(~np.isfinite(x))[0])
        raise InputError("X", f"{names[j]} = {float(x[row, j])!r} in row {row}", allowed="finite numbers")
    weight = np.ones(x.shape[0]) if weights is None else check_weights(weights, x.shape[0], "weights")
    low, high = distribution.transform.lower, distribution.transform.upper
    beyond = (x < low) | (x > high)
    keep = ~beyond.any(axis=1) & (weight > 0.0)
    counts = tuple((names[j], int(beyond[:, j].sum())) for j in np.flatnonzero(beyond.any(axis=0)))
    x, weight = x[keep], weight[keep]
    if x.shape[0] < LEAST_EVENTS:
        raise InputError(
            "X", f"{x.shape[0]} of {keep.size} events lie inside the model's bounds", allowed=f"{LEAST_EVENTS} or more"
        )
    inside = inside_bounds(Rows(x, weight), low, high, names, keep_constant=True)
    return Events(inside.events.x, weight, counts)


Progress = Callable[[str, int, int], None]

N_MODEL: Final = 200_000  # events drawn from the model
_STEPS: Final = 3  # what one side reports to `progress`: margins, bounds, done


def diagnose(
    model: SideModel | BoundedGaussianMixture,
    X: npt.ArrayLike,
    *,
    names: Sequence[str] | None = None,
    seed: int = 0,
    weights: npt.ArrayLike | None = None,
    summary: SideSummary | None = None,
    label: str = "",
    n_model: int = N_MODEL,
    progress: Progress | None = None,
) -> SideDiagnostics:
    """Check a fitted mixture against events.

    Raises `InputError` on events or settings that do not fit, or fewer than ten events inside the box.

    Parameters
    ----------
    model : SideModel or BoundedGaussianMixture
        The mixture.
    X : (n, d)
        Events, columns as in the mixture. Those outside the box are left out and counted; values on a bound are moved
        just inside, as in `fit_scenario_model`.
    names : sequence of str, optional
        Parameters; by default those of the side or of the mixture, else ``x0``, ``x1``, ...
    seed : int
        Seed of the model's sample.
    weights : (n,), optional
        Events that each row stands for.
    summary : SideSummary, optional
        How the side was fitted, for the warnings.
    label : str
        Side, put before every warning.
    n_model : int
        Events drawn from the model, at least 1,000.
    progress : callable, optional
        Called as ``progress("margins", done, total)``.

    Notes
    -----
    Marginals of a truncated mixture have no closed form. Shares next to bounds are integrated; a distribution
    function is integrated at 15 values and follows a sample of `n_model` events between them, to 0.0003; joint
    densities are those of the sample. The Kolmogorov limit is that of fresh events, without a refit: see
    `Calibration` and ``docs/how-to/reading-the-report.md``.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.random.default_rng(0).gamma(1.5, size=(2000, 1))
    >>> normal = BoundedGaussianMixture(1, lower=0.0, random_state=0, n_init=1).fit(x)
    >>> found = diagnose(normal, x, names=["T"], n_model=20_000)
    >>> found.calibrations[0].distance > found.calibrations[0].limit
    True
    """
    mixture = model.mixture if isinstance(model, SideModel) else model
    distribution = mixture.distribution
    chosen = _names(model, names, distribution.dimension)
    check_number("n_model", n_model, 1000, integer=True)
    check_number("seed", seed, 0, integer=True)
    report = progress or (lambda *_: None)
    events = checked_events(distribution, chosen, X, weights)
    x, share = events.x, events.share
    report("margins", 0, _STEPS)
    drawn, _ = distribution.sample(int(n_model), int(seed))
    limit = kolmogorov_limit(events.effective, len(chosen))
    marginals: list[Marginal] = []
    calibrations: list[Calibration] = []
    for j, name in enumerate(chosen):
        low, high = (float(end[j]) for end in (distribution.transform.lower, distribution.transform.upper))
        of_model = model_marginal(distribution, drawn, j)
        edges = bin_edges(x[:, j], drawn[:, j], low, high, BINS)
        marginals.append(marginal(name, x[:, j], share, of_model, edges))
        calibrations.append(calibrate(name, x[:, j], share, of_model, limit))
    report("bounds", 1, _STEPS)
    near, far = strips(distribution, chosen, x, share, events.effective)
    joint = joint_density(distribution, chosen, x, share, drawn)
    table = components(distribution, chosen, x, events.weight)
    found = SideDiagnostics(
        label=label,
        names=chosen,
        events=x.shape[0],
        effective_events=events.effective,
        outside=events.outside,
        n_model=int(n_model),
        seed=int(seed),
        log_likelihood=float(share @ mixture.score_samples(x)),
        marginals=tuple(marginals),
        calibrations=tuple(calibrations),
        strips=near,
        far_bounds=far,
        components=table,
        joint=joint,
        warnings=(),
    )
    report("done", _STEPS, _STEPS)
    return dataclasses.replace(found, warnings=warnings_of(found, mixture, summary))


def diagnose_model(
    model: ScenarioModel,
    departures: Departures,
    *,
    seed: int = 0,
    weights: npt.ArrayLike | None = None,
    n_model: int = N_MODEL,
    progress: Progress | None = None,
) -> ModelDiagnostics:
    """Check both sides of a scenario model against departures.

    Raises `InputError` as for `diagnose`; the message names the side.

    Parameters
    ----------
    model : ScenarioModel
        The model.
    departures : Departures
        Both sides together.
    weights : (n,), optional
        Events that each departure stands for.
    seed, n_model
        As for `diagnose`.
    progress : callable, optional
        Called as ``progress("left: margins", done, total)``, over both sides.

    Examples
    --------
    >>> from ldctoolkit.departures import PARAMETER_NAMES
    >>> from ldctoolkit.scenario_model import load_model
    >>> drawn = load_model("reference").sample(300, 300, seed=1)
    >>> columns = {name: getattr(drawn, name) for name in ("side", *PARAMETER_NAMES)}
    >>> zero = np.zeros(600, dtype=np.int64)
    >>> departures = Departures(**columns, recording=zero.astype(str), start_time=1.0 * zero, samples=zero)
    >>> found = diagnose_model(load_model("reference"), departures, n_model=5_000)
    >>> found.left.events, found.right.label
    (300, 'right')
    """
    parts: list[SideDiagnostics] = []
    sides = (
        ("left", LEFT, model.left_side, model.provenance.left),
        ("right", RIGHT, model.right_side, model.provenance.right),
    )
    weight = None if weights is None else check_weights(weights, departures.n, "weights", "departure")
    for number, (label, side, half, summary) in enumerate(sides):
        mask = departures.side == side
        rows = departures.take(mask)
        own = None if weight is None else weight[mask]

        def report(text: str, done: int, total: int, label: str = label, before: int = number) -> None:
            if progress is not None and (text != "done" or before == 1):
                progress("done" if text == "done" else f"{label}: {text}", before * total + done, 2 * total)

        X = np.column_stack([getattr(rows, name) for name in half.names])
        try:
            found = diagnose(
                half, X, seed=seed, weights=own, summary=summary, label=label, n_model=n_model, progress=report
            )
        except InputError as error:
            raise InputError(f"departures ({label})", f"{error}") from None
        warnings = list(found.warnings)
        for name, value in half.constants:
            column = getattr(rows, name)
            if not np.allclose(column, value, rtol=1e-9, atol=1e-12):
                shown = f"{float(column.min()):g} to {float(column.max()):g}"
                warnings.append(f"{label}: the model holds {name} at {value:g}, in the departures it is {shown}")
        parts.append(dataclasses.replace(found, warnings=tuple(warnings)))
    return ModelDiagnostics(*parts)


def _names(model: SideModel | BoundedGaussianMixture, names: Sequence[str] | None, dimension: int) -> tuple[str, ...]:
    given = names if names is not None else model.names
    if given is None:
        return tuple(f"x{j}" for j in range(dimension))
    if len(given) != dimension:
        raise InputError("names", f"{len(given)} names", allowed=f"{dimension}, one a column")
    return tuple(str(name) for name in given)


_BLOCK: Final = 65_536


def components(
    distribution: Distribution, names: tuple[str, ...], x: FloatArray, weight: FloatArray
) -> tuple[Component, ...]:
    """One row a component; weights count events."""
    K = distribution.weights.size
    total, squares = np.zeros(K), np.zeros(K)
    for start in range(0, x.shape[0], _BLOCK):
        rows = slice(start, start + _BLOCK)
        share = weight[rows, None] * distribution.shares(x[rows])
        total += share.sum(axis=0)
        squares += (share**2).sum(axis=0)
    normal = distribution.truncated
    spread = np.sqrt(np.diagonal(normal.Sigma, axis1=1, axis2=2))
    outside = np.maximum(np.maximum(normal.lower - normal.mu, normal.mu - normal.upper) / spread, 0.0)
    worst = np.argmax(outside, axis=1)
    condition = np.linalg.cond(normal.Sigma / (spread[:, :, None] * spread[:, None, :]))
    return tuple(
        Component(
            weight=float(distribution.weights[k]),
            log_probability=float(normal.log_probability[k]),
            outside=float(outside[k, worst[k]]),
            outside_name=names[worst[k]] if outside[k, worst[k]] > 0.0 else "",
            condition=float(condition[k]),
            events=float(total[k]),
            kish=float(total[k] ** 2 / squares[k]) if squares[k] > 0.0 else 0.0,
        )
        for k in range(K)
    )


QUANTILE: Final = 0.05  # a strip reaches from the bound to this quantile of the events
NEAR: Final = 0.5  # a bound counts where its strip is narrower than this part of the middle 90 % of the events

_ENDS: Final[tuple[Literal["lower", "upper"], ...]] = ("lower", "upper")


def weighted_quantile(column: FloatArray, weight: FloatArray, share: float) -> float:
    """The least value that this share of the weight does not exceed; weights sum to one."""
    order = np.argsort(column, kind="stable")
    reached = np.cumsum(weight[order])
    return float(column[order][min(int(np.searchsorted(reached, share * (1.0 - 1e-12))), column.size - 1)])


def strips(
    distribution: Distribution, names: tuple[str, ...], x: FloatArray, weight: FloatArray, effective_events: float
) -> tuple[tuple[Strip, ...], tuple[tuple[str, str], ...]]:
    """Strips at the bounds that events come near to, and the names of the bounds that they do not."""
    found: list[Strip] = []
    far: list[tuple[str, str]] = []
    for j, name in enumerate(names):
        quantiles = [weighted_quantile(x[:, j], weight, share) for share in (QUANTILE, 1.0 - QUANTILE)]
        for end, edge in zip(_ENDS, quantiles, strict=True):
            low, high = distribution.transform.lower.copy(), distribution.transform.upper.copy()
            bound = float(low[j] if end == "lower" else high[j])
            if not np.isfinite(bound):
                continue
            if abs(edge - bound) > NEAR * (quantiles[1] - quantiles[0]) or edge == bound:
                far.append((name, end))
                continue
            inside = x[:, j] <= edge if end == "lower" else x[:, j] >= edge
            (high if end == "lower" else low)[j] = edge
            data, model = float(weight[inside].sum()), box_share(distribution, low, high)
            spread = float(np.sqrt(data * (1.0 - data) / effective_events))
            found.append(Strip(name, end, bound, edge, data, model, model / data - 1.0, spread / data * (model / data)))
    return tuple(found), tuple(far)


def warnings_of(
    found: SideDiagnostics, mixture: BoundedGaussianMixture, summary: SideSummary | None
) -> tuple[str, ...]:
    """Sentences, the most serious first; each begins with the side where there is one."""
    prefix = f"{found.label}: " if found.label else ""
    lines = (*_fit(found, mixture, summary), *_misfit(found), *_components(found), *_events(found, summary))
    return tuple(f"{prefix}{line}" for line in lines)


def _fit(found: SideDiagnostics, mixture: BoundedGaussianMixture, summary: SideSummary | None) -> Iterator[str]:
    converged = summary.converged if summary is not None else getattr(mixture, "converged_", True)
    if not converged:
        yield "the fit stopped before it had converged"
    K = mixture.distribution.weights.size
    largest = summary is not None and len(summary.n_components) > 1 and max(summary.n_components) == K
    d = len(found.names)
    free = 1 + d + d * (d + 1) // 2  # parameters of one component
    few = [k for k, one in enumerate(found.components) if one.events < free]
    if few:
        events = ", ".join(f"{found.components[k].events:.1f}" for k in few)
        which = f"component {few[0]} rests" if len(few) == 1 else f"components {', '.join(map(str, few))} rest"
        also = f"K = {K} is the largest that was tried, but " if largest else ""
        advice = ": more departures are needed, not more components" if largest else ""
        yield f"{also}{which} on fewer effective events ({events}) than the {free} parameters of one{advice}"
    elif largest:
        yield f"the chosen K = {K} is the largest that was tried, the best may be larger: try more"


def _misfit(found: SideDiagnostics) -> Iterator[str]:
    beyond = sorted((c for c in found.calibrations if c.distance > c.limit), key=lambda c: -c.distance)
    if beyond:
        shown = ", ".join(f"{c.name} {c.distance:.3g}" for c in beyond)
        yield (
            f"Kolmogorov distance beyond the {beyond[0].limit:.3g} that chance allows in {len(beyond)} of "
            f"{len(found.names)} parameters: {shown}"
        )
    off = sorted((strip for strip in found.strips if strip_is_off(strip)), key=lambda strip: -abs(strip.error))
    if off:
        shown = ", ".join(
            f"{s.name} {s.end} {abs(s.error):.0%} {'too much' if s.error > 0 else 'too little'} ({s.model:.2%}, events "
            f"{s.data:.2%})"
            for s in off
        )
        yield f"the model's mass next to bounds is not that of the events: {shown}".replace("%", " %")


def _components(found: SideDiagnostics) -> Iterator[str]:
    """What is odd about components, one sentence a cause."""
    tails, flat = [], []
    for k, one in enumerate(found.components):
        rare = one.log_probability < math.log(LEAST_PROBABILITY)
        if rare or one.outside > FAR_OUTSIDE:
            parts = [f"P = 10^{one.log_probability / math.log(10.0):.0f}"] if rare else []
            if one.outside > 0.0:
                parts.append(f"mean {one.outside:.1f} standard deviations outside in {one.outside_name}")
            tails.append(f"{k} ({', '.join(parts)})")
        if one.condition > ILL_CONDITIONED:
            flat.append(f"{k} ({one.condition:.2g})")
    if tails:
        yield f"tails of normals that lie outside the bounds, of which mean and covariance say little: {_named(tails)}"
    if flat:
        yield f"nearly flat, by the condition number of the correlation matrix: {_named(flat)}"


def _named(parts: list[str]) -> str:
    return f"component{'' if len(parts) == 1 else 's'} {', '.join(parts)}"


def _events(found: SideDiagnostics, summary: SideSummary | None) -> Iterator[str]:
    for name, count in summary.moved_inside if summary is not None else ():
        yield f"{count} events had {name} exactly on a bound, moved just inside"
    if found.outside:
        shown = ", ".join(f"{name} {count}" for name, count in found.outside)
        yield f"events outside the model's bounds were left out ({shown})"
