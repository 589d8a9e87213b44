"""From a takeover and a law to the arrays that the compiled loops read and write."""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import Self

import numpy as np
import numpy.typing as npt

from ldctoolkit.control import LinearLaw
from ldctoolkit.simulation.kalman import filter_gain
from ldctoolkit.simulation.kernel.data import SCORES, Camera, Designs, Exact, Law, Paths, Scene, Setting, State
from ldctoolkit.simulation.random_streams import RandomStream, normals
from ldctoolkit.simulation.takeover import Takeover
from ldctoolkit.vehicle import discretize

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

BOUND = 20.0
"""|e_y| [m] at which a scenario counts as diverged; from there on the bound itself is scored, so S stays finite."""

JERK_WINDOW = 0.5
"""Moving average [s] of the lateral jerk (ISO 11270)."""


@dataclasses.dataclass(frozen=True)
class Tables:
    """A takeover as the compiled loops see it.

    Attributes
    ----------
    over : Takeover
    setting : Setting
    scene : Scene
    camera : Camera
    """

    over: Takeover
    setting: Setting
    scene: Scene
    camera: Camera

    @classmethod
    def of(cls, over: Takeover) -> Self:
        """Everything that designs share."""
        from ldctoolkit.simulation.kernel import entry

        setting = _setting(over)
        scene = _scene(over)
        entry.before(scene, setting, scene.a_before)
        return cls(over, setting, scene, _camera(over))

    @functools.cached_property
    def exact(self) -> Exact:
        """The ideal plant over a whole step."""
        over = self.over
        if over.options.mismatch.ideal:
            step = over.plant.step
        else:
            step = discretize(*over.vehicles.matrices(over.plant.v, over.model.convention), over.dt)
        return Exact(
            **{name: np.ascontiguousarray(getattr(step, name), dtype=np.float64) for name in Exact._fields}
        )

    def state(self) -> State:
        """Empty working arrays of one run."""
        m, camera, setting = self.over.m, self.camera, self.setting
        frames = 1 if camera.ideal else camera.delay + camera.period + 1
        ring = math.ceil(setting.window) + 3
        return State(
            x=np.zeros((m, 4)),
            wheel=np.zeros(m),
            command=np.zeros(m),
            commands=np.zeros((m, setting.delay_samples + 2)),
            frames=np.zeros((m, frames, 2)),
            estimate=np.zeros((m, 4)),
            a_left=np.zeros((m, ring)),
            a_right=np.zeros((m, ring)),
            score=np.zeros((m, SCORES)),
            alive=np.zeros(m, dtype=np.bool_),
            diverged=np.zeros(m, dtype=np.bool_),
            failed=np.zeros(m, dtype=np.int64),
        )

    def paths(self, chosen: IntArray) -> Paths:
        """Room for the paths of the scenarios `chosen` (c,), by their place among the m."""
        slot = np.full(self.over.m, -1, dtype=np.int64)
        slot[chosen] = np.arange(chosen.size)
        longest = int(self.scene.steps[chosen].max(initial=0)) + 2
        shape = (chosen.size, longest)
        count = np.zeros(chosen.size, dtype=np.int64)
        return Paths(slot, count, np.full(shape, np.nan), np.full((*shape, 4), np.nan), np.full(shape, np.nan))


def _setting(over: Takeover) -> Setting:
    actuator = over.options.actuator
    samples = math.floor(actuator.delay / over.dt + 1e-9)
    part = actuator.delay - samples * over.dt
    return Setting(
        dt=over.dt,
        offset=over.model.parameters.edge_offset,
        l_f=over.model.parameters.l_f,
        bound=BOUND,
        window=JERK_WINDOW / over.dt,
        profile=over.options.speed == "profile",
        saturating=not over.options.tyres.ideal,
        shape=over.options.tyres.shape,
        delta_max=math.inf if actuator.delta_max is None else actuator.delta_max,
        rate_max=math.inf if actuator.rate_max is None else actuator.rate_max,
        lag=actuator.lag,
        delay_samples=samples,
        delay_part=part if part > 1e-9 * over.dt else 0.0,
    )


