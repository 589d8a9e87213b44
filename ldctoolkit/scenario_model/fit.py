"""Fit of a scenario model to departures, and its settings."""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final, Literal, Self, get_args

import numpy as np
import numpy.typing as npt
import threadpoolctl

from ldctoolkit.arrays import BoolArray, FloatArray
from ldctoolkit.departures import LEFT, PARAMETER_NAMES, RIGHT, DepartureParameters, Departures, Plausibility
from ldctoolkit.errors import InputError, ModelError
from ldctoolkit.mixture import BoundedGaussianMixture, Selection, select_components
from ldctoolkit.mixture._distribution import KINDS, Transform
from ldctoolkit.mixture.checks import (
    Events,
    InsideBounds,
    check_components,
    check_number,
    check_weights,
    inside_bounds,
    profile_of,
)
from ldctoolkit.recordings import Criteria
from ldctoolkit.scenario_model.fidelity import Replay, SideFidelity
from ldctoolkit.scenario_model.model import ScenarioModel
from ldctoolkit.scenario_model.provenance import (
    LEAST_LOWER,
    PHYSICAL_BOUNDS,
    FitSettings,
    ModelProvenance,
    SideModel,
    SideSummary,
    check_usable,
    driven,
    software_versions,
    summarize_events,
)
from ldctoolkit.version import __version__

Kind = Literal["auto", "mixture", "smoothed"]

FEW: Final = 2_000  # up to so many departures of a side larger K are given up early
MOST_SMOOTHED: Final = 5_000  # of a side

Bounds = Mapping[str, tuple[float | None, float | None]]
"""Parameter -> (lower, upper) in SI units; None is open."""


@dataclasses.dataclass(frozen=True)
class Box:
    """The box of both sides."""

    lower: FloatArray  # (8,): in the order of `PARAMETER_NAMES`
    upper: FloatArray  # (8,): in the order of `PARAMETER_NAMES`
    origins: tuple[tuple[str, str, str], ...]  # (str, str, str): parameter, and where its ends come from


def box_of(bounds: Bounds | None, criteria: Criteria | None) -> Box:
    """Given bounds, else those of the extraction and of physics."""
    ends = {name: (*pair, "physical", "physical") for name, pair in PHYSICAL_BOUNDS.items()}
    if criteria is not None:  # no event outside them could have been found
        found = "extraction criteria"
        ends["T"] = (criteria.min_duration, criteria.max_duration, found, found)
        ends["v_mean"] = (criteria.min_speed, np.inf, found, "physical")
    if bounds is not None and not isinstance(bounds, Mapping):
        raise InputError("bounds", value=bounds, allowed="a mapping of parameters")
    for name, entry in (bounds or {}).items():
        if name not in ends:
            raise InputError("bounds", "is no parameter", value=name, allowed=PARAMETER_NAMES)
        least = LEAST_LOWER.get(name, -np.inf)  # open as far as can be driven
        try:
            low, high = entry
            low, high = least if low is None else float(low), np.inf if high is None else float(high)
        except (TypeError, ValueError):
            raise InputError(f"bounds[{name!r}]", value=entry, allowed="(lower, upper)") from None
        if not least <= low < high:
            raise InputError(f"bounds[{name!r}]", value=entry, allowed=f"{least:g} <= lower < upper")
        ends[name] = (low, high, "physical" if entry[0] is None and least > -np.inf else "given", "given")
    lower, upper, *_ = zip(*(ends[name] for name in PARAMETER_NAMES), strict=True)
    return Box(np.array(lower), np.array(upper), tuple((name, *ends[name][2:]) for name in PARAMETER_NAMES))


