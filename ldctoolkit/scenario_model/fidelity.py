"""Whether generated departures give the answer of recorded ones: test designs are driven on both and compared.

The answer of the recordings is uncertain: how much follows from resampling them, whole trips or drivers where these are
known. A model that differs by more than that misleads whoever ranks designs on it, however well its density fits.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import ClassVar, Final, final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.clusters import Clusters, cluster_error, several, with_tails_of_t
from ldctoolkit.control import Controller, LinearLaw
from ldctoolkit.declared import gain
from ldctoolkit.departures import PARAMETER_NAMES, DepartureParameters
from ldctoolkit.metrics import needless
from ldctoolkit.scenarios import SPEED_CEILING, SPEED_FLOOR, Scenarios, slowest_speed
from ldctoolkit.setup import Setup
from ldctoolkit.simulation.loop import drive_many
from ldctoolkit.simulation.takeover import Takeover
from ldctoolkit.vehicle import Plant, VehicleParameters

QUANTITIES: Final = ("reduction", "trigger share", "needless", "added a_y p95", "depth p95")
UNITS: Final = ("", "", "", "m/s^2", "m")
TRIGGERS: Final = (0.05, 0.25, 0.5, 0.75)  # shares of the recorded departures that do not reach a trigger threshold
MOST_REPLAYED: Final = 5_000  # departures that are replayed, evenly spread rows
MOST_GENERATED, FEWEST_GENERATED = 10_000, 2_000
CONFIDENCE: Final = 0.95
# Of the intervals of each quantity, for all probes at once: the effect of control, which designs are ranked by, is
# tested by itself, the other four share the error
_LEVELS: Final = np.array([CONFIDENCE, *[1.0 - (1.0 - CONFIDENCE) / 4.0] * 4])

_NORMAL: Final = (1.96, 3.3)  # critical values of one answer, and of the 48 that share an error

_RESAMPLES: Final = 400
_WIDEST: Final = 1e6  # an interval in a file is finite
_TAIL: Final = 0.95
# a difference that no designer would act on: absolute in shares, relative otherwise
_NEGLIGIBLE: Final = np.array([0.03, 0.03, 0.03, 0.05, 0.05])
_ABSOLUTE: Final = np.array([True, True, True, False, False])
_LEAST, _MOST = np.array([-np.inf, 0.0, 0.0, 0.0, 0.0]), np.array([1.0, 1.0, 1.0, np.inf, np.inf])  # that there can be


@final
@dataclasses.dataclass(frozen=True)
class _Preview(Controller):
    """The paper's law at its own gains."""

    name: ClassVar[str] = "preview"
    title: ClassVar[str] = "Preview P"

    def prepare(self, plant: Plant) -> LinearLaw:
        return _law(plant, np.tile([-0.005, 0.0, -0.2, 0.0], (plant.n, 1)), heading=0.2)


@final
@dataclasses.dataclass(frozen=True)
class _Feedback(Controller):
    """Steady cornering, and an e_y that would decay with a damping of 0.8 if the vehicle followed at once."""

    name: ClassVar[str] = "feedback"
    title: ClassVar[str] = "Feedback"

    omega: float = gain(0.4, unit="rad/s", lower=0.1, upper=3.0, description="natural frequency")

    def prepare(self, plant: Plant) -> LinearLaw:
        delta = plant.steady_state().delta  # per unit of lane yaw rate, so delta/v per unit of lateral acceleration
        acceleration = np.array([self.omega**2, 1.6 * self.omega, 0.0, 0.0])
        return _law(plant, -(delta / plant.v)[:, None] * acceleration, yaw_rate=delta)


def _law(plant: Plant, F: FloatArray, *, heading: float = 0.0, yaw_rate: FloatArray | float = 0.0) -> LinearLaw:
    """All probes preview the lane now and in 2 s, so that one loop drives them."""
    G_yaw_rate, G_heading = np.zeros((2, plant.n, 2))
    G_yaw_rate[:, 0], G_heading[:, 1] = yaw_rate, heading
    return LinearLaw(F, np.array([0.0, 2.0]), G_yaw_rate, G_heading, np.zeros(plant.n))


PROBES: Final[tuple[Controller, ...]] = (_Preview(), _Feedback(), _Feedback(omega=1.0))
NAMES: Final = ("Preview P", "feedback 0.4 rad/s", "feedback 1 rad/s")


