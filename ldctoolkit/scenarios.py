"""Scenarios: lane departures to be replayed, and the model that generates them."""

from __future__ import annotations

import dataclasses
import importlib
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray, Rows, unmasked
from ldctoolkit.clusters import Clusters
from ldctoolkit.declared import UnitWarning, unit_slip
from ldctoolkit.departures import LEFT, PARAMETER_NAMES, RIGHT, SIDES, DepartureParameters, DepartureSignals
from ldctoolkit.errors import InputError

SPEED_FLOOR = 1.0  # lowest speed [m/s] at which a scenario can be replayed: the vehicle model divides by the speed

SPEED_CEILING: Final = 90.0  # gains are scheduled up to it (`vehicle.speed_schedule.SPEED_RANGE`)
_MOST_CURVATURE: Final = 0.2
_MOST_ACCELERATION: Final = 40.0

_LIMITS: Final = (
    ("T", 600.0, "s"),
    ("d_y", 10.0, "m"),
    ("sigma_y", 10.0, "m"),
    ("a_mean", _MOST_ACCELERATION, "m/s^2"),
    ("sigma_v", 10.0, "m/s"),
)


@dataclasses.dataclass(frozen=True)
class Drifts(Rows):
    """n departures that do not return: straight along the lane, an arc towards the line, straight on from there."""

    lateral_velocity: FloatArray  # (n,) [m/s] At the end of the arc, and from then on
    radius: FloatArray  # (n,) [m] Of the arc, relative to the lane
    distance: FloatArray  # (n,) [m] From the edge to the line where the arc begins, at t = 0

    def arc(self, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """How long the arc takes at speeds v (n,) [s], and the lateral distance that it covers [m]."""
        angle = np.arcsin(self.lateral_velocity / v)
        return self.radius * angle / v, 2.0 * self.radius * np.sin(0.5 * angle) ** 2

    def motion(self, v: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Lateral position of the edge, its rate and second derivative at times t, (n,) or (n, k)."""
        columns = (v, self.radius, self.lateral_velocity, self.distance, self.arc(v)[0])
        v, radius, rate, distance, end = (column if t.ndim == 1 else column[:, None] for column in columns)
        angle = v * np.clip(t, 0.0, end) / radius
        y = 2.0 * radius * np.sin(0.5 * angle) ** 2 - distance + rate * np.maximum(t - end, 0.0)
        turning = (t >= 0.0) & (t < end)
        return y, v * np.sin(angle), np.where(turning, v**2 / radius * np.cos(angle), 0.0)


@dataclasses.dataclass(frozen=True, repr=False)
class Scenarios(DepartureParameters):
    """n departures to be replayed: side and the eight parameters, arrays of n, outward frame.

    Built with `from_arrays`, which checks them, `from_drifts`, or by ``ScenarioModel.sample``.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> drawn = ldc.load_model("reference").sample(3, 2, seed=0)
    >>> len(drawn), drawn.take(drawn.side > 0).index.tolist()
    (5, [0, 2, 4])
    """

    # (n,) Each scenario's number, kept by `take`: what is drawn for a scenario follows from the seed and this number.
    # Of a model even to the left and odd to the right, however many there are; of arrays 0 to n - 1
    index: IntArray
    signals: DepartureSignals | None = None  # Recorded paths, driven in place of the parabolas
    drift: Drifts | None = None  # Paths that do not return, driven in place of the parabolas
    # (n,) Number of the trip or driver of each recorded departure; those of one are alike, and are resampled together.
    # -1 where trips are not known
    cluster: IntArray | None = None

    @classmethod
    def from_arrays(
        cls,
        *,
        T: npt.ArrayLike,
        d_y: npt.ArrayLike,
        v_mean: npt.ArrayLike,
        a_mean: npt.ArrayLike = 0.0,
        c_0: npt.ArrayLike = 0.0,
        dc: npt.ArrayLike = 0.0,
        sigma_y: npt.ArrayLike = 0.0,
        sigma_v: npt.ArrayLike = 0.0,
        side: npt.ArrayLike = LEFT,
    ) -> Scenarios:
        """Build and check scenarios from arrays of n (scalars are repeated).

        Raises `InputError` naming the column, the row and what is allowed.

        Parameters
        ----------
        T, d_y, v_mean, a_mean, c_0, dc, sigma_y, sigma_v : (n,)
            The eight parameters in SI units, curvature in the outward frame. The speed stays within 1 to 90 m/s, T
            within 600 s, d_y and sigma_y within 10 m, a_mean and v_mean^2 times the curvature within 40 m/s^2, sigma_v
            within 10 m/s, the curvature within 0.2 1/m: far beyond any departure, so that a slip of units is seen.
        side : (n,) int or str
            +1 or ``"left"``, -1 or ``"right"``.

        Returns
        -------
        Scenarios
            n rows, float64.

        Examples
        --------
        >>> from ldctoolkit import Scenarios
        >>> len(Scenarios.from_arrays(T=[2.0, 3.0], d_y=0.3, v_mean=25.0))
        2
        """
        scenarios = cls.drawn(
            side=side, T=T, d_y=d_y, sigma_y=sigma_y, v_mean=v_mean, a_mean=a_mean, sigma_v=sigma_v, c_0=c_0, dc=dc
        )
        for name, most, unit in _LIMITS:
            values = getattr(scenarios, name)
            _refuse(np.abs(values) > most, name, values, f"up to {most:g} {unit}")
        v = scenarios.v_mean
        fastest = 2.0 * v - slowest_speed(v, scenarios.a_mean, scenarios.T)
        allowed = f"the speed v_mean +- a_mean T/2 stays at or below {SPEED_CEILING:g} m/s over the whole departure"
        _refuse(fastest > SPEED_CEILING, "v_mean", v, allowed)
        allowed = f"a curvature up to {_MOST_CURVATURE} 1/m, with v_mean^2 times it up to {_MOST_ACCELERATION:g} m/s^2"
        for name, c in (("c_0", scenarios.c_0), ("dc", scenarios.c_0 + scenarios.dc)):
            bad = np.abs(c) > np.minimum(_MOST_CURVATURE, _MOST_ACCELERATION / v**2)
            _refuse(bad, name, getattr(scenarios, name), allowed)
        if scenarios.n and (slip := unit_slip("v_mean", float(scenarios.v_mean.max()))):
            warnings.warn(slip, UnitWarning, stacklevel=2)
        return scenarios

    @classmethod
    def from_departures(
        cls, departures: DepartureParameters, *, path: Literal["parabola", "recorded"] = "parabola"
    ) -> Scenarios:
        """Recorded departures as scenarios, to be replayed in the order of the table.

        Raises `InputError` as `from_arrays`; for a recorded path without signals.

        Parameters
        ----------
        departures : Departures
            As `extract_departures` or `read_departures` give them.
        path : {"parabola", "recorded"}
            What is driven without control: the fitted parabola, or the recorded y(t), v(t) and c(t), which the
            extraction keeps on request.

        Examples
        --------
        >>> from ldctoolkit import load_model
        >>> drawn = load_model("reference").sample(2, 1, seed=1)  # stands for recorded departures
        >>> Scenarios.from_departures(drawn).side.tolist()
        [1, 1, -1]
        """
        columns = {name: getattr(departures, name) for name in PARAMETER_NAMES}
        scenarios = cls.from_arrays(side=departures.side, **columns)
        scenarios = dataclasses.replace(scenarios, cluster=Clusters.of(departures).numbers)
        if path == "parabola":
            return scenarios
        if path != "recorded":
            raise InputError("path", value=path, allowed=("parabola", "recorded"))
        signals = getattr(departures, "signals", None)
        if signals is None:
            hint = "extract them with keep_signals=True"
            raise InputError("path", "needs signals, and the departures hold none", value=path, hint=hint)
        return dataclasses.replace(scenarios, signals=signals)

    @classmethod
    def from_drifts(
        cls,
        *,
        v: npt.ArrayLike,
        lateral_velocity: npt.ArrayLike,
        radius: npt.ArrayLike,
        distance: npt.ArrayLike,
        T: npt.ArrayLike,
        c: npt.ArrayLike = 0.0,
        side: npt.ArrayLike = LEFT,
    ) -> Scenarios:
        """Departures of a driver who does not come back, as in the tests of regulations and Euro NCAP.

        Without control the vehicle goes straight along the lane until t = 0, then along an arc towards the line until
        it has the lateral velocity, then straight on until T. Raises `InputError` naming column, row and what is
        allowed.

        Parameters
        ----------
        v : (n,) [m/s]
            Speed, 1 to 90.
        lateral_velocity : (n,) [m/s]
            Relative to the lane, at the end of the arc; above 0 and below v.
        radius : (n,) [m]
            Of the arc, relative to the lane.
        distance : (n,) [m]
            From the vehicle's edge to the line where the arc begins.
        T : (n,) [s]
            End of the test, up to 600.
        c : (n,) [1/m]
            Curvature of the lane, outward frame.
        side : (n,) int or str
            As in `from_arrays`.

        Examples
        --------
        >>> drift = Scenarios.from_drifts(v=20.0, lateral_velocity=0.5, radius=1200.0, distance=1.1, T=8.0)
        >>> drift.drift.arc(drift.v_mean)[1].round(3)
        array([0.375])
        """
        path = {"lateral_velocity": lateral_velocity, "radius": radius, "distance": distance}
        columns: dict[str, Any] = _columns(path | {"v_mean": v, "T": T, "c_0": c, "side": side})
        drift = Drifts(*(columns.pop(name) for name in path))
        scenarios = cls.from_arrays(d_y=0.0, **columns)
        rate, radii, distances = drift.lateral_velocity, drift.radius, drift.distance
        for name, values in (("lateral_velocity", rate), ("radius", radii)):
            _refuse(~(np.isfinite(values) & (values > 0.0)), name, values, "> 0")
        _refuse(~(np.isfinite(distances) & (distances >= 0.0)), "distance", distances, ">= 0")
        _refuse(~(rate < scenarios.v_mean), "lateral_velocity", rate, "below the speed")
        deepest = drift.motion(scenarios.v_mean, scenarios.T)[0]
        return dataclasses.replace(scenarios, d_y=np.maximum(deepest, 0.0), drift=drift)

    def to_openscenario(
        self, folder: str | Path, rows: bool | npt.ArrayLike = True, outcome: Any = None, *, setup: Any = None,
        reference: Literal["centre_of_gravity", "rear_axle"] = "centre_of_gravity",
        format: Literal["openscenario", "csv"] = "openscenario",
    ) -> tuple[Path, ...]:  # fmt: skip
        """Write departures as OpenSCENARIO 1.0 files and OpenDRIVE roads, or as tables; returns the k main files.

        The plane is that of `Trajectories.world`; of a recorded path alone the origin is where the departure starts.
        Raises `InputError` for rows that do not exist or cannot be driven, or an outcome of other scenarios, of another
        setup, or without the paths; `LdcError` without the extra ``scenario``, or where nothing can be written.

        Parameters
        ----------
        folder : str or path
            Where ``departure-NUMBER.xosc`` and ``.xodr``, or ``.csv``, go.
        rows : bool or (k,) int
            Row numbers of the scenarios, or true for all.
        outcome : Outcome, optional
            From `simulate` with ``trajectories``: its corrected paths begin at the trigger, an event. Else recorded.
        setup : Setup, optional
            The one that was driven with: lane, vehicle, and what is drawn for the recorded path.
        reference : {"centre_of_gravity", "rear_axle"}
            The vehicle's point that positions are of, from which bounding box and axles are measured.
        format : {"openscenario", "csv"}
            Columns: ``t_s, x_m, y_m, heading_rad, speed_m_s, wheel_angle_rad, trigger_time_s``.

        Examples
        --------
        >>> import tempfile
        >>> import ldctoolkit as ldc
        >>> right = ldc.Scenarios.from_arrays(T=4.0, d_y=0.5, v_mean=25.0, side="right")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     [file.name for file in right.to_openscenario(folder)]
        ['departure-000000.xosc']
        """
        export = importlib.import_module("ldctoolkit.other_simulators").export_scenarios  # it lies above
        return tuple(export(self, folder, rows, outcome, setup, reference, format))

    def arrays(self) -> Iterator[npt.NDArray[Any]]:
        """All arrays that describe the scenarios, always in the same order."""
        for part in (self, self.signals, self.drift):
            fields = () if part is None else dataclasses.fields(part)
            yield from (array for field in fields if isinstance(array := getattr(part, field.name), np.ndarray))

    @classmethod
    def drawn(cls, **given: npt.ArrayLike) -> Scenarios:
        """As `from_arrays`, all nine by name, without its limits: for what a model draws and what was stored."""
        columns: dict[str, Any] = _columns(given)
        for name, values in columns.items():
            _refuse(~np.isfinite(values), name, values, "finite numbers")
        side, T, v_mean = columns["side"], columns["T"], columns["v_mean"]
        _refuse(~np.isin(side, (LEFT, RIGHT)), "side", side, f"{LEFT} (left) or {RIGHT} (right)")
        _refuse(T <= 0, "T", T, "> 0 s")
        for name in ("d_y", "sigma_y", "sigma_v"):
            _refuse(columns[name] < 0, name, columns[name], ">= 0")
        allowed = f"the speed v_mean +- a_mean T/2 stays at or above {SPEED_FLOOR} m/s over the whole departure"
        _refuse(slowest_speed(v_mean, columns["a_mean"], T) < SPEED_FLOOR, "v_mean", v_mean, allowed)
        side = columns.pop("side").astype(np.int64)
        return cls(side=side, index=np.arange(side.size, dtype=np.int64), **columns)


def _columns(given: Mapping[str, npt.ArrayLike]) -> dict[str, FloatArray]:
    """The columns as arrays of one length (n,); sides may be words."""
    arrays = [np.atleast_1d(_numbers(name, value)) for name, value in given.items()]
    try:
        columns = np.broadcast_arrays(*arrays)
    except ValueError as error:
        raise InputError("scenarios", f"the columns do not have one common length ({error})") from None
    if columns[0].ndim != 1:
        raise InputError("scenarios", f"columns of {columns[0].ndim} dimensions", allowed="one dimension")
    return dict(zip(given, (np.array(column) for column in columns), strict=True))


def _numbers(name: str, value: npt.ArrayLike) -> FloatArray:
    """One column as floats, sides as +1 and -1; raises `InputError` for anything else."""
    path = f"scenarios.{name}"
    try:
        array = np.asarray(unmasked(value))
    except ValueError:
        raise InputError(path, "rows of different lengths", allowed="one number per row") from None
    if name == "side" and array.dtype.kind in "UO":
        for i, word in enumerate(array.ravel().tolist()):
            if word not in SIDES:
                raise InputError(f"{path}[{i}]", value=word, allowed=SIDES)
        array = np.where(array == "left", LEFT, RIGHT)
    if array.dtype.kind not in "iuf":
        for i, entry in enumerate(array.ravel().tolist()):
            if isinstance(entry, bool) or not isinstance(entry, int | float):
                raise InputError(f"{path}[{i}]", value=entry, allowed="a number")
    return array.astype(np.float64)


def _refuse(bad: BoolArray, name: str, values: npt.NDArray[Any], allowed: str) -> None:
    if bad.any():
        row, hint = int(np.argmax(bad)), f"{int(bad.sum())} rows in all" if bad.sum() > 1 else ""
        raise InputError(f"scenarios.{name}[{row}]", value=float(values[row]), allowed=allowed, hint=hint)


def slowest_speed(v_mean: npt.ArrayLike, a_mean: npt.ArrayLike, T: npt.ArrayLike) -> FloatArray:
    """Lowest speed [m/s] of a departure whose speed changes linearly: v_mean - |a_mean| T/2."""
    return np.asarray(np.asarray(v_mean) - 0.5 * np.abs(np.asarray(a_mean)) * np.asarray(T), dtype=np.float64)
