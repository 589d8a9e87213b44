"""Fit of a scenario model to departures, and its settings."""

from __future__ import annotations

import dataclasses
import datetime
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import BoolArray, FloatArray
from ldctoolkit.departures import LEFT, PARAMETER_NAMES, RIGHT, Departures
from ldctoolkit.errors import InputError, ModelError, nearest
from ldctoolkit.mixture import Selection, select_components
from ldctoolkit.mixture.bounds import auto_bounds
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
from ldctoolkit.scenario_model.model import ScenarioModel
from ldctoolkit.scenario_model.provenance import (
    LEAST_LOWER,
    PHYSICAL_BOUNDS,
    FitSettings,
    ModelProvenance,
    SideModel,
    SideSummary,
    check_usable,
    software_versions,
    summarize_events,
)
from ldctoolkit.version import __version__

End = float | None | Literal["auto"]
Bounds = Literal["auto", "physical"] | Mapping[str, tuple[End, End] | Literal["auto", "physical"]]
"""For all parameters one word, or per parameter a word or (lower, upper); None is open."""

GIVEN: Final = "given"
CRITERIA: Final = "extraction criteria"
PHYSICAL: Final = "physical"
AUTO: Final = "auto"


@dataclasses.dataclass(frozen=True)
class _End:
    """One wanted end: a value, or with `auto` the furthest that what the data show may reach."""

    value: float
    origin: str
    auto: bool = False


WantedBounds = Mapping[str, tuple[_End, _End]]


@dataclasses.dataclass(frozen=True)
class Box:
    """The box of one side."""

    lower: FloatArray  # (8,): in the order of `PARAMETER_NAMES`
    upper: FloatArray  # (8,): in the order of `PARAMETER_NAMES`
    origins: tuple[tuple[str, str, str], ...]  # (str, str, str)


def wanted_bounds(bounds: Bounds | None, criteria: Criteria | None) -> WantedBounds:
    """The bounds of each parameter, those of "auto" still to be found in the data."""
    known = _physical(criteria)
    if bounds is None or isinstance(bounds, str):
        per_name: Mapping[str, Any] = {} if bounds is None else dict.fromkeys(PARAMETER_NAMES, _word("bounds", bounds))
    elif isinstance(bounds, Mapping):
        per_name = bounds
    else:
        raise InputError(f"bounds: {bounds!r}; allowed: 'auto', 'physical', or a mapping of parameters")
    out = dict(known)
    for name, entry in per_name.items():
        if name not in known:
            raise InputError(f"bounds: no parameter {name!r}; {nearest(str(name), PARAMETER_NAMES)}")
        out[name] = _wanted(name, entry, known[name])
    return out


def _word(where: str, word: str) -> str:
    if word not in (AUTO, PHYSICAL):
        raise InputError(f"{where}: {word!r}; {nearest(word, (AUTO, PHYSICAL))}")
    return word


def _physical(criteria: Criteria | None) -> dict[str, tuple[_End, _End]]:
    out = {name: (_End(low, PHYSICAL), _End(high, PHYSICAL)) for name, (low, high) in PHYSICAL_BOUNDS.items()}
    if criteria is not None:  # no event outside them could have been found
        out["T"] = (_End(criteria.min_duration, CRITERIA), _End(criteria.max_duration, CRITERIA))
        out["v_mean"] = (_End(criteria.min_speed, CRITERIA), _End(np.inf, PHYSICAL))
    return out


def _furthest(name: str, known: tuple[_End, _End]) -> tuple[_End, _End]:
    """How far bounds that are read off the data may reach: what was not found, or cannot be driven, is outside."""
    low, high = known
    if low.origin != CRITERIA:
        low = _End(LEAST_LOWER.get(name, -np.inf), PHYSICAL)
    if high.origin != CRITERIA:
        high = _End(np.inf, PHYSICAL)
    return dataclasses.replace(low, auto=True), dataclasses.replace(high, auto=True)