@dataclasses.dataclass(frozen=True)
class SideSettings:
    """How each side is fitted."""

    components: int | tuple[int, ...] | None  # K, or the K to choose from in ascending order
    seed: int  # of the fits
    box: Box
    transform: dict[str, str]  # of each parameter: ``"none"``, ``"log"``, ``"logit"`` or ``"auto"``
    fit: FitSettings  # choice of K, prior, tolerance, starts
    workers: int | None  # cores; all by default
    kind: Kind  # what the departures are generated from
    plausibility: Plausibility  # what can happen
    vehicle_width: float | None  # [m] of the recordings
    verbose: bool  # report every start and pass on stderr

    def selection(self, rows: int) -> dict[str, Any]:
        """Arguments of `select_components` for so many events, but for the events and the box."""
        return dataclasses.asdict(self.fit) | {
            "split_merge": rows > FEW,
            "random_state": self.seed,
            "n_jobs": self.workers,
            "verbose": int(self.verbose),
        }


def component_numbers(components: int | Iterable[int] | None) -> int | tuple[int, ...] | None:
    """K, or the K to choose from, in ascending order."""
    if isinstance(components, int | np.integer):
        return check_components([components])[0]
    return None if components is None else tuple(check_components(components))


def transforms(transform: str | Mapping[str, str] | None) -> dict[str, str]:
    """The wanted transform of each parameter."""
    if transform is None or isinstance(transform, str):
        return dict.fromkeys(PARAMETER_NAMES, _transform("transform", transform or "none"))
    out = dict.fromkeys(PARAMETER_NAMES, "none")
    for name, kind in transform.items():
        if name not in out:
            raise InputError("transform", "is no parameter", value=name, allowed=PARAMETER_NAMES)
        out[name] = _transform(f"transform[{name!r}]", kind)
    return out


def _transform(where: str, kind: Any) -> str:
    if kind not in KINDS:
        raise InputError(where, value=kind, allowed=KINDS)
    return str(kind)


def check_transform(wanted: Mapping[str, str], lower: FloatArray, upper: FloatArray) -> None:
    """Refuse a map that the bounds (8,) do not allow, by the parameter's name."""
    for j, name in enumerate(PARAMETER_NAMES):
        finite = int(np.isfinite(lower[j])) + int(np.isfinite(upper[j]))
        needed = {"log": 1, "logit": 2}.get(wanted[name], finite)
        if finite != needed:
            allowed = "one finite bound" if needed == 1 else "two finite bounds"
            raise InputError(
                f"transform[{name!r}]",
                f"with the bounds {lower[j]:g} to {upper[j]:g}",
                value=wanted[name],
                allowed=f"with {allowed}",
            )


LEAST_EVENTS: Final = 30  # departures a side needs

_SEED_END: Final = 10**18


