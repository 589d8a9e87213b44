"""Scenario model: one bounded Gaussian mixture a side, from which scenarios are drawn; one JSON file."""

from __future__ import annotations

import dataclasses
import importlib.resources
import math
import os
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.checked_files import json_text, read_regular, write_whole
from ldctoolkit.declared import UnitWarning, checked_seed, checked_whole, unit_slip
from ldctoolkit.departures import (
    LEFT,
    PARAMETER_NAMES,
    PARAMETER_UNITS,
    RIGHT,
    SIDES,
    DepartureParameters,
    Plausibility,
    check_parameters,
)
from ldctoolkit.errors import InputError, ModelError, UnknownNameError
from ldctoolkit.mixture import SAMPLE_BLOCK, BoundedGaussianMixture, Distribution
from ldctoolkit.mixture._distribution import interval_of
from ldctoolkit.scenario_model.provenance import ModelProvenance, SideModel
from ldctoolkit.scenarios import SPEED_FLOOR, Scenarios, slowest_speed

Given = Mapping[str, float | tuple[float | None, float | None]]
"""Parameter -> its value, or (lower, upper) between which it lies; None is open. SI units."""


@dataclasses.dataclass(frozen=True)
class Condition:
    """One parameter between two values, or at one."""

    name: str  # of the parameter
    low: float  # infinite where open; equal for one value
    high: float  # infinite where open; equal for one value

    def __str__(self) -> str:
        unit = PARAMETER_UNITS[PARAMETER_NAMES.index(self.name)]
        if self.low == self.high:
            return f"{self.name} = {self.low:g} {unit}"
        if math.isinf(self.high):
            return f"{self.name} above {self.low:g} {unit}"
        if math.isinf(self.low):
            return f"{self.name} below {self.high:g} {unit}"
        return f"{self.name} from {self.low:g} to {self.high:g} {unit}"


def conditions(given: Given | None) -> tuple[Condition, ...]:
    """The conditions in the order of `PARAMETER_NAMES`; those that are open on both sides are left out.

    Raises `InputError` for an unknown parameter, or what is neither a number nor an ascending pair.

    Parameters
    ----------
    given : mapping, optional
        Parameter -> value or (lower, upper).

    Examples
    --------
    >>> [str(condition) for condition in conditions({"c_0": 0.001, "v_mean": (25, 35), "T": (3, None)})]
    ['T above 3 s', 'v_mean from 25 to 35 m/s', 'c_0 = 0.001 1/m']
    """
    if given is not None and not isinstance(given, Mapping):
        raise InputError("given", value=given, allowed="a mapping of parameters")
    by_name = {}
    check_parameters("given", given or ())
    for name, value in (given or {}).items():
        low, high = interval_of(f"given[{name!r}]", value)
        slip = unit_slip(name, low) or unit_slip(name, high if math.isfinite(high) else 0.0)
        if slip:
            warnings.warn(f"given {slip}", UnitWarning, stacklevel=3)
        if low > -math.inf or high < math.inf:
            by_name[name] = Condition(name, low, high)
    return tuple(by_name[name] for name in PARAMETER_NAMES if name in by_name)


def meeting(departures: DepartureParameters, limits: tuple[Condition, ...]) -> BoolArray:
    """Which departures (n,) meet all conditions."""
    meets = np.ones(departures.n, dtype=np.bool_)
    for condition in limits:
        column = getattr(departures, condition.name)
        meets &= (column >= condition.low) & (column <= condition.high)
    return meets


def misleading(model: ScenarioModel) -> list[str]:
    """What a model gets wrong against its recordings, one sentence a side; none where the check passed."""
    checked = [(key, side.fidelity) for key, side in model.provenance.sides if side.fidelity is not None]
    return [f"scenario model, {key}: {fidelity.text}" for key, fidelity in checked if not fidelity.passed]


def outside_fit(model: ScenarioModel, given: Given | None) -> list[str]:
    """Conditions that reach beyond what a model was fitted to, one sentence each; none where it holds no summary."""
    sentences: dict[str, str] = {}
    for key, side in model.provenance.sides:
        summary = side.source_summary
        for condition in conditions(given):
            if summary is None or condition.name not in summary.names:
                continue
            quantiles = summary.quantiles[summary.names.index(condition.name)]
            ends = [end for end in (condition.low, condition.high) if math.isfinite(end)]
            if any(not quantiles[0] <= end <= quantiles[-1] for end in ends):
                interval = [condition.low, condition.high]
                below = np.interp(interval, quantiles, summary.probabilities, left=0.0, right=1.0)
                expected = summary.departures * float(below[1] - below[0])
                sentences.setdefault(
                    condition.name,
                    f"given {condition}: outside the fitted departures ({key}), of which "
                    f"{100 - 100 / len(quantiles):.0f} % lie from {quantiles[0]:.4g} to {quantiles[-1]:.4g}; about "
                    f"{expected:,.0f} of {summary.departures:,} recorded ones meet it",
                )
    return list(sentences.values())


