"""From a takeover and a law to the arrays that the compiled loops read and write."""

from __future__ import annotations

import dataclasses
import functools
import math
import threading
from collections.abc import Sequence
from typing import TYPE_CHECKING, Self

import numpy as np
import numpy.typing as npt

from ldctoolkit.control import LinearLaw
from ldctoolkit.simulation.kalman import filter_gain
from ldctoolkit.simulation.kernel import data
from ldctoolkit.simulation.random_streams import RandomStream, normals
from ldctoolkit.vehicle import discretize

if TYPE_CHECKING:
    from ldctoolkit.simulation.takeover import Takeover

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

BOUND = 20.0
"""|e_y| [m] at which a scenario counts as diverged; from there on the bound itself is scored, so S stays finite."""

JERK_WINDOW = 0.5
"""Moving average [s] of the lateral jerk (ISO 11270)."""


@dataclasses.dataclass(frozen=True)
class Tables:
    """A takeover as the compiled loops see it; the columns are named in `kernel.data`.

    Attributes
    ----------
    over : Takeover
    setting : (s,)
        Numbers that hold for every scenario.
    scene : (m, c)
        A row a scenario.
    """

    over: Takeover
    setting: FloatArray
    scene: FloatArray
    spare: threading.local = dataclasses.field(default_factory=threading.local, repr=False, compare=False)

    @classmethod
    def of(cls, over: Takeover) -> Self:
        """Everything that designs share."""
        from ldctoolkit.simulation.kernel import entry

        setting, scene = _setting(over), _scene(over)
        entry.before(scene, setting)
        return cls(over, setting, scene)

    @functools.cached_property
    def exact(self) -> FloatArray:
        """The ideal plant over a whole step, (m, `data.EXACT`)."""
        over = self.over
        if over.options.mismatch.ideal:
            step = over.plant.step
        else:
            step = discretize(*over.vehicles.matrices(over.plant.v, over.model.convention), over.dt)
        columns = [step.A[:, i, j] for i in range(4) for j in (1, 2, 3)]
        columns += [matrix[:, i] for matrix in (step.B, step.E_0, step.E_1, step.area_x) for i in range(4)]
        return _side_by_side([*columns, step.area_delta, step.area_r_0, step.area_r_1])

    @functools.cached_property
    def scene_to_T(self) -> FloatArray:
        """The same scenarios without a settling horizon."""
        scene = self.scene.copy()
        scene[:, data.STEPS] = scene[:, data.FULL] + (scene[:, data.REST] > 0.0)
        return scene

    def state(self) -> FloatArray:
        """Working rows of one run, without paths."""
        lengths = [int(self.setting[column]) for column in (data.COMMANDS, data.FRAMES, data.RING)]
        state = np.zeros((self.over.m, data.STATE + lengths[0] + 2 * lengths[1] + 2 * lengths[2]))
        state[:, data.SLOT] = -1.0
        return state

    def spare_state(self) -> FloatArray:
        """Rows that one thread's calls may use again and again: nothing in them is read before it is written."""
        if not hasattr(self.spare, "state"):
            self.spare.state = self.state()
        rows: FloatArray = self.spare.state
        return rows

    def spare_room(self, size: int) -> FloatArray:
        """At least `size` numbers, to be used like `spare_state`: fresh memory costs more than filling it."""
        if not hasattr(self.spare, "room") or self.spare.room.size < size:
            self.spare.room = np.empty(size)
        room: FloatArray = self.spare.room
        return room

    def paths(self, chosen: IntArray, state: FloatArray) -> FloatArray:
        """Room for the paths of the scenarios `chosen` (c,), by their place among the m: (c, entries, columns)."""
        state[chosen, data.SLOT] = np.arange(chosen.size)
        longest = int(self.scene[chosen, data.STEPS].max(initial=0)) + 2
        return np.full((chosen.size, longest, data.PATH), np.nan)


def _side_by_side(columns: list[FloatArray]) -> FloatArray:
    return np.ascontiguousarray(np.column_stack(columns), dtype=np.float64)