def _scene(over: Takeover) -> Scene:
    p, model = over.triggered, over.model
    v = np.ascontiguousarray(over.plant.v)
    A, B, E = over.vehicles.matrices(v, model.convention)
    car = over.vehicles
    m, l_f, l_r = over.m, model.parameters.l_f, model.parameters.l_r
    columns = (car.C_af, car.C_ar, l_f, l_r, car.m, car.I_z, car.mu)
    printed = 4.0 * car.C_ar * l_r / car.m if model.convention == "as_printed" else 0.0
    vehicle = np.column_stack([np.broadcast_to(column, m) for column in (*columns, printed)])
    linear = np.column_stack([*(A[:, i, j] for i in (1, 3) for j in (1, 2, 3)), B[:, 1], B[:, 3], E[:, 1], E[:, 3]])
    lateral = 2.0 * (car.C_af + car.C_ar) / car.m
    yaw = 2.0 * (car.C_af * l_f**2 + car.C_ar * l_r**2) / car.I_z
    full, rest = over.full_steps, over.rest
    return Scene(
        start=over.start,
        T=np.ascontiguousarray(p.T),
        full=full,
        rest=rest,
        steps=full + over.settle + (rest > 0.0),
        side=p.side.astype(np.float64),
        index=np.ascontiguousarray(p.index),
        v=v,
        v_mean=np.ascontiguousarray(p.v_mean),
        a_mean=np.ascontiguousarray(p.a_mean),
        c_0=np.ascontiguousarray(p.c_0),
        dc=np.ascontiguousarray(p.dc),
        modes_v=np.ascontiguousarray(over.driven.modes_v),
        linear=np.ascontiguousarray(linear),
        vehicle=np.ascontiguousarray(vehicle),
        fastest=np.ascontiguousarray(np.broadcast_to(np.maximum(lateral, yaw), m)),
        x_0=np.ascontiguousarray(over.x_0),
        delta_0=np.ascontiguousarray(over.delta_0),
        a_before=np.zeros(m),
    )


def _camera(over: Takeover) -> Camera:
    sensors, dt, m = over.options.sensors, over.dt, over.m
    period = max(1, round(sensors.period / dt))
    delay = round(sensors.delay / dt)
    side = over.triggered.side.astype(np.float64)
    bias = np.full(m, sensors.curvature_bias)
    if sensors.curvature_noise > 0:
        bias += sensors.curvature_noise * normals(over.seed, over.triggered.index, RandomStream.CURVATURE, 1)[:, 0]
    earlier = np.zeros((m, -(-delay // period), 2))
    for j in range(earlier.shape[1]):
        t = over.start - (j + 1) * period * dt
        earlier[:, j, 0] = over.driven.lateral(t) + over.model.parameters.edge_offset
        earlier[:, j, 1] = np.arctan2(over.driven.lateral_rate(t), over.driven.speed(t))
    kalman = sensors.kalman
    step = over.plant.step
    filtered = kalman is not None
    rows = m if filtered else 0
    return Camera(
        ideal=sensors.ideal,
        period=period,
        delay=delay,
        noise=np.array([sensors.e_y_noise, sensors.e_psi_noise]),
        bias=np.array([sensors.e_y_bias, sensors.e_psi_bias]),
        step=np.array([sensors.e_y_step, sensors.e_psi_step]),
        earlier=earlier,
        curvature_gain=sensors.curvature_gain,
        curvature_bias=side * bias,
        seed=over.seed,
        filtered=filtered,
        gain=np.zeros((0, 4, 2)) if kalman is None else np.ascontiguousarray(filter_gain(over.plant, kalman, period)),
        A=np.ascontiguousarray(step.A[:rows]),
        B=np.ascontiguousarray(step.B[:rows]),
        E_0=np.ascontiguousarray(step.E_0[:rows]),
        E_1=np.ascontiguousarray(step.E_1[:rows]),
    )


def law_table(law: LinearLaw) -> Law:
    """A linear law for the compiled loops."""
    columns = (law.F, law.preview_times, law.G_yaw_rate, law.G_heading, law.f_u)
    return Law(*(np.ascontiguousarray(column, dtype=np.float64) for column in columns))


def designs_table(laws: list[LinearLaw]) -> Designs:
    """Linear laws with equally many lookahead times, side by side."""

    def stack(name: str) -> FloatArray:
        return np.ascontiguousarray(np.stack([getattr(law, name) for law in laws]), dtype=np.float64)

    return Designs(stack("F"), stack("preview_times"), stack("G_yaw_rate"), stack("G_heading"), stack("f_u"))