@dataclasses.dataclass(frozen=True)
class SideFidelity:
    """The answers of one side: rows are the probes, each at every threshold; columns are `QUANTITIES`."""

    departures: int  # Replayed
    thresholds: tuple[float, ...]  # [m] y_s
    replayed: tuple[tuple[float, ...], ...]
    # Intervals of the replayed answer, simultaneous over the probes, and no narrower than what matters
    low: tuple[tuple[float, ...], ...]
    high: tuple[tuple[float, ...], ...]
    generated: tuple[tuple[float, ...], ...]
    resampled: str = ""  # What the departures come from and what was resampled, see `Clusters.text`

    @property
    def within(self) -> BoolArray:
        """Which generated answers lie within their intervals, (designs, quantities)."""
        generated = np.array(self.generated)
        return np.asarray((generated >= np.array(self.low)) & (generated <= np.array(self.high)))

    @property
    def passed(self) -> bool:
        """Whether all generated answers lie within their intervals."""
        return bool(self.within.all())

    @property
    def designs(self) -> tuple[str, ...]:
        """Names of the rows: a probe and its threshold each."""
        return tuple(f"{name}, y_s = {y_s:.2f} m" for name in NAMES for y_s in self.thresholds)

    @property
    def counted(self) -> str:
        """How many answers agree, and with what; one phrase."""
        within = self.within
        return f"{within.sum()} of {within.size} answers agree with those of {self.resampled}"

    @property
    def unseen(self) -> str:
        """Which deviations the intervals cannot show, since they reach the end of what there can be; may be empty."""
        ends = (np.array(self.low) <= _LEAST, "too low"), (np.array(self.high) >= _MOST, "too high")
        counts = [(end.sum(axis=0)[j], name, word) for end, word in ends for j, name in enumerate(QUANTITIES)]
        return ", ".join(f"{name} {word} ({n} of {len(self.low)} test designs)" for n, name, word in counts if n)

    @property
    def text(self) -> str:
        """The verdict, one sentence."""
        within = self.within
        replay = self.resampled or f"{self.departures:,} departures"
        if self.passed:
            return (
                f"the model gives the recordings' answer (all {within.shape[0]} test designs lie within the 95 % "
                f"intervals of the replay: {replay})"
            )
        replayed, generated = np.array(self.replayed), np.array(self.generated)
        half = 0.5 * (np.array(self.high) - np.array(self.low))
        gap = np.where(within, 0.0, np.abs(generated - replayed) / np.maximum(half, 1e-12))
        # the effect of control comes first: it is what designs are ranked by
        j = 0 if gap[:, 0].any() else int(gap.max(axis=0).argmax())
        i = int((np.abs(generated - replayed) * (gap > 0.0))[:, j].argmax())
        recorded, drawn = float(replayed[i, j]), float(generated[i, j])
        where = f"({self.designs[i]}: {_value(j, recorded)} replayed, {_value(j, drawn)} generated; {replay})"
        if j == 0:
            word = "understates" if drawn < recorded else "overstates"
            points = f"{100.0 * abs(drawn - recorded):.0f} points"
            return f"the model {word} the effect of control by {points} {where}: do not use it"
        word = "small" if drawn < recorded else "large"
        return f"the {QUANTITIES[j]} of the model is too {word} {where}: do not use it"


def _value(j: int, value: float) -> str:
    """Quantity j with its unit, as text."""
    return f"{100.0 * value:.1f} %" if UNITS[j] == "" else f"{value:.2f} {UNITS[j]}"


@dataclasses.dataclass(frozen=True)
class _Answer:
    """The answer of driven departures, and what it is when their clusters are resampled."""

    answer: FloatArray  # (designs, quantities)
    resampled: FloatArray  # (resamples, designs, quantities)
    # (designs, quantities) Factor of the standard error for few clusters of unequal size, and degrees of freedom
    factor: FloatArray
    df: FloatArray

    @classmethod
    def of(cls, driven: FloatArray, share: FloatArray, index: IntArray, seed: int = 0) -> _Answer:
        """The answer of columns (designs, 6, n) under weights (n,), with clusters (n,)."""
        G = int(index.max()) + 1
        counts = np.random.default_rng(seed).multinomial(G, np.full(G, 1.0 / G), size=_RESAMPLES)
        weights = share * np.take(counts, index, axis=1)
        answer = np.stack([_answers(columns, share[None])[0] for columns in driven])
        resampled = np.stack([_answers(columns, weights) for columns in driven], axis=1)
        influence = np.concatenate([_influence(*row, share) for row in zip(driven, answer, strict=True)])
        corrected = cluster_error(influence, index, share)
        return cls(answer, resampled, *(x.reshape(answer.shape) for x in (corrected.factor, corrected.df)))


