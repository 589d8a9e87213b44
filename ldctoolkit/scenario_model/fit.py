"""Fit of a scenario model to departures, and its settings."""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
from collections.abc import Iterable, Mapping
from typing import Any, Final, Literal, Self, get_args

import numpy as np
import numpy.typing as npt
import threadpoolctl

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.clusters import Clusters
from ldctoolkit.declared import checked_choice, checked_seed, checked_whole
from ldctoolkit.departures import (
    LEFT,
    PARAMETER_NAMES,
    RIGHT,
    SIDES,
    DepartureParameters,
    Departures,
    Plausibility,
    check_parameters,
)
from ldctoolkit.errors import InputError, ModelError, plain
from ldctoolkit.mixture import BoundedGaussianMixture, Selection, select_components
from ldctoolkit.mixture._distribution import Transform
from ldctoolkit.mixture.checks import Events, check_components, check_weights, inside_bounds
from ldctoolkit.mixture.selection import ALLOWANCE, FitEach, Progress, choose
from ldctoolkit.recordings import Criteria
from ldctoolkit.scenario_model.fidelity import Replay, SideFidelity
from ldctoolkit.scenario_model.model import ScenarioModel
from ldctoolkit.scenario_model.provenance import (
    LEAST_LOWER,
    MOST_RECORDED,
    PHYSICAL_BOUNDS,
    FitSettings,
    ModelProvenance,
    RecordedDepartures,
    SideModel,
    SideSummary,
    check_usable,
    driven,
    software_versions,
    summarize_events,
)
from ldctoolkit.scenario_model.refit import BANDWIDTHS, effective_number, smoothed
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
    upper: FloatArray  # (8,)
    origins: tuple[tuple[str, str, str], ...]  # parameter, and where its lower and its upper end come from


def box_of(bounds: Bounds | None, criteria: Criteria | None) -> Box:
    """The box from given bounds, and otherwise from the extraction criteria and from physics."""
    ends = {name: (*pair, "physical", "physical") for name, pair in PHYSICAL_BOUNDS.items()}
    if criteria is not None:  # an event outside them would not have been extracted
        origin = "extraction criteria"
        ends["T"] = (criteria.min_duration, criteria.max_duration, origin, origin)
        ends["v_mean"] = (criteria.min_speed, np.inf, origin, "physical")
    if bounds is not None and not isinstance(bounds, Mapping):
        raise InputError("bounds", value=bounds, allowed="a mapping of parameters")
    check_parameters("bounds", bounds or ())
    for name, entry in (bounds or {}).items():
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
    box: Box
    transform: dict[str, str]  # of each parameter: ``"none"``, ``"log"``, ``"logit"`` or ``"auto"``
    seed: int  # of the fits
    selection: dict[str, Any]  # other arguments of `select_components`
    kind: Kind  # what the departures are generated from
    plausibility: Plausibility
    vehicle_width: float | None  # [m] of the recordings