def fit_scenario_model(
    departures: Departures,
    *,
    components: int | Iterable[int] | None = None,
    kind: Kind = "auto",
    seed: int = 0,
    bounds: Bounds | None = None,
    plausibility: Plausibility | None = None,
    extraction: Criteria | None = None,
    weights: npt.ArrayLike | None = None,
    transform: str | Mapping[str, str] | None = None,
    criterion: Literal["bic", "aic"] = "bic",
    slack: float = 10.0,
    indifference: float = 0.0,
    prior_strength: float = 10.0,
    tol: float = 1e-7,
    n_init: int | None = None,
    max_iter: int = 500,
    workers: int | None = None,
    verbose: bool = False,
    source_provenance: Mapping[str, Any] | str = "",
    synthetic: bool = False,
    progress: Progress | None = None,
) -> ScenarioModel:
    """Fit a scenario model to departures: one mixture a side, the number of components K by a stated rule.

    Parameters
    ----------
    departures : Departures
        Both sides together.
    components : int or iterable of int, optional
        K, or the K to choose from: 1 to 10, or 1 to 4 with up to 2,000 departures on a side. A range is cut where the
        events no longer carry it (half an event a free parameter). One K is fitted as requested.
    kind : {"auto", "mixture", "smoothed"}
        What departures are generated from. ``"mixture"`` is the bounded Gaussian mixture; with up to 2,000 departures
        on a side, of the K to choose from the smallest from the criterion's on that gives the recordings' answer (see
        `check_fidelity`). ``"smoothed"`` are the departures themselves, resampled with a kernel: a component each.
        ``"auto"`` takes those where no such mixture gives the answer; one K as requested stays.
    seed : int
        Seed of the fits.
    bounds : mapping, optional
        Parameter -> (lower, upper) in SI units, None for open. The others end at the criteria of the extraction if
        given and at ``PHYSICAL_BOUNDS`` otherwise.
    plausibility : Plausibility, optional
        What can happen; departures beyond it are left out, and none is generated. Those of the extraction if given.
    extraction : Criteria, optional
        The criteria that the departures were extracted with: no event outside them could have been found.
    weights : (n,), optional
        Events that each departure stands for; those of weight 0 are left out.
    transform : {"none", "log", "logit", "auto"} or mapping, optional
        Map of each parameter before the fit, as in `BoundedGaussianMixture`: one for all, or by name.
    criterion, slack, indifference
        How K is chosen, see `select_components`.
    prior_strength, tol, max_iter
        Of each fit, see `BoundedGaussianMixture`.
    n_init : int, optional
        Starts of each fit; 8 by default, 2 with up to 2,000 departures.
    workers : int, optional
        Cores to use, all by default. It changes no number.
    verbose : bool
        Tell of every start and pass on stderr.
    source_provenance : mapping or str
        JSON values that describe the data, kept in the model; ``"hours"`` [h] and ``"distance"`` [m] are those driven.
    synthetic : bool
        Whether the departures were drawn and not recorded.
    progress : callable, optional
        Called as ``progress("left: K = 3", done, total)``, first for the left side and then for the right one.

    Returns
    -------
    ScenarioModel
        What a user should know (constant parameters, values on a bound, a cut range, a K that could not be fitted) is
        in ``provenance.warnings``; ``provenance.left.reason`` says why K was taken.

    Raises
    ------
    InputError
        Fewer than 30 departures on a side (the message gives both counts), a value outside the bounds, a range of
        which the events carry nothing, or a setting out of range.
    ModelError
        If no fitted mixture can be sampled.

    Notes
    -----
    A parameter with the same value in every event of a side is left out of the mixture and kept as a constant. A
    value exactly on a bound is moved inside by half the smallest other distance to it, at most a thousandth of the
    column's standard deviation.

    Examples
    --------
    >>> import numpy as np
    >>> from ldctoolkit import Departures, load_model
    >>> from ldctoolkit.departures import PARAMETER_NAMES
    >>> drawn = load_model("reference").sample(60, 60, seed=1)
    >>> departures = Departures(
    ...     drawn.side, *drawn.matrix().T, np.full(120, "r"), np.zeros(120), np.full(120, 20)
    ... )
    >>> model = fit_scenario_model(departures, components=1, bounds={"d_y": (0, 1.5), "dc": (None, None)})
    >>> model.provenance.left.reason
    'K = 1, as requested'
    """
    check_number("seed", seed, 0, integer=True)
    if seed >= _SEED_END:
        raise InputError("seed", value=seed, allowed="below 10^18, the longest whole number of a model file")
    if kind not in get_args(Kind):
        raise InputError("kind", value=kind, allowed=get_args(Kind))
    starts = n_init if n_init is not None else 8 if departures.n > FEW else 2
    limits = plausibility or (Plausibility() if extraction is None else extraction.plausibility)
    chosen: tuple[Any, ...] = criterion, slack, indifference, prior_strength, tol, starts, max_iter
    settings = SideSettings(
        components=component_numbers(components),
        seed=int(seed),
        box=box_of(bounds, extraction),
        transform=transforms(transform),
        fit=FitSettings(*(value.item() if isinstance(value, np.generic) else value for value in chosen)),
        workers=workers,
        kind=kind,
        plausibility=limits,
        vehicle_width=None if extraction is None else extraction.vehicle_width,
        verbose=verbose,
    )
    events = _events(departures, weights, settings)
    carried = {label: carried_components(settings.components, side) for label, side in events.items()}
    with threadpoolctl.threadpool_limits(1, "blas"):  # small matrices: more threads only wait for each other
        fits = {label: fit_side(side, carried[label], settings, progress) for label, side in events.items()}
    source: dict[str, Any] = (
        {"description": source_provenance} if isinstance(source_provenance, str) else dict(source_provenance)
    )
    if extraction is not None:
        source.setdefault("criteria", dataclasses.asdict(extraction))
    provenance = ModelProvenance(
        source=source,
        synthetic=synthetic,
        created=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        software=f"ldctoolkit {__version__}",
        seed=int(seed),
        warnings=tuple(note for fit in fits.values() for note in fit.warnings),
        versions=software_versions(),
        settings=settings.fit,
        **driven(source),
    )
    model = ScenarioModel(fits["left"].side, fits["right"].side, provenance, limits)
    one, other = (
        dataclasses.replace(fits[label].summary, redrawn_share=model.redrawn_share(side))
        for label, side in (("left", LEFT), ("right", RIGHT))
    )
    return dataclasses.replace(model, provenance=dataclasses.replace(provenance, left=one, right=other))