def mixture_conditions(
    given: tuple[Condition, ...], side: SideModel, label: str
) -> dict[int, float | tuple[float, float]]:
    """Column of the side's mixture -> value or (lower, upper)."""
    constants = dict(side.constants)
    lower, upper = side.bounds()
    out: dict[int, float | tuple[float, float]] = {}
    for condition in given:
        low, high = condition.low, condition.high
        if condition.name in constants:
            value = constants[condition.name]
            if not low <= value <= high:
                allowed = f"{value:g}, as in every {label} departure of this model"
                raise InputError(f"given[{condition.name!r}]", f"{condition}", allowed=allowed)
            continue
        j = side.names.index(condition.name)
        a, b = float(lower[j]), float(upper[j])
        if (not a < low < b) if low == high else (high <= a or low >= b):
            allowed = f"between {a:g} and {b:g}, the bounds of the {label} departures of this model"
            raise InputError(f"given[{condition.name!r}]", f"{condition}", allowed=allowed)
        out[j] = low if low == high else (max(low, a), min(high, b))
    return out


_STREAM: Final = {LEFT: 0, RIGHT: 1}
_LABEL: Final = {side: label for label, side in SIDES.items()}
_SPARE_BLOCKS: Final = 50
"""Blocks drawn per block needed before sampling is given up: one event in fifty must stay above the speed floor."""

_DENSITY_EVENTS: Final = 1_048_576  # behind the probability that a density is divided by


@dataclasses.dataclass(frozen=True)
class _Point:
    """The distribution of a side with values given for all its parameters: every event is the same."""

    values: FloatArray

    def sample_block(self, seed: int, key: tuple[int, ...]) -> tuple[FloatArray, IntArray]:
        """`SAMPLE_BLOCK` equal events, whatever the stream, and their components."""
        del seed, key
        return np.tile(self.values, (SAMPLE_BLOCK, 1)), np.zeros(SAMPLE_BLOCK, dtype=np.int64)