def transforms(transform: str | Mapping[str, str] | None, box: Box) -> dict[str, str]:
    """The transform of each parameter, allowed by its bounds."""
    if not isinstance(transform, str | Mapping | None):
        raise InputError("transform", value=transform, allowed="one word, or a mapping of parameters")
    words: Any = transform
    if isinstance(transform, Mapping):
        check_parameters("transform", transform)
        words = [transform.get(name, "none") for name in PARAMETER_NAMES]
    kinds = Transform.of(words, box.lower, box.upper, PARAMETER_NAMES).kinds
    return dict(zip(PARAMETER_NAMES, kinds, strict=True))


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
    prior_strength: float = 10.0,
    tol: float = 1e-7,
    n_init: int | None = None,
    max_iter: int = 500,
    workers: int | None = None,
    fit_each: FitEach | None = None,
    verbose: bool = False,
    source_provenance: Mapping[str, Any] | str = "",
    synthetic: bool = False,
    progress: Progress | None = None,
) -> ScenarioModel:
    """Fit a scenario model to departures: one mixture a side, the number of components K chosen by BIC.

    Parameters
    ----------
    departures : Departures
        Those of both sides.
    components : int or iterable of int, optional
        K, or the K to choose from: 1 to 10, or 1 to 4 with up to 2,000 departures on a side. A range is cut where the
        events no longer carry it (half an event a free parameter). One K is fitted as requested.
    kind : {"auto", "mixture", "smoothed"}
        What departures are generated from. ``"mixture"`` is the bounded Gaussian mixture; with up to 2,000 departures
        on a side, the smallest K that is no smaller than that of `select_components` and gives the recordings' answer
        (see `check_fidelity`). ``"smoothed"`` are the departures themselves, resampled with a kernel: a component each.
        ``"auto"`` takes those where no such mixture gives the answer; one K as requested stays.
    seed : int
        Seed of fits to more than 2,000 departures. With fewer, neither the model nor its check depends on it.
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
    prior_strength, tol, max_iter
        Of each fit, see `BoundedGaussianMixture`.
    n_init : int, optional
        Starts of each fit; 8 by default, 2 with up to 2,000 departures.
    workers : int, optional
        Cores to use, all by default. It changes no number.
    fit_each : callable, optional
        What runs the fits of several K, `map` by default: see `select_components`.
    verbose : bool
        Report every start and pass on stderr.
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
    seed = checked_seed(seed)
    if seed >= _SEED_END:
        raise InputError("seed", value=seed, allowed="below 10^18, the longest whole number of a model file")
    checked_choice("kind", kind, get_args(Kind))
    workers = None if workers is None else checked_whole("workers", workers, lower=1)
    K = plain(components)
    if K is not None:
        K = check_components([K])[0] if isinstance(K, int) else tuple(check_components(K))
    starts = n_init if n_init is not None else 8 if departures.n > FEW else 2
    fit = FitSettings(*map(plain, (prior_strength, tol, starts, max_iter)))
    limits = plausibility or (Plausibility() if extraction is None else extraction.plausibility)
    box = box_of(bounds, extraction)
    settings = SideSettings(
        components=K,
        box=box,
        transform=transforms(transform, box),
        seed=seed,
        selection={**dataclasses.asdict(fit), "n_jobs": workers, "fit_each": fit_each, "verbose": int(verbose)},
        kind=kind,
        plausibility=limits,
        vehicle_width=None if extraction is None else extraction.vehicle_width,
    )
    events, recorded = _events(departures, weights, settings)
    carried = {label: carried_components(settings.components, side) for label, side in events.items()}
    with threadpoolctl.threadpool_limits(1, "blas"):  # small matrices: more threads only wait for each other
        sides = {label: fit_side(side, *carried[label], settings, progress) for label, side in events.items()}
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
        seed=seed,
        warnings=tuple(note for *_, notes in sides.values() for note in notes),
        versions=software_versions(),
        settings=fit,
        **driven(source),
        recorded=recorded,
    )
    model = ScenarioModel(sides["left"][0], sides["right"][0], provenance, limits)
    summaries: dict[str, Any] = {
        label: dataclasses.replace(sides[label][1], redrawn_share=model.redrawn_share(side))
        for label, side in SIDES.items()
    }
    return dataclasses.replace(model, provenance=dataclasses.replace(provenance, **summaries))


def _events(
    departures: Departures, weights: npt.ArrayLike | None, settings: SideSettings
) -> tuple[dict[str, SideEvents], RecordedDepartures | None]:
    """The departures of each side, ready for the fit, and what a model keeps of them."""
    weight = None if weights is None else check_weights(weights, departures.n, "weights", "departure")
    with np.errstate(all="ignore"):  # what is not finite is refused later
        counts = settings.plausibility.holds(departures) | ~np.isfinite(departures.matrix()).all(axis=1)
    implausible = int((~counts).sum())
    counts &= True if weight is None else weight > 0.0
    order = canonical_order(departures, weight)
    rows = {label: order[(counts & (departures.side == side))[order]] for label, side in SIDES.items()}
    beside = f", beside {implausible} that are not plausible" if implausible else ""
    check_enough(rows["left"].size, rows["right"].size, beside)
    events = Events(departures.matrix(), weight, settings.selection["n_jobs"])
    by_side = {label: Clusters.of(departures.take(chosen)) for label, chosen in rows.items()}
    sides = {label: side_events(events, rows[label], by_side[label], label, settings) for label in rows}
    if max(side.data.rows for side in sides.values()) > MOST_RECORDED:
        return sides, None
    order = np.concatenate(list(rows.values()))
    columns = np.concatenate([side.departures.matrix() for side in sides.values()]).T.tolist()
    clusters = Clusters.of(departures).take(order)
    recorded = RecordedDepartures(
        tuple(departures.side[order].tolist()),
        dict(zip(PARAMETER_NAMES, map(tuple, columns), strict=True)),
        (1.0,) * order.size if weight is None else tuple(weight[order].tolist()),
        tuple(clusters.index.tolist()),
        *(clusters.kind, clusters.trips, clusters.drivers, clusters.largest_trip),
    )
    return sides, recorded


def canonical_order(departures: DepartureParameters, weight: FloatArray | None) -> IntArray:
    """Departures in an order of their values: that of the rows of a table changes no bit of what is made of them."""
    recording = getattr(departures, "recording", departures.side)  # of equal departures
    keys = (recording, departures.side if weight is None else weight, *departures.matrix().T)
    return np.lexsort(keys).astype(np.int64)


def check_enough(left: int, right: int, beside: str = "") -> None:
    """Refuse fewer than 30 departures on a side."""
    if min(left, right) < LEAST_EVENTS:
        problem = f"{left} left and {right} right{beside}"
        raise InputError("departures", problem, allowed=f"at least {LEAST_EVENTS} a side")


EVENTS_PER_PARAMETER: Final = 0.5  # a range of K is cut where fewer would stand behind each free parameter

_SETTINGS: Final = {field.name for field in dataclasses.fields(FitSettings)}  # not of the departures


def fit_side(
    events: SideEvents, tried: tuple[int, ...], cut: tuple[str, ...], settings: SideSettings, progress: Progress | None
) -> tuple[SideModel, SideSummary, tuple[str, ...]]:
    """Fit the departures of one side, with the K that they carry; `cut` says which they do not.

    Gives the model, how it was fitted, and what a user should know.
    """
    label, n = events.label, events.data.rows
    notes = [
        f"{label}: {name} is {value:g} in every event and is kept as a constant" for name, value in events.constants
    ]
    notes += [
        f"{label}: {count} events had {name} exactly on a bound, moved just inside" for name, count in events.moved
    ]
    notes += cut
    judge = _Judge.of(events, settings)
    selection, failed = _select(events, tried[:1] if settings.kind == "smoothed" else tried, settings, progress, judge)
    choice = judge.choice(selection)
    unmapped = set(settings.transform.values()) == {"none"}
    if settings.kind == "auto" and len(tried) > 1 and n > FEW and unmapped and not choice.passed:
        mapped = dataclasses.replace(settings, transform=dict.fromkeys(PARAMETER_NAMES, "auto"))
        mapped_selection, mapped_failed = _select(events, tried, mapped, progress, judge)
        mapped_choice = judge.choice(mapped_selection)
        if mapped_choice.merit > choice.merit:
            selection, failed = mapped_selection, mapped_failed
            text = "of mapped parameters: without maps the mixture does not agree with the recordings"
            choice = dataclasses.replace(mapped_choice, reason=f"{selection.reason}, {text}")
    mixture = choice.mixture
    notes += [f"{label}: K = {K} could not be fitted ({message})" for K, message in failed]
    if choice.kind == "mixture":
        notes += [f"{label}: {sentence}" for sentence in mixture.warnings_]
    if choice.fidelity is not None and not choice.fidelity.passed:
        notes.append(f"{label}: {choice.fidelity.text}")
    why = "as requested" if isinstance(settings.components, int) else "the only one of the range that the events carry"
    summary = SideSummary(
        events=n,
        n_components=tuple(selection.n_components.tolist()),
        bic=tuple(selection.bic.tolist()),
        log_likelihood=tuple(selection.log_likelihood.tolist()),
        converged=choice.kind == "smoothed" or mixture.converged_,
        moved_inside=events.moved,
        redrawn_share=0.0,
        n_parameters=tuple(selection.n_parameters.tolist()),
        reason=choice.reason or (selection.reason if len(tried) > 1 else f"K = {tried[0]}, {why}"),
        failed=failed,
        passes=mixture.n_iter_ if choice.kind == "mixture" else None,
        stop_reason=mixture.stop_reason_ if choice.kind == "mixture" else "",
        weight=events.weight,
        bounds_from=settings.box.origins,
        source_summary=summarize_events(events.data, events.names),
        kind=choice.kind,
        fidelity=choice.fidelity,
        held_out=judge.held_out(choice),
    )
    return SideModel(mixture, events.names, events.constants), summary, tuple(notes)


_ENOUGH: Final = 0.93  # share of answers within their own 95 % intervals to be chosen: the verdict's are wider


@dataclasses.dataclass(frozen=True)
class _Checked:
    """What departures are generated from, and how it compares with the recorded ones."""

    mixture: BoundedGaussianMixture
    kind: Literal["mixture", "smoothed"]
    fidelity: SideFidelity | None  # None where hardly any departure can be drawn or driven
    alone: float  # share of the answers within intervals that hold for each by itself
    width: float = 0.0  # of the kernel of smoothed departures, see `BANDWIDTHS`
    reason: str = ""  # why not the mixture that BIC chose

    @property
    def passed(self) -> bool:
        """Whether it gives the recordings' answer."""
        return self.fidelity is not None and self.fidelity.passed

    @property
    def agrees(self) -> bool:
        """Whether it agrees well enough for designs beyond the tested ones, on few departures."""
        return self.passed and self.alone >= _ENOUGH

    @property
    def merit(self) -> tuple[float, float]:
        """Share of the answers within their intervals, simultaneous and for each by itself; larger is better."""
        return (0.0 if self.fidelity is None else float(self.fidelity.within.mean())), self.alone

    def order(self) -> tuple[bool, float, float]:
        """Sorting key: the largest is preferred."""
        return (self.agrees, *self.merit)