def _events(departures: Departures, weights: npt.ArrayLike | None, settings: SideSettings) -> dict[str, SideEvents]:
    """The departures of each side, ready for the fit."""
    weight = None if weights is None else check_weights(weights, departures.n, "weights", "departure")
    with np.errstate(all="ignore"):  # what is no departure at all is refused later
        counts = settings.plausibility.holds(departures) | ~np.isfinite(departures.matrix()).all(axis=1)
    left_out = int((~counts).sum())
    counts &= True if weight is None else weight > 0.0
    rows = {label: counts & (departures.side == side) for label, side in (("left", LEFT), ("right", RIGHT))}
    left, right = (int(mask.sum()) for mask in rows.values())
    if min(left, right) < LEAST_EVENTS:
        beyond = f", beside {left_out} that are not plausible" if left_out else ""
        raise InputError(
            "departures", f"{left} left and {right} right{beyond}", allowed=f"at least {LEAST_EVENTS} a side"
        )
    every = Events(departures.matrix(), weight, settings.workers)
    return {label: side_events(every.take(mask), label, settings) for label, mask in rows.items()}


Progress = Callable[[str, int, int], None]

EVENTS_PER_PARAMETER: Final = 0.5  # a range of K is cut where fewer would stand behind each free parameter

# a complaint about one of these is none about the departures
_SETTINGS: Final = ("criterion", "slack", "indifference", "prior_strength", "tol", "n_init", "max_iter", "n_jobs")


@dataclasses.dataclass(frozen=True)
class SideFit:
    """A fitted side, how it was fitted, and what a user should know."""

    side: SideModel
    summary: SideSummary
    warnings: tuple[str, ...]