def _setting(over: Takeover) -> FloatArray:
    actuator, sensors, dt = over.options.actuator, over.options.sensors, over.dt
    whole = math.floor(actuator.delay / dt + 1e-9)
    part = actuator.delay - whole * dt
    period, late = sensors.in_samples(dt)
    values = {
        "dt": dt,
        "offset": over.model.parameters.edge_offset,
        "l_f": over.model.parameters.l_f,
        "bound": BOUND,
        "window": JERK_WINDOW / dt,
        "profile": over.options.speed == "profile",
        "saturating": not over.options.tyres.ideal,
        "shape": over.options.tyres.shape,
        "delta_max": math.inf if actuator.delta_max is None else actuator.delta_max,
        "rate_max": math.inf if actuator.rate_max is None else actuator.rate_max,
        "lag": actuator.lag,
        "delay_samples": whole,
        "delay_part": part if part > 1e-9 * dt else 0.0,
        "modes": over.driven.modes_v.shape[1],
        "earlier": -(-late // period),
        "camera": not sensors.ideal,
        "period": period,
        "late": late,
        "noise_y": sensors.e_y_noise,
        "noise_psi": sensors.e_psi_noise,
        "bias_y": sensors.e_y_bias,
        "bias_psi": sensors.e_psi_bias,
        "step_y": sensors.e_y_step,
        "step_psi": sensors.e_psi_step,
        "curvature_gain": sensors.curvature_gain,
        "seed_low": over.seed & 0xFFFFFFFF,
        "seed_high": over.seed >> 32,
        "filtered": sensors.kalman is not None,
        "commands": whole + 2,
        "frames": 0 if sensors.ideal else late + period + 1,
        "ring": 2 ** math.ceil(math.log2(math.ceil(JERK_WINDOW / dt) + 3)),
    }
    return np.array([values[name] for name in data.SETTINGS], dtype=np.float64)


def _scene(over: Takeover) -> FloatArray:
    p, model, car, v, m = over.triggered, over.model, over.vehicles, over.plant.v, over.m
    l_f, l_r = model.parameters.l_f, model.parameters.l_r
    A, B, E = car.matrices(v, model.convention)
    lateral = 2.0 * (car.C_af + car.C_ar) / car.m
    yaw = 2.0 * (car.C_af * l_f**2 + car.C_ar * l_r**2) / car.I_z
    steps = over.full_steps + over.settle + (over.rest > 0.0)
    columns = {
        data.START: over.start,
        data.T_END: p.T,
        data.FULL: over.full_steps,
        data.REST: over.rest,
        data.STEPS: steps,
        data.SIDE: p.side,
        data.INDEX: p.index,
        data.SPEED: v,
        data.V_MEAN: p.v_mean,
        data.A_MEAN: p.a_mean,
        data.C_0: p.c_0,
        data.DC: p.dc,
        data.DELTA_0: over.delta_0,
        data.FASTEST: np.maximum(lateral, yaw),
        data.C_AF: car.C_af,
        data.C_AR: car.C_ar,
        data.L_F: l_f,
        data.L_R: l_r,
        data.MASS: car.m,
        data.I_Z: car.I_z,
        data.MU: car.mu,
        data.PRINTED: 4.0 * car.C_ar * l_r / car.m if model.convention == "as_printed" else 0.0,
        data.CURVATURE_BIAS: _curvature_bias(over),
        data.B_1: B[:, 1],
        data.B_3: B[:, 3],
        data.E_1: E[:, 1],
        data.E_3: E[:, 3],
    }
    columns |= {first + j: A[:, i, j + 1] for first, i in ((data.A_11, 1), (data.A_31, 3)) for j in range(3)}
    tail = [over.driven.modes_v, _earlier_frames(over), _filter(over)]
    scene = np.zeros((m, data.SCENE + sum(part.shape[1] for part in tail)))
    for column, values in columns.items():
        scene[:, column] = values
    scene[:, data.X_0 : data.X_0 + 4] = over.x_0
    scene[:, data.SCENE :] = np.concatenate(tail, axis=1)
    return scene


def _curvature_bias(over: Takeover) -> FloatArray:
    """Constant error of the previewed curvature, outward."""
    sensors = over.options.sensors
    bias = np.full(over.m, sensors.curvature_bias)
    if sensors.curvature_noise > 0:
        bias += sensors.curvature_noise * normals(over.seed, over.triggered.index, RandomStream.CURVATURE, 1)[:, 0]
    return np.asarray(over.triggered.side * bias, dtype=np.float64)


def _earlier_frames(over: Takeover) -> FloatArray:
    """(e_y, e_psi) of the recorded path in the frames before the trigger that still reach the law, latest first."""
    sensors, dt = over.options.sensors, over.dt
    period, late = sensors.in_samples(dt)
    frames = np.zeros((over.m, 2 * -(-late // period)))
    for j in range(frames.shape[1] // 2):
        t = over.start - (j + 1) * period * dt
        frames[:, 2 * j] = over.driven.lateral(t) + over.model.parameters.edge_offset
        frames[:, 2 * j + 1] = np.arctan2(over.driven.lateral_rate(t), over.driven.speed(t))
    return frames


def _filter(over: Takeover) -> FloatArray:
    """The Kalman filter's gain and model; no columns without one."""
    sensors, step = over.options.sensors, over.plant.step
    if sensors.kalman is None:
        return np.zeros((over.m, 0))
    gain = filter_gain(over.plant, sensors.kalman, sensors.in_samples(over.dt)[0])
    parts = (gain.reshape(-1, 8), step.A.reshape(-1, 16), step.B, step.E_0, step.E_1)
    return np.concatenate(parts, axis=1)


def law_tables(laws: Sequence[LinearLaw], room: FloatArray | None = None) -> FloatArray:
    """Linear laws with equally many lookahead times for the compiled loops, (d, m, `data.LAW` + 2 p); into `room`."""
    shape = (len(laws), laws[0].F.shape[0], data.LAW + 2 * laws[0].preview_times.size)
    size = math.prod(shape)
    tables = np.empty(shape) if room is None else room[:size].reshape(shape)
    for table, law in zip(tables, laws, strict=True):
        table[:, data.LAW_F : data.LAW_U] = law.F
        table[:, data.LAW_U] = law.f_u
        table[:, data.LAW_I] = 0.0 if law.f_i is None else law.f_i
        table[:, data.LAW :: 2] = law.G_yaw_rate
        table[:, data.LAW + 1 :: 2] = law.G_heading
    return tables


def times_of(law: LinearLaw) -> FloatArray:
    """Lookahead times (p,) [s]."""
    return np.ascontiguousarray(law.preview_times, dtype=np.float64)