@dataclasses.dataclass(frozen=True)
class Replay:
    """The recordings' answer on one side, which any number of models can be compared with."""

    setup: Setup
    thresholds: tuple[float, ...]
    rows: IntArray  # (m,) Departures that were driven
    driven: FloatArray  # (designs, 6, m), see `_driven`
    share: FloatArray  # (m,) Events that each stands for
    clusters: Clusters  # Of all departures
    answer: FloatArray  # (designs, quantities)
    low: FloatArray
    high: FloatArray
    # Of each value by itself, of these very departures: how near to them a model is to be chosen
    point_low: FloatArray
    point_high: FloatArray

    @property
    def generated(self) -> int:
        """Departures to generate: so many that their own error widens that of the replay by a tenth at most."""
        return min(max(5 * self.rows.size, FEWEST_GENERATED), MOST_GENERATED)

    @classmethod
    def of(
        cls,
        departures: DepartureParameters,
        clusters: Clusters,
        weight: FloatArray | None = None,
        vehicle_width: float | None = None,
    ) -> Replay:
        """Drive the departures of one side (n,), each of which stands for `weight` events."""
        n = departures.n
        rows = np.arange(min(n, MOST_REPLAYED)) * n // min(n, MOST_REPLAYED)
        scenarios, drivable = _drivable(departures.take(rows))
        rows = rows[drivable]
        share = np.ones(rows.size) if weight is None else weight[rows]
        thresholds = tuple(round(float(y), 3) for y in np.quantile(scenarios.d_y, TRIGGERS))
        usual = VehicleParameters()
        if vehicle_width is not None and vehicle_width < usual.w_l:
            usual = dataclasses.replace(usual, w_v=vehicle_width)
        setup = Setup(vehicle=usual)
        driven = np.stack(list(_driven(scenarios, setup, thresholds)))
        sampled = _Answer.of(driven, share, np.arange(rows.size))
        answer, tail = sampled.answer, 0.5 * (1.0 - CONFIDENCE)
        point_low, point_high = np.quantile(sampled.resampled, (tail, 1.0 - tail), axis=0)
        error = sampled.resampled.std(axis=0)
        critical, index = _critical(sampled.resampled - answer, error), several(clusters.take(rows).numbers)
        if index is not None:
            # critical values are those of single departures: clusters are too few to show tails and correlations
            sampled = _Answer.of(driven, share, index)
            critical = critical * _tails_of_t(critical, sampled.df)
            error = sampled.factor * sampled.resampled.std(axis=0)
        ends = _ends(answer, critical * error)
        return cls(setup, thresholds, rows, driven, share, clusters, answer, *ends, point_low, point_high)

    def compared(self, generated: DepartureParameters) -> tuple[SideFidelity, float]:
        """The answers of generated departures, and the share within intervals that hold for each value by itself."""
        answer = self._generated(generated)
        alone = (answer >= self.point_low) & (answer <= self.point_high)
        return self._fidelity(self.answer, self.low, self.high, answer, self.clusters.text), float(alone.mean())

    def held_out(self, fitted: BoolArray, generated: DepartureParameters) -> SideFidelity:
        """Departures generated from the `fitted` ones (n,) beside the replay of the others; both are uncertain."""
        mask, clusters = fitted[self.rows], self.clusters.take(self.rows)
        model, replay = (
            _Answer.of(self.driven[:, :, rows], self.share[rows], clusters.take(rows).index, seed)
            for seed, rows in enumerate((mask, ~mask), 1)
        )
        drawn = np.sqrt(1.0 + mask.sum() / generated.n)  # generated departures have an error of their own
        parts = (
            drawn * model.factor * (model.resampled - model.answer),
            replay.factor * (replay.resampled - replay.answer),
        )
        scatter, (first, second) = parts[0] - parts[1], (part.var(axis=0) for part in parts)
        error, spread = scatter.std(axis=0), first**2 / model.df + second**2 / replay.df
        df = np.divide((first + second) ** 2, spread, out=np.ones_like(error), where=spread > 0.0)
        critical = _critical(scatter, error)
        ends = _ends(replay.answer, critical * _tails_of_t(critical, df) * error)
        departures, n = int((~mask).sum()), int(mask.sum())
        text = f"the {departures:,} departures that a model of the other {n:,} has not seen"
        text = "; ".join(filter(None, (text, clusters.take(~mask).doubt)))
        return self._fidelity(replay.answer, *ends, self._generated(generated), text, departures)

    def _fidelity(
        self, answer: FloatArray, low: FloatArray, high: FloatArray, drawn: FloatArray, text: str, n: int | None = None
    ) -> SideFidelity:
        ends = _rounded(low), _rounded(high)
        return SideFidelity(n or self.rows.size, self.thresholds, _rounded(answer), *ends, _rounded(drawn), text)

    def _generated(self, departures: DepartureParameters) -> FloatArray:
        """The answers of generated departures."""
        scenarios, _ = _drivable(departures)
        equal = np.ones((1, scenarios.n))
        return np.stack([_answers(row, equal)[0] for row in _driven(scenarios, self.setup, self.thresholds)])