def fit_side(
    events: SideEvents,
    carried: tuple[tuple[int, ...], tuple[str, ...]],
    settings: SideSettings,
    progress: Progress | None,
) -> SideFit:
    """Fit the departures of one side, with the K that they carry."""
    label, n = events.label, events.rows
    notes = [
        f"{label}: {name} is {value:g} in every event and is kept as a constant" for name, value in events.constants
    ]
    notes += [
        f"{label}: {count} events had {name} exactly on a bound, moved just inside" for name, count in events.moved
    ]
    tried, cut = carried
    notes += cut
    judge = _Judge.of(events, settings)
    selection, failed = _select(events, tried[:1] if settings.kind == "smoothed" else tried, settings, progress, judge)
    chosen = judge.choice(selection)
    unmapped = set(settings.transform.values()) == {"none"}
    if settings.kind == "auto" and len(tried) > 1 and n > FEW and unmapped and not chosen.passed:
        mapped = dataclasses.replace(settings, transform=dict.fromkeys(PARAMETER_NAMES, "auto"))
        other, failures = _select(events, tried, mapped, progress, judge)
        found = judge.choice(other)
        if found.merit > chosen.merit:
            text = f"{other.reason}, of mapped parameters: without maps the mixture does not agree with the recordings"
            selection, failed, chosen = other, failures, dataclasses.replace(found, reason=text)
    best = chosen.mixture
    notes += [f"{label}: K = {K} could not be fitted ({message})" for K, message in failed]
    if chosen.kind == "mixture":
        notes += [f"{label}: {sentence}" for sentence in best.warnings_]
    if chosen.fidelity is not None and not chosen.fidelity.passed:
        notes.append(f"{label}: {chosen.fidelity.text}")
    several = len(tried) > 1
    why = "as requested" if isinstance(settings.components, int) else "the only one of the range that the events carry"
    summary = SideSummary(
        events=n,
        n_components=tuple(int(K) for K in selection.n_components),
        bic=tuple(selection.bic.tolist()),
        log_likelihood=tuple(selection.log_likelihood.tolist()),
        converged=chosen.kind == "smoothed" or best.converged_,
        moved_inside=events.moved,
        redrawn_share=0.0,
        n_parameters=tuple(int(p) for p in selection.n_parameters),
        aic=tuple(selection.aic.tolist()),
        criterion=selection.criterion if several else "",
        reason=chosen.reason or (selection.reason if several else f"K = {tried[0]}, {why}"),
        failed=failed,
        passes=best.n_iter_ if chosen.kind == "mixture" else None,
        stop_reason=best.stop_reason_ if chosen.kind == "mixture" else "",
        weight=events.weight,
        bounds_from=events.box.origins,
        source_summary=summarize_events(events.events, events.names),
        kind=chosen.kind,
        fidelity=chosen.fidelity,
    )
    return SideFit(SideModel(best, events.names, events.constants), summary, tuple(notes))


_ENOUGH: Final = 0.93  # share of answers within their own 95 % intervals to be chosen: the verdict's are wider


@dataclasses.dataclass(frozen=True)
class _Checked:
    """What departures are generated from, and how it compares with the recorded ones."""

    mixture: BoundedGaussianMixture
    kind: Literal["mixture", "smoothed"]
    fidelity: SideFidelity | None  # None where hardly any departure can be drawn or driven
    alone: float  # share of the answers within intervals that hold for each by itself
    reason: str = ""  # why not what the criterion chose

    @property
    def passed(self) -> bool:
        """Gives the recordings' answer."""
        return self.fidelity is not None and self.fidelity.passed

    @property
    def agrees(self) -> bool:
        """Good enough for other designs too, on few departures."""
        return self.passed and self.alone >= _ENOUGH

    @property
    def merit(self) -> tuple[float, float]:
        """The larger, the better it agrees."""
        return (0.0 if self.fidelity is None else float(self.fidelity.within.mean())), self.alone