def _wanted(name: str, entry: Any, known: tuple[_End, _End]) -> tuple[_End, _End]:
    where = f"bounds[{name!r}]"
    if isinstance(entry, str):
        return _furthest(name, known) if _word(where, entry) == AUTO else known
    ends: list[_End] = []
    try:
        given = tuple(entry)
        for value, fill, limit in zip(given, (-np.inf, np.inf), _furthest(name, known), strict=True):
            if isinstance(value, str) and value == AUTO:
                ends.append(limit)
            else:
                ends.append(_End(fill if value is None else float(value), GIVEN))
    except (TypeError, ValueError):
        raise InputError(f"{where}: {entry!r}; allowed: 'auto', 'physical' or (lower, upper)") from None
    least = LEAST_LOWER.get(name, -np.inf)
    if given[0] is None and least > -np.inf:
        ends[0] = _End(least, PHYSICAL)  # open as far as can be driven
    if not (ends[0].value < ends[1].value and ends[0].value >= least):
        raise InputError(f"{where}: {entry!r}; allowed: {least:g} <= lower < upper")
    return ends[0], ends[1]


def box_of(wanted: WantedBounds, x: FloatArray) -> Box:
    """The box for the events x (n, 8) of one side."""
    lower, upper = np.empty(len(PARAMETER_NAMES)), np.empty(len(PARAMETER_NAMES))
    origins = []
    for j, name in enumerate(PARAMETER_NAMES):
        low, high = wanted[name]
        found = auto_bounds(x[:, [j]]) if low.auto or high.auto else (np.empty(1), np.empty(1))
        lower[j], low_from = _decided(low, float(found[0][0]), 1.0)
        upper[j], high_from = _decided(high, float(found[1][0]), -1.0)
        origins.append((name, low_from, high_from))
    return Box(lower, upper, tuple(origins))


def _decided(end: _End, found: float, inwards: float) -> tuple[float, str]:
    """The value of an end, and where it comes from."""
    if not end.auto:
        return end.value, end.origin
    further_in = inwards * found >= inwards * end.value
    return (found, AUTO) if further_in else (end.value, end.origin)


TRANSFORMS: Final = ("none", "log", "logit", "auto")


@dataclasses.dataclass(frozen=True)
class SideSettings:
    """How each side is fitted."""

    components: int | tuple[int, ...]  # K, or the K to choose from in ascending order
    seed: int  # of the fits
    bounds: WantedBounds  # of each parameter
    transform: dict[str, str]  # of each parameter: ``"none"``, ``"log"``, ``"logit"`` or ``"auto"``
    fit: FitSettings  # choice of K, prior, tolerance, starts
    workers: int | None  # cores; all by default
    verbose: bool  # report every start and pass on stderr

    def selection(self) -> dict[str, Any]:
        """Arguments of `select_components` but for the events and the box."""
        return dataclasses.asdict(self.fit) | {
            "random_state": self.seed,
            "n_jobs": self.workers,
            "verbose": int(self.verbose),
        }


def fit_settings(*values: Any) -> FitSettings:
    """Settings in Python's own numbers, as a file needs them; the fits check them."""
    return FitSettings(*(value.item() if isinstance(value, np.generic) else value for value in values))


def component_numbers(components: int | Iterable[int]) -> int | tuple[int, ...]:
    """K, or the K to choose from, in ascending order."""
    if isinstance(components, int | np.integer):
        return check_components([components])[0]
    return tuple(check_components(components))


def transforms(transform: str | Mapping[str, str] | None) -> dict[str, str]:
    """The wanted transform of each parameter."""
    if transform is None or isinstance(transform, str):
        return dict.fromkeys(PARAMETER_NAMES, _transform("transform", transform or "none"))
    out = dict.fromkeys(PARAMETER_NAMES, "none")
    for name, kind in transform.items():
        if name not in out:
            raise InputError(f"transform: no parameter {name!r}; {nearest(str(name), PARAMETER_NAMES)}")
        out[name] = _transform(f"transform[{name!r}]", kind)
    return out


def _transform(where: str, kind: Any) -> str:
    if kind not in TRANSFORMS:
        raise InputError(f"{where}: {kind!r}; {nearest(str(kind), TRANSFORMS)}")
    return str(kind)