@dataclasses.dataclass(frozen=True, repr=False)
class ScenarioModel:
    """Left and right mixture, their bounds, constants and provenance.

    Notes
    -----
    Parameters are in the outward frame, SI units, in the order of ``PARAMETER_NAMES``.

    Examples
    --------
    >>> from ldctoolkit.scenario_model import load_model
    >>> model = load_model("reference")
    >>> scenarios = model.sample(3, 2, seed=1)
    >>> scenarios.side.tolist()
    [1, 1, 1, -1, -1]
    """

    left_side: SideModel  # Mixture over the parameters that vary, and the constants
    right_side: SideModel
    provenance: ModelProvenance  # Where the model comes from
    # Departures beyond it have no density and are not drawn; None in a model of an earlier version, for no limits
    plausibility: Plausibility | None = None
    _excluded: dict[int, float] = dataclasses.field(default_factory=dict, init=False, repr=False, compare=False)

    def __repr__(self) -> str:
        left, right = self.left_side, self.right_side
        text = "synthetic" if self.provenance.synthetic else "fitted"
        return (
            f"<ScenarioModel, {text}: {left.mixture.n_components} left, {right.mixture.n_components} right components>"
        )

    @property
    def left(self) -> BoundedGaussianMixture:
        """Mixture of left departures, over ``left_side.names``."""
        return self.left_side.mixture

    @property
    def right(self) -> BoundedGaussianMixture:
        """Mixture of right departures, over ``right_side.names``."""
        return self.right_side.mixture

    @property
    def content_hash(self) -> str:
        """SHA-256 of all that sampling depends on; the same for two fits that gave the same numbers."""
        from ldctoolkit.scenario_model import json_form  # loads pydantic, which not every command needs

        return json_form.content_hash(self.left_side, self.right_side, self.plausibility)

    def side(self, side: int) -> SideModel:
        """The model of `LEFT` or `RIGHT` departures."""
        return self.left_side if side == LEFT else self.right_side

    def parameters(self, side: int, x: FloatArray) -> DepartureParameters:
        """Departures from rows of a side's mixture (n, d)."""
        return DepartureParameters(np.full(x.shape[0], side), **self.side(side).columns(x))

    def possible(self, departures: DepartureParameters) -> BoolArray:
        """Which departures (n,) are plausible, and fast enough all the time to be replayed."""
        p = departures
        fast = slowest_speed(p.v_mean, p.a_mean, p.T) >= SPEED_FLOOR
        return fast if self.plausibility is None else fast & self.plausibility.holds(p)

    def log_density(self, departures: DepartureParameters) -> FloatArray:
        """Log-density of departures (n,), each on its own side, over the parameters that vary there.

        The mixture's, divided by the probability of what is possible; -inf elsewhere, and where a constant differs.

        Examples
        --------
        >>> model = load_model("reference")
        >>> model.log_density(model.sample(2, 1, seed=1)).shape
        (3,)
        """
        out = np.full(departures.n, -np.inf)
        for side in (LEFT, RIGHT):
            half = self.side(side)
            rows = np.flatnonzero((departures.side == side) & self.possible(departures))
            for name, value in half.constants:
                rows = rows[getattr(departures, name)[rows] == value]
            x = np.column_stack([getattr(departures, name)[rows] for name in half.names])
            if rows.size:
                if side not in self._excluded:
                    self._excluded[side] = self.redrawn_share(side, events=_DENSITY_EVENTS)
                out[rows] = half.mixture.distribution.log_density(x) - math.log1p(-self._excluded[side])
        return out

    def sample(self, n_left: int, n_right: int, seed: int = 0, given: Given | None = None) -> Scenarios:
        """Draw scenarios, left ones first.

        Raises `InputError` if a number or the seed is not a non-negative integer, or a condition names no parameter or
        cannot be met; `ModelError` if hardly any event of the model can be replayed.

        Parameters
        ----------
        n_left, n_right : int
            Number of scenarios a side.
        seed : int
            The same seed gives the same scenarios; the first m scenarios of a side depend neither on how many are
            drawn nor on the other side.
        given : mapping, optional
            Only departures with these properties, drawn exactly from the model's distribution under the condition:
            parameter -> its value, or (lower, upper) between which it lies; None is open. SI units.

        Returns
        -------
        Scenarios
            n_left + n_right rows inside the model's bounds.

        Notes
        -----
        Events are drawn in blocks of one size, each from its own random stream (seed, side, block). An event that is
        not plausible, or whose speed falls below ``SPEED_FLOOR`` within the departure, is passed over and the next one
        of the stream taken; the share of such events is ``provenance.left.redrawn_share``, or by `redrawn_share`.

        Examples
        --------
        >>> from ldctoolkit import load_model
        >>> motorway = load_model("reference").sample(100, 0, seed=1, given={"v_mean": (25, 35), "c_0": 0.0})
        >>> bool(motorway.v_mean.min() > 25 and motorway.v_mean.max() < 35 and (motorway.c_0 == 0.0).all())
        True
        """
        required = conditions(given)
        n_left, n_right = checked_whole("n_left", n_left, lower=0), checked_whole("n_right", n_right, lower=0)
        seed = checked_seed(seed)
        parts = [self._draw(side, n, seed, required) for side, n in ((LEFT, n_left), (RIGHT, n_right))]
        columns = {name: np.concatenate([part[name] for part in parts]) for name in PARAMETER_NAMES}
        drawn = Scenarios.drawn(side=np.repeat([LEFT, RIGHT], [n_left, n_right]), **columns)
        # even numbers to the left, odd ones to the right: the same however many there are
        return dataclasses.replace(drawn, index=np.concatenate([2 * np.arange(n_left), 2 * np.arange(n_right) + 1]))

    def _distribution(self, side: int, given: tuple[Condition, ...] = ()) -> Distribution | _Point:
        """What the events of a side are drawn from."""
        half = self.side(side)
        columns = mixture_conditions(given, half, _LABEL[side])
        values = {j: value for j, value in columns.items() if isinstance(value, float)}
        if len(values) == len(half.names):
            return _Point(np.array([values[j] for j in range(len(half.names))]))
        return half.mixture.distribution.condition(columns) if columns else half.mixture.distribution

    def _block(self, side: int, distribution: Distribution | _Point, block: int, seed: int) -> DepartureParameters:
        """The events of one block that can happen and be replayed."""
        x, _ = distribution.sample_block(seed, (_STREAM[side], block))
        drawn = self.parameters(side, x)
        return drawn.take(self.possible(drawn))

    def _draw(self, side: int, n: int, seed: int, given: tuple[Condition, ...]) -> dict[str, FloatArray]:
        if n == 0:
            return {name: np.empty(0) for name in PARAMETER_NAMES}
        distribution = self._distribution(side, given)
        blocks: list[DepartureParameters] = []
        drawn = 0
        limit = _SPARE_BLOCKS * (1 + n // SAMPLE_BLOCK)
        while drawn < n:
            if len(blocks) == limit:
                share = 1.0 - drawn / (limit * SAMPLE_BLOCK)
                if given:
                    texts = " and ".join(map(str, given))
                    raise InputError("given", f"departures ({_LABEL[side]}) with {texts} are too unlikely to be drawn")
                raise ModelError(
                    f"scenario model ({_LABEL[side]})",
                    f"{share:.1%} of the events fall below {SPEED_FLOOR} m/s or are not plausible",
                    hint="the model does not describe driving at speed",
                )
            blocks.append(self._block(side, distribution, len(blocks), seed))
            drawn += blocks[-1].n
        return {name: np.concatenate([getattr(block, name) for block in blocks])[:n] for name in PARAMETER_NAMES}

    def redrawn_share(self, side: int, seed: int = 0, events: int = 16_384) -> float:
        """Share of the mixture's events of a side that are not possible and are drawn again, from so many draws."""
        blocks = -(-events // SAMPLE_BLOCK)
        possible = sum(self._block(side, self._distribution(side), block, seed).n for block in range(blocks))
        return 1.0 - possible / (blocks * SAMPLE_BLOCK)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write one JSON file, whole or not at all.

        Raises `ModelError` if the file cannot be written, the provenance holds values that JSON does not know, or
        `load` would refuse the file.

        Parameters
        ----------
        path : path
            An existing file is replaced.
        """
        from ldctoolkit.scenario_model import json_form

        target = Path(path)
        try:
            data = json_form.parts_to_json(self.left_side, self.right_side, self.provenance, self.plausibility)
            text = json_text(data)
        except (TypeError, ValueError) as error:
            raise ModelError(target.name, f"the model cannot be written as JSON ({error})") from None
        self._parse(text, target.name)  # what cannot be read back is not written
        write_whole(target, text.encode(), ModelError)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> ScenarioModel:
        """Read and check a file written by `save`.

        Parameters
        ----------
        path : path
            The file.

        Returns
        -------
        ScenarioModel
            With exactly the numbers that were saved.

        Raises
        ------
        ModelError
            Broken JSON (with line and column), another format or version, or a value that does not fit (with its key
            path).
        """
        return cls._parse(read_regular(Path(path), ModelError), str(path))

    @classmethod
    def _parse(cls, text: str | bytes, file: str) -> ScenarioModel:
        from ldctoolkit.scenario_model import json_form

        return cls(*json_form.parts_from_json(text, file))


def bundled_models() -> tuple[str, ...]:
    """Names of the models that come with the toolkit.

    Examples
    --------
    >>> bundled_models()
    ('reference',)
    """
    folder = importlib.resources.files("ldctoolkit") / "models"
    return tuple(sorted(entry.name[:-5] for entry in folder.iterdir() if entry.name.endswith(".json")))


def load_model(name_or_path: str | os.PathLike[str]) -> ScenarioModel:
    """A bundled model by its name, or a model file by its path.

    Raises `UnknownNameError` if it is neither a bundled name nor a file; the message lists the names; `ModelError` if
    the file is broken.

    Parameters
    ----------
    name_or_path : str or path
        ``"reference"``, or a path to a JSON file.

    Examples
    --------
    >>> load_model("reference").provenance.synthetic
    True
    """
    name = os.fspath(name_or_path)
    names = bundled_models()
    if name in names:
        text = (importlib.resources.files("ldctoolkit") / "models" / f"{name}.json").read_text(encoding="utf-8")
        return ScenarioModel._parse(text, f"{name}.json")
    path = Path(name)
    if os.path.exists(name):  # noqa: PTH110 - this one raises nothing, whatever the path
        return ScenarioModel.load(path)
    if path.suffix == ".json" or path.name != name or not isinstance(name_or_path, str):
        raise ModelError(name, "no such file", hint=f"bundled models: {', '.join(names)}")
    raise UnknownNameError("scenario model", "is neither a bundled model nor a file", value=name, allowed=names)