@dataclasses.dataclass(frozen=True)
class _Judge:
    """Compares what the departures of a side could be generated from with the recorded ones."""

    events: SideEvents
    settings: SideSettings
    replay: Replay
    known: dict[int, tuple[BoundedGaussianMixture, _Checked]] = dataclasses.field(default_factory=dict)

    @classmethod
    def of(cls, events: SideEvents, settings: SideSettings) -> Self:
        """With the answer of the recorded departures."""
        columns = {name: np.full(events.rows, value) for name, value in events.constants}
        columns |= dict(zip(events.names, events.events.x.T, strict=True))
        recorded = DepartureParameters(np.full(events.rows, events.side), **columns)
        return cls(events, settings, Replay.of(recorded, events.events.weight, settings.vehicle_width))

    def checked(self, mixture: BoundedGaussianMixture, kind: Literal["mixture", "smoothed"] = "mixture") -> _Checked:
        """A mixture beside the recorded departures; each is driven once."""
        if id(mixture) not in self.known:
            half = SideModel(mixture, self.events.names, self.events.constants)
            model = ScenarioModel(half, half, ModelProvenance({}), self.settings.plausibility)
            count = (self.replay.generated, 0) if self.events.side == LEFT else (0, self.replay.generated)
            compared: tuple[SideFidelity | None, float] = None, 0.0
            with contextlib.suppress(InputError, ModelError):
                check_usable(mixture)
                compared = self.replay.compared(model.sample(*count, seed=self.settings.seed))
            self.known[id(mixture)] = mixture, _Checked(mixture, kind, *compared)
        return self.known[id(mixture)][1]

    def enough(self, fits: Selection) -> bool:
        """Whether larger K need not be tried: the criterion has risen, or the last two give the recordings' answer."""
        return fits.risen or (len(fits.models) > 1 and all(self.checked(one).agrees for one in fits.models[:-3:-1]))

    def choice(self, fits: Selection) -> _Checked:
        """The first that gives the recordings' answer: the criterion's K, larger ones, the smoothed departures."""
        rows, kind = self.events.rows, self.settings.kind
        if kind == "smoothed":
            if rows > MOST_SMOOTHED:
                text = f"kind: 'smoothed' with {rows} {self.events.label} departures; allowed: up to {MOST_SMOOTHED}"
                raise InputError(text)
            return dataclasses.replace(self._smoothed(), reason="smoothed departures, as requested")
        first = best = self.checked(fits.best)
        if rows > MOST_SMOOTHED or isinstance(self.settings.components, int):
            return best
        last = fits.chosen
        while rows <= FEW and not best.agrees and last + 1 < len(fits.models):
            last += 1
            best = max(best, self.checked(fits.models[last]), key=lambda one: (one.agrees, *one.merit))
        K, most = (int(fits.n_components[i]) for i in (fits.chosen, last))
        if kind == "auto" and not best.agrees:
            other = self._smoothed()
            if other.merit > best.merit:
                text = f"K = {K}" if most == K else f"K = {K} to {most}"
                return dataclasses.replace(
                    other, reason=f"smoothed departures: no mixture with {text} agrees with them"
                )
        if best is not first:
            text = f"K = {best.mixture.n_components}, which agrees with the recordings better than K = {K}"
            best = dataclasses.replace(best, reason=f"{text} ({fits.reason})")
        return best

    def _smoothed(self) -> _Checked:
        """The smoothed departures: the wider kernel that agrees with them, else the better one."""
        best, *others = (self.checked(smoothed(self.events, width), "smoothed") for width in BANDWIDTHS)
        return best if best.agrees else max(best, *others, key=lambda one: (one.agrees, *one.merit))


BANDWIDTHS: Final = (0.25, 0.125)
"""Of Silverman's rule, which oversmooths what has several modes and a boundary: docs/explanation/decisions.md, 0037."""


def smoothed(events: SideEvents, width: float) -> BoundedGaussianMixture:
    """The departures themselves with a Gaussian kernel in mapped coordinates; mean and covariance are kept there."""
    x, varies = events.events.x, events.inside.varies
    lower, upper = events.box.lower[varies], events.box.upper[varies]
    transform = Transform.of("auto", lower, upper)
    y = transform.forward(x)
    n, d = y.shape
    share = np.full(n, 1.0 / n) if events.events.weight is None else events.events.weight / events.events.weight.sum()
    effective = 1.0 / float(share @ share)
    h = width * (4.0 / (d + 2)) ** (1.0 / (d + 4)) * effective ** (-1.0 / (d + 4))
    mean, covariance = share @ y, np.cov(y.T, aweights=share).reshape(d, d)
    covariance += 1e-6 * np.diag(np.diag(covariance))  # columns that depend on each other
    kernel = covariance * h**2 / (1.0 + h**2)
    return BoundedGaussianMixture.from_parameters(
        share,
        mean + (y - mean) / np.sqrt(1.0 + h**2),
        np.tile(kernel, (n, 1, 1)),
        lower=lower,
        upper=upper,
        transform=transform.kinds,
        names=events.names,
    )