@dataclasses.dataclass(frozen=True)
class _Judge:
    """Compares what the departures of a side could be generated from with the recorded ones."""

    events: SideEvents
    settings: SideSettings
    replay: Replay
    results: dict[BoundedGaussianMixture, _Checked] = dataclasses.field(default_factory=dict)

    @classmethod
    def of(cls, events: SideEvents, settings: SideSettings) -> Self:
        """The judge of a side, with the answer of its recorded departures."""
        replay = Replay.of(events.departures, events.clusters, events.data.weight, settings.vehicle_width)
        return cls(events, settings, replay)

    def checked(self, mixture: BoundedGaussianMixture, width: float = 0.0) -> _Checked:
        """A mixture beside the recorded departures; each is driven once."""
        if mixture not in self.results:
            compared: tuple[SideFidelity | None, float] = None, 0.0
            with contextlib.suppress(InputError, ModelError):
                compared = self.replay.compared(self._drawn(mixture, self.replay.generated))
            self.results[mixture] = _Checked(mixture, "smoothed" if width else "mixture", *compared, width)
        return self.results[mixture]

    def _drawn(self, mixture: BoundedGaussianMixture, count: int) -> DepartureParameters:
        """Departures of a mixture from the same random numbers for all, so that chance does not choose."""
        check_usable(mixture)
        side = SideModel(mixture, self.events.names, self.events.constants)
        model = ScenarioModel(side, side, ModelProvenance({}), self.settings.plausibility)
        return model.sample(*((count, 0) if self.events.label == "left" else (0, count)))

    def supported(self, mixture: BoundedGaussianMixture) -> bool:
        """Whether enough departures stand behind each of its components."""
        return float(mixture.weights_.min()) * effective_number(self.events.data) >= LEAST_IN_COMPONENT

    def held_out(self, choice: _Checked) -> tuple[SideFidelity, ...]:
        """Models of this kind and K of a random half of the clusters, beside the replay of the other; both ways."""
        events, clusters, out = self.events, self.events.clusters, []
        if events.data.rows > FEW or clusters.count < 4:
            return ()
        order = np.random.default_rng(0).permutation(clusters.count)  # a seed of the user would choose the verdict
        reached = np.cumsum(np.bincount(clusters.index)[order])[1:-2]  # two clusters at least in each
        first = np.isin(clusters.index, order[: 2 + int(np.abs(reached - 0.5 * events.data.rows).argmin())])
        quick = {"n_init": 1, "short_iter": 5, "tol": max(self.settings.selection["tol"], _ROUGH)}
        settings = dataclasses.replace(self.settings, selection=self.settings.selection | quick)
        with contextlib.suppress(InputError, ModelError):  # too few for this K
            for half in (first, ~first):
                part = dataclasses.replace(events, data=events.data.take(half))
                if choice.kind == "smoothed":
                    mixture = smoothed(part.data, part.lower, part.upper, part.names, choice.width)
                else:
                    mixture = _select(part, (choice.mixture.n_components,), settings, None, self)[0].best
                out.append(self.replay.held_out(half, self._drawn(mixture, max(5 * int(half.sum()), 500))))
        return tuple(out)

    def enough(self, fits: Selection) -> bool:
        """Whether larger K need not be tried: BIC has risen, or the last two give the recordings' answer."""
        return fits.risen or (
            len(fits.models) > 1 and all(self.supported(fit) and self.checked(fit).agrees for fit in fits.models[-2:])
        )

    def choice(self, fits: Selection) -> _Checked:
        """The first that gives the recordings' answer: the K of BIC, larger ones, the smoothed departures."""
        rows, kind = self.events.data.rows, self.settings.kind
        if kind == "smoothed":
            if rows > MOST_SMOOTHED:
                problem = f"with {rows} {self.events.label} departures"
                raise InputError("kind", problem, value=kind, allowed=f"up to {MOST_SMOOTHED}")
            smooth = self._smoothed()
            return dataclasses.replace(smooth, reason=f"{smooth.reason}, as requested")
        if isinstance(self.settings.components, int):
            return self.checked(fits.best)
        whole, fits = fits, self._supported(fits)
        first = best = self.checked(fits.best)
        last = fits.chosen
        while rows <= FEW and not best.agrees and last + 1 < len(fits.models):
            last += 1
            best = max(best, self.checked(fits.models[last]), key=_Checked.order)
        K, most = (int(fits.n_components[i]) for i in (fits.chosen, last))
        if kind == "auto" and rows <= MOST_SMOOTHED and not best.agrees:
            smooth = self._smoothed()
            if smooth.merit > best.merit:
                tried = f"K = {K}" if most == K else f"K = {K} to {most}"
                return dataclasses.replace(smooth, reason=f"{smooth.reason}: no mixture with {tried} agrees with them")
        if best is not first:
            text = f"K = {best.mixture.n_components}, which agrees with the recordings better than K = {K}"
            best = dataclasses.replace(best, reason=f"{text} ({fits.reason})")
        elif fits is not whole:
            best = dataclasses.replace(best, reason=fits.reason)
        return best

    def _supported(self, fits: Selection) -> Selection:
        """The fits without those that have a component of hardly any departures, unless all have one."""
        keep = [i for i, fit in enumerate(fits.models) if self.supported(fit)]
        if len(keep) in (0, len(fits.models)):
            return fits
        K, bic = fits.n_components[keep], fits.bic[keep]
        chosen, dropped = choose(bic), ", ".join(map(str, np.setdiff1d(fits.n_components, K)))
        rule = f"the smallest whose BIC lies within {ALLOWANCE:g} of the best"
        left_out = f"K = {dropped} left out: a component of fewer than {LEAST_IN_COMPONENT} departures"
        reason = f"K = {K[chosen]}, {rule}; {left_out}"
        models = tuple(fits.models[i] for i in keep)
        return dataclasses.replace(fits, n_components=K, bic=bic, models=models, chosen=chosen, reason=reason)

    def _smoothed(self) -> _Checked:
        """The smoothed departures: the widest kernel that agrees with them, else the best one."""
        checked: list[_Checked] = []
        side = self.events
        for width in BANDWIDTHS:
            checked.append(self.checked(smoothed(side.data, side.lower, side.upper, side.names, width), width))
            if checked[-1].agrees:
                break
        text = f"smoothed departures, near copies of the {self.events.data.rows:,} recorded ones"
        return dataclasses.replace(max(checked, key=_Checked.order), reason=text)