def _critical(scatter: FloatArray, error: FloatArray) -> FloatArray:
    """Critical values (5,) of all designs at once, from scatter (resamples, designs, 5) with its error (designs, 5)."""
    largest = np.abs(np.divide(scatter, error, out=np.zeros_like(scatter), where=error > 0.0)).max(axis=1)
    return np.array([np.quantile(largest[:, j], level) for j, level in enumerate(_LEVELS)])


def _tails_of_t(critical: npt.ArrayLike, df: FloatArray) -> FloatArray:
    """How much further out the tail of Student's t begins than that of the normal distribution, for 12 designs."""
    normal = np.clip(critical, *_NORMAL)
    return np.asarray(with_tails_of_t(normal, df) / normal)


def _ends(answer: FloatArray, half: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Ends of an interval of this half width, no narrower than what matters, within what there can be."""
    half = np.clip(half, _NEGLIGIBLE * np.where(_ABSOLUTE, 1.0, np.abs(answer)), _WIDEST)
    return np.maximum(answer - half, _LEAST), np.minimum(answer + half, _MOST)


def _drivable(p: DepartureParameters) -> tuple[Scenarios, BoolArray]:
    """The departures that can be driven, as scenarios, and which these are."""
    names = ("side", *PARAMETER_NAMES)
    drivable = (slowest_speed(p.v_mean, p.a_mean, p.T) >= SPEED_FLOOR) & (p.v_mean < 0.5 * SPEED_CEILING)
    return Scenarios.drawn(**{name: getattr(p, name)[drivable] for name in names}), drivable


def _driven(scenarios: Scenarios, setup: Setup, thresholds: tuple[float, ...]) -> Iterator[FloatArray]:
    """Columns (6, n) of each design: S, S_uncorrected, triggered, needless, added a_y, depth."""
    columns = {}
    for y_s in thresholds:
        for probe, run in enumerate(drive_many(PROBES, Takeover.build(scenarios, setup, y_s=y_s))):
            outcome = run.outcome("control")
            without_need = needless(outcome.triggered, scenarios.d_y)
            peaks = outcome.metrics.a_y_added_peak, outcome.metrics.deepest
            columns[probe, y_s] = np.stack([outcome.S, outcome.S_uncorrected, outcome.triggered, without_need, *peaks])
    for probe in range(len(PROBES)):
        yield from (columns[probe, y_s] for y_s in thresholds)


def _answers(columns: FloatArray, weights: FloatArray) -> FloatArray:
    """`QUANTITIES` of one design under each row of weights (B, n): (B, 5)."""
    S, S_uncorrected, triggered, without_need, a_y, depth = columns
    total, uncorrected = weights.sum(axis=1), weights @ S_uncorrected
    reduction = np.divide(uncorrected - weights @ S, uncorrected, out=np.zeros_like(total), where=uncorrected > 0.0)
    shares = weights @ triggered / total, weights @ without_need / total
    return np.stack([reduction, *shares, _tail(a_y, weights * triggered), _tail(depth, weights)], axis=1)


def _influence(columns: FloatArray, answer: FloatArray, share: FloatArray) -> FloatArray:
    """How far each departure pulls each answer (5, n), up to a factor: of a quantile whether it lies above it."""
    S, S_uncorrected, triggered, without_need, a_y, depth = columns
    above = triggered * (a_y > answer[3]), depth > answer[4]
    pull = np.stack([S - (1.0 - answer[0]) * S_uncorrected, triggered, without_need, *above])
    among = np.ones_like(pull)
    among[3] = triggered
    total = among @ share
    mean = np.divide(pull @ share, total, out=np.zeros_like(total), where=total > 0.0)
    return np.asarray(pull - mean[:, None] * among)


def _tail(values: FloatArray, weights: FloatArray) -> FloatArray:
    """95 % quantile of values (n,) under each row of weights (B, n); 0 where nothing has a weight."""
    order = np.argsort(values, kind="stable")
    reached = np.cumsum(weights[:, order], axis=1)
    rank = (reached >= _TAIL * reached[:, -1:]).argmax(axis=1)
    return np.where(reached[:, -1] > 0.0, values[order][rank], 0.0)


def _rounded(values: FloatArray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(f"{value:.5g}") for value in row) for row in values.tolist())