def check_fidelity(
    model: ScenarioModel, departures: Departures, *, weights: npt.ArrayLike | None = None
) -> tuple[SideFidelity, SideFidelity]:
    """Drive test designs on recorded departures and on generated ones, and compare: the left side, then the right.

    Raises `InputError` if a side has fewer than 30 departures that can be driven; `ModelError` if the model cannot be
    sampled.

    Parameters
    ----------
    model : ScenarioModel
        What departures are generated from.
    departures : Departures
        The recorded ones, both sides together; those that the model holds impossible are left out.
    weights : (n,), optional
        Events that each departure stands for.

    Returns
    -------
    tuple of SideFidelity
        ``text`` is the verdict, ``passed`` whether all generated answers lie within the 95 % bootstrap intervals of the
        replayed ones, or differ by less than what matters (3 points of a share, 5 % of a peak).

    Examples
    --------
    >>> from ldctoolkit import load_model
    >>> model = load_model("reference")
    >>> drawn = model.sample(400, 400, seed=1)  # stands for recorded departures
    >>> [side.passed for side in check_fidelity(model, drawn)]
    [True, True]
    """
    weight = None if weights is None else check_weights(weights, departures.n, "weights", "departure")
    possible = model.possible(departures) & (True if weight is None else weight > 0.0)
    rows = [np.flatnonzero(possible & (departures.side == side)) for side in (LEFT, RIGHT)]
    if min(map(len, rows)) < LEAST_EVENTS:
        left, right = map(len, rows)
        raise InputError("departures", f"{left} left and {right} right", allowed=f"at least {LEAST_EVENTS} a side")
    criteria = model.provenance.source.get("criteria")
    width = criteria.get("vehicle_width") if isinstance(criteria, Mapping) else None
    found = []
    for side, own in zip((LEFT, RIGHT), rows, strict=True):
        replay = Replay.of(departures.take(own), None if weight is None else weight[own], width)
        counts = (replay.generated, 0) if side == LEFT else (0, replay.generated)
        found.append(replay.compared(model.sample(*counts, seed=0))[0])
    return found[0], found[1]