def check_transform(wanted: Mapping[str, str], lower: FloatArray, upper: FloatArray) -> None:
    """Refuse a map that the bounds (8,) do not allow, by the parameter's name."""
    for j, name in enumerate(PARAMETER_NAMES):
        finite = int(np.isfinite(lower[j])) + int(np.isfinite(upper[j]))
        needed = {"log": 1, "logit": 2}.get(wanted[name], finite)
        if finite != needed:
            allowed = "one finite bound" if needed == 1 else "two finite bounds"
            raise InputError(
                f"transform[{name!r}]: {wanted[name]!r} with the bounds {lower[j]:g} to {upper[j]:g}; allowed: with "
                f"{allowed}"
            )


LEAST_EVENTS: Final = 30  # departures a side needs

_SEED_END: Final = 10**18


def fit_scenario_model(
    departures: Departures,
    *,
    components: int | Iterable[int] = range(1, 11),
    seed: int = 0,
    bounds: Bounds | None = None,
    extraction: Criteria | None = None,
    weights: npt.ArrayLike | None = None,
    transform: str | Mapping[str, str] | None = None,
    criterion: Literal["bic", "aic", "icl", "held_out"] = "bic",
    slack: float | None = None,
    indifference: float = 0.0,
    prior_strength: float = 10.0,
    tol: float = 1e-7,
    n_init: int = 8,
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
    components : int or iterable of int
        K, or the K to choose from. A range is cut where the events no longer carry it (two events a free parameter).
        One K is fitted as requested.
    seed : int
        Seed of the fits.
    bounds : {"physical", "auto"} or mapping, optional
        Where the box ends. ``"physical"``, the default, are the criteria of the extraction if given and
        ``PHYSICAL_BOUNDS`` otherwise. ``"auto"`` reads the ends off the data (`ldctoolkit.mixture.bounds.auto_bounds`),
        never beyond the criteria of the extraction or what can be replayed. A mapping has parameter names as keys,
        and as values one of the words or (lower, upper) in SI units, either of them a number, None for open, or
        ``"auto"``; the other parameters keep the default.
    extraction : Criteria, optional
        The criteria that the departures were extracted with: no event outside them could have been found.
    weights : (n,), optional
        Events that each departure stands for; those of weight 0 are left out.
    transform : {"none", "log", "logit", "auto"} or mapping, optional
        Map of each parameter before the fit, as in `BoundedGaussianMixture`: one for all, or by name.
    criterion, slack, indifference
        How K is chosen, see `select_components`.
    prior_strength, tol, n_init, max_iter
        Of each fit, see `BoundedGaussianMixture`.
    workers : int, optional
        Cores to use, all by default. It changes no number.
    verbose : bool
        Tell of every start and pass on stderr.
    source_provenance : mapping or str
        JSON values that describe the data, kept in the model.
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
    >>> model = fit_scenario_model(departures, components=1, bounds={"d_y": (0, 1.5), "a_mean": "auto"})
    >>> model.provenance.left.reason
    'K = 1, as requested'
    """
    check_number("seed", seed, 0, integer=True)
    if seed >= _SEED_END:
        raise InputError(f"seed: {seed}; allowed: below 10^18, the longest whole number of a model file")
    settings = SideSettings(
        components=component_numbers(components),
        seed=int(seed),
        bounds=wanted_bounds(bounds, extraction),
        transform=transforms(transform),
        fit=fit_settings(criterion, slack, indifference, prior_strength, tol, n_init, max_iter),
        workers=workers,
        verbose=verbose,
    )
    events = _events(departures, weights, settings)
    carried = {label: carried_components(settings.components, side) for label, side in events.items()}
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
    )
    model = ScenarioModel(fits["left"].side, fits["right"].side, provenance)
    one, other = (
        dataclasses.replace(fits[label].summary, redrawn_share=model.redrawn_share(side))
        for label, side in (("left", LEFT), ("right", RIGHT))
    )
    return dataclasses.replace(model, provenance=dataclasses.replace(provenance, left=one, right=other))


def _events(departures: Departures, weights: npt.ArrayLike | None, settings: SideSettings) -> dict[str, SideEvents]:
    """The departures of each side, ready for the fit."""
    weight = None if weights is None else check_weights(weights, departures.n, "weights", "departure")
    counts = np.ones(departures.n, dtype=bool) if weight is None else weight > 0.0
    rows = {label: counts & (departures.side == side) for label, side in (("left", LEFT), ("right", RIGHT))}
    left, right = (int(mask.sum()) for mask in rows.values())
    if min(left, right) < LEAST_EVENTS:
        raise InputError(f"departures: {left} left and {right} right; allowed: at least {LEAST_EVENTS} a side")
    every = Events(departures.matrix(), weight, settings.workers)
    return {label: side_events(every.take(mask), label, settings) for label, mask in rows.items()}


Progress = Callable[[str, int, int], None]

EVENTS_PER_PARAMETER: Final = 2
"""A range of K is cut where fewer events than this would stand behind each free parameter."""

_SETTINGS: Final = ("criterion", "slack", "indifference", "prior_strength", "tol", "n_init", "max_iter", "n_jobs")
"""A complaint about one of these is none about the departures."""


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
    selection, failed = _select(events, tried, settings, progress)
    best = selection.best
    notes += [f"{label}: K = {K} could not be fitted ({message})" for K, message in failed]
    notes += [f"{label}: {sentence}" for sentence in best.warnings_]
    several = len(tried) > 1
    why = "as requested" if isinstance(settings.components, int) else "the only one of the range that the events carry"
    summary = SideSummary(
        events=n,
        n_components=tuple(int(K) for K in selection.n_components),
        bic=_curve(selection.bic),
        log_likelihood=_curve(selection.log_likelihood),
        converged=best.converged_,
        moved_inside=events.moved,
        redrawn_share=0.0,
        n_parameters=tuple(int(p) for p in selection.n_parameters),
        aic=_curve(selection.aic),
        icl=_curve(selection.icl),
        held_out=_curve(selection.held_out),
        criterion=selection.criterion if several else "",
        reason=selection.reason if several else f"K = {tried[0]}, {why}",
        failed=failed,
        passes=best.n_iter_,
        stop_reason=best.stop_reason_,
        weight=events.weight,
        bounds_from=events.box.origins,
        source_summary=summarize_events(events.events, events.names),
    )
    return SideFit(SideModel(best, events.names, events.constants), summary, tuple(notes))


def _curve(values: FloatArray) -> tuple[float, ...]:
    """A criterion of each K; empty where it was not computed."""
    return tuple(values.tolist()) if np.isfinite(values).all() else ()


def carried_components(
    components: int | tuple[int, ...], events: SideEvents
) -> tuple[tuple[int, ...], tuple[str, ...]]:
    """The K that the events of a side carry, and what to say if these are not all."""
    n, d, label = events.rows, len(events.names), events.label
    if isinstance(components, int):
        return (components,), ()
    most = max(1, n // (EVENTS_PER_PARAMETER * (1 + d + d * (d + 1) // 2)))
    tried = tuple(K for K in components if most >= K)
    if not tried:
        raise InputError(
            f"components: {components[0]} and more; allowed: a range that begins at {most} or below, "
            f"{n} {label} departures carry no more"
        )
    if len(tried) == len(components):
        return tried, ()
    return tried, (f"{label}: {n} events carry no more than K = {most}; larger K were not tried",)


def _select(
    events: SideEvents, tried: tuple[int, ...], settings: SideSettings, progress: Progress | None
) -> tuple[Selection, tuple[tuple[int, str], ...]]:
    """The fits, and the K that gave no usable one; an error where none did."""
    label, varies = events.label, events.inside.varies
    arguments: dict[str, Any] = settings.selection() | {
        "progress": None if progress is None else lambda text, done, total: progress(f"{label}: {text}", done, total),
        "sample_weight": events.events.weight,
        "lower": events.box.lower[varies],
        "upper": events.box.upper[varies],
        "transform": [settings.transform[name] for name in events.names],
        "names": events.names,
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
                raise ModelError(f"departures ({label}): {error}") from None
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
    box = box_of(settings.bounds, x)
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
        raise InputError(f"departures ({label}): all {profile.rows} events are equal; there is nothing to fit")
    return SideEvents(label, inside, box)


def _check(x: FloatArray, j: int, good: BoolArray, allowed: str, label: str) -> None:
    """Refuse a column with a bad value: the first of them and how many there are."""
    if not good.all():
        event = int(np.argmin(good))
        raise InputError(
            f"departures ({label}): {PARAMETER_NAMES[j]} = {float(x[event, j])!r} in event {event}; allowed: {allowed} "
            f"({int((~good).sum())} of {good.size} events)"
        )