_ROUGH: Final = 1e-3  # nats an event and pass, of fits that are compared and not kept

LEAST_IN_COMPONENT: Final = 10
"""Effective departures that a component rests on at least."""


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
        The recorded ones of both sides; those that the model holds impossible are left out.
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
    order = canonical_order(departures, weight)
    left, right = (order[(possible & (departures.side == side))[order]] for side in (LEFT, RIGHT))
    check_enough(left.size, right.size)
    criteria = model.provenance.source.get("criteria")
    width = criteria.get("vehicle_width") if isinstance(criteria, Mapping) else None

    verdicts = []
    for side, rows in ((LEFT, left), (RIGHT, right)):
        recorded = departures.take(rows)
        replay = Replay.of(recorded, Clusters.of(recorded), None if weight is None else weight[rows], width)
        n = replay.generated
        verdicts.append(replay.compared(model.sample(n, 0) if side == LEFT else model.sample(0, n))[0])
    return verdicts[0], verdicts[1]


def carried_components(
    components: int | tuple[int, ...] | None, events: SideEvents
) -> tuple[tuple[int, ...], tuple[str, ...]]:
    """The K that the events of a side carry, and a note if these are not all."""
    n, d, label = events.data.rows, len(events.names), events.label
    if isinstance(components, int):
        return (components,), ()
    components = components or tuple(range(1, 5 if n <= FEW else 11))
    most = max(1, int(n / (EVENTS_PER_PARAMETER * (1 + d + d * (d + 1) // 2))))
    tried = tuple(K for K in components if most >= K)
    if not tried:
        allowed = f"a range that begins at {most} or below, {n} {label} departures carry no more"
        raise InputError("components", "and more", value=components[0], allowed=allowed)
    if len(tried) == len(components):
        return tried, ()
    return tried, (f"{label}: {n} events carry no more than K = {most}; larger K were not tried",)


def _select(
    events: SideEvents, tried: tuple[int, ...], settings: SideSettings, progress: Progress | None, judge: _Judge
) -> tuple[Selection, tuple[tuple[int, str], ...]]:
    """The fits, and the K that gave no usable one; an error where none did."""
    label, data = events.label, events.data
    arguments: dict[str, Any] = settings.selection | {
        "random_state": 0 if data.rows <= FEW else settings.seed,  # which would choose among local optima
        "split_merge": data.rows > FEW,
        "progress": None if progress is None else lambda text, done, total: progress(f"{label}: {text}", done, total),
        "sample_weight": data.weight,
        "lower": events.lower,
        "upper": events.upper,
        "transform": [settings.transform[name] for name in events.names],
        "names": events.names,
        "enough": judge.enough if data.rows <= FEW else None,
    }
    failed: list[tuple[int, str]] = []
    while True:
        try:
            selection = select_components(data.x, tried, **arguments)
        except InputError as error:
            raise error if error.path in _SETTINGS else error.within(f"departures ({label})", ": ") from None
        failed += [(failure.n_components, str(failure.error)) for failure in selection.failures]
        best_K = selection.best.n_components
        try:
            check_usable(selection.best)
        except ModelError as error:
            tried = tuple(K for K in selection.n_components.tolist() if best_K != K)
            if not tried:
                raise error.within(f"departures ({label})", ": ") from None
            failed.append((best_K, str(error)))
        else:
            return selection, tuple(sorted(failed))


@dataclasses.dataclass(frozen=True)
class SideEvents:
    """What the mixture of a side is fitted to: the parameters that vary, with no value on a bound."""

    label: str  # ``"left"`` or ``"right"``
    data: Events  # A row a departure, a column for each of `names`
    clusters: Clusters  # Of the departures
    names: tuple[str, ...]  # Parameters that vary
    lower: FloatArray  # (d,) Bounds of `names`
    upper: FloatArray  # (d,)
    constants: tuple[tuple[str, float], ...]  # The other parameters with their value
    moved: tuple[tuple[str, int], ...]  # Events that lay on a bound, per parameter
    weight: float | None  # Sum of the weights, if there are any

    @property
    def departures(self) -> DepartureParameters:
        """All eight parameters, and the side."""
        columns = {name: np.full(self.data.rows, value) for name, value in self.constants}
        columns |= dict(zip(self.names, self.data.x.T, strict=True))
        return DepartureParameters(np.full(self.data.rows, SIDES[self.label]), **columns)


def side_events(events: Events, rows: IntArray, clusters: Clusters, label: str, settings: SideSettings) -> SideEvents:
    """Check the departures of a side, rows of all (columns as `PARAMETER_NAMES`), and put those on a bound inside."""
    events, box = events.take(rows), settings.box
    x = events.x
    for j in range(x.shape[1]):
        _check(x, rows, j, np.isfinite(x[:, j]), "finite numbers", label)
    for j, (name, low, high) in enumerate(zip(PARAMETER_NAMES, box.lower, box.upper, strict=True)):
        _check(x, rows, j, (x[:, j] >= low) & (x[:, j] <= high), f"{low:g} to {high:g}", label)
        if name in ("T", "v_mean"):  # as in a departures table
            _check(x, rows, j, x[:, j] > 0.0, "above 0", label)
    inside = inside_bounds(events, box.lower, box.upper, PARAMETER_NAMES)
    varies, least, moved = inside.varies, inside.profile.least, inside.moved
    if not varies.any():
        problem = f"all {events.rows} events are equal"
        raise InputError(f"departures ({label})", problem, hint="there is nothing to fit")
    return SideEvents(
        label,
        inside.events,
        clusters,
        tuple(PARAMETER_NAMES[j] for j in np.flatnonzero(varies)),
        box.lower[varies],
        box.upper[varies],
        tuple((PARAMETER_NAMES[j], float(least[j])) for j in np.flatnonzero(~varies)),
        tuple((PARAMETER_NAMES[j], int(moved[j])) for j in np.flatnonzero(moved)),
        None if events.weight is None else inside.profile.events,
    )


def _check(x: FloatArray, rows: IntArray, j: int, good: BoolArray, allowed: str, label: str) -> None:
    """Refuse a column with a bad value: the first one of the table and how many there are."""
    if not good.all():
        first = int(np.argmin(np.where(good, rows.max() + 1, rows)))
        raise InputError(
            f"departures ({label}): {PARAMETER_NAMES[j]}",
            f"in departure {rows[first]} ({int((~good).sum())} of {good.size} departures)",
            value=float(x[first, j]),
            allowed=allowed,
        )