def carried_components(
    components: int | tuple[int, ...] | None, events: SideEvents
) -> tuple[tuple[int, ...], tuple[str, ...]]:
    """The K that the events of a side carry, and what to say if these are not all."""
    n, d, label = events.rows, len(events.names), events.label
    if isinstance(components, int):
        return (components,), ()
    components = components or tuple(range(1, 5 if n <= FEW else 11))
    most = max(1, int(n / (EVENTS_PER_PARAMETER * (1 + d + d * (d + 1) // 2))))
    tried = tuple(K for K in components if most >= K)
    if not tried:
        raise InputError(
            "components",
            f"{components[0]} and more",
            allowed=f"a range that begins at {most} or below, {n} {label} departures carry no more",
        )
    if len(tried) == len(components):
        return tried, ()
    return tried, (f"{label}: {n} events carry no more than K = {most}; larger K were not tried",)


def _select(
    events: SideEvents, tried: tuple[int, ...], settings: SideSettings, progress: Progress | None, judge: _Judge
) -> tuple[Selection, tuple[tuple[int, str], ...]]:
    """The fits, and the K that gave no usable one; an error where none did."""
    label, varies = events.label, events.inside.varies
    arguments: dict[str, Any] = settings.selection(events.rows) | {
        "progress": None if progress is None else lambda text, done, total: progress(f"{label}: {text}", done, total),
        "sample_weight": events.events.weight,
        "lower": events.box.lower[varies],
        "upper": events.box.upper[varies],
        "transform": [settings.transform[name] for name in events.names],
        "names": events.names,
        "enough": judge.enough if events.rows <= FEW else None,
    }
    failed: list[tuple[int, str]] = []
    while True:
        try:
            selection = select_components(events.events.x, tried, **arguments)
        except (InputError, ModelError) as error:
            if str(error).partition(":")[0] in _SETTINGS:
                raise
            raise type(error)(f"departures ({label}): {error}") from None
        failed += [(f.n_components, f.message) for f in selection.failures]
        taken = int(selection.n_components[selection.chosen])
        try:
            check_usable(selection.best)
        except ModelError as error:
            tried = tuple(int(K) for K in selection.n_components if taken != K)
            if not tried:
                raise ModelError(f"departures ({label})", f"{error}") from None
            failed.append((taken, str(error)))
        else:
            return selection, tuple(sorted(failed))


@dataclasses.dataclass(frozen=True)
class SideEvents:
    """What the mixture of a side is fitted to."""

    label: str  # ``"left"`` or ``"right"``
    inside: InsideBounds  # the parameters that vary, none on a bound
    box: Box  # of all eight parameters

    @property
    def side(self) -> int:
        """`LEFT` or `RIGHT`."""
        return LEFT if self.label == "left" else RIGHT

    @property
    def events(self) -> Events:
        """Rows of the parameters that vary, with their weights if any."""
        return self.inside.events

    @property
    def rows(self) -> int:
        """Departures, each counted once whatever its weight."""
        return self.inside.profile.rows

    @property
    def weight(self) -> float | None:
        """Sum of the weights, if there are any."""
        return None if self.events.weight is None else self.inside.profile.events

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters that vary."""
        return tuple(PARAMETER_NAMES[j] for j in np.flatnonzero(self.inside.varies))

    @property
    def constants(self) -> tuple[tuple[str, float], ...]:
        """The others with their value."""
        least = self.inside.profile.least
        return tuple((PARAMETER_NAMES[j], float(least[j])) for j in np.flatnonzero(~self.inside.varies))

    @property
    def moved(self) -> tuple[tuple[str, int], ...]:
        """Events that lay on a bound, per parameter."""
        moved = self.inside.moved
        return tuple((PARAMETER_NAMES[j], int(moved[j])) for j in np.flatnonzero(moved))


def side_events(events: Events, label: str, settings: SideSettings) -> SideEvents:
    """Look at the departures of a side (columns as `PARAMETER_NAMES`), and put those on a bound inside."""
    x = events.x
    for j in range(x.shape[1]):
        _check(x, j, np.isfinite(x[:, j]), "finite numbers", label)
    box = settings.box
    for j, (low, high) in enumerate(zip(box.lower, box.upper, strict=True)):
        _check(x, j, (x[:, j] >= low) & (x[:, j] <= high), f"{low:g} to {high:g}", label)
    for name in ("T", "v_mean"):  # as in a departures table
        j = PARAMETER_NAMES.index(name)
        _check(x, j, x[:, j] > 0.0, "above 0", label)
    check_transform(settings.transform, box.lower, box.upper)
    with np.errstate(over="ignore", invalid="ignore"):
        profile = profile_of(events)
    inside = inside_bounds(events, box.lower, box.upper, PARAMETER_NAMES, profile=profile)
    if not inside.varies.any():
        raise InputError(
            f"departures ({label})", f"all {profile.rows} events are equal", hint="there is nothing to fit"
        )
    return SideEvents(label, inside, box)


def _check(x: FloatArray, j: int, good: BoolArray, allowed: str, label: str) -> None:
    """Refuse a column with a bad value: the first of them and how many there are."""
    if not good.all():
        event = int(np.argmin(good))
        raise InputError(
            f"departures ({label})",
            f"{PARAMETER_NAMES[j]} = {float(x[event, j])!r} in event {event}",
            allowed=f"{allowed} ({int((~good).sum())} of {good.size} events)",
        )
