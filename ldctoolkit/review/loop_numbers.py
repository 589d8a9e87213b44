"""Numbers of the linear loop over a range of speeds."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import numpy.typing as npt

from ldctoolkit.control import Controller
from ldctoolkit.plant_options import PlantOptions
from ldctoolkit.review.conditioning import hessian_condition
from ldctoolkit.review.law_model import LinearView
from ldctoolkit.review.margins import bandwidth, margins, poles
from ldctoolkit.review.sampled_loop import Camera, FloatArray, Loop, System, controller_side, sampled_vehicle
from ldctoolkit.vehicle import BicycleModel, Plant

MISMATCH = 0.2
"""Relative error of the cornering stiffness of each axle, up and down."""


@dataclasses.dataclass(frozen=True)
class LoopNumbers:
    """What the linear loop is like at n speeds; margins and bends are NaN where the closed loop is unstable.

    Attributes
    ----------
    v : (n,) [m/s]
    bend : (n,) [rad/s]
        Lane yaw rate of the steady bend.
    stable : (n,) bool
    radius : (n,)
        Largest |z| of the closed loop's poles.
    damping : (n,)
        Smallest damping ratio.
    slowest : (n,) [s]
        Longest time constant.
    gain_margin, gain_reduction_margin : (n,) [dB]
        Factor by which the gain may grow, and shrink.
    phase_margin : (n,) [rad]
    delay_margin : (n,) [s]
    disk_margin : (n,)
    crossover : (n,) [rad/s]
        Highest frequency at which the sampled loop's gain is 1.
    bandwidth : (n,) [rad/s]
        The same before sampling.
    e_y_bend : (n,) [m]
        Steady e_y in a bend, on the nominal vehicle.
    e_y_bend_mismatched : (n,) [m]
        The same with other cornering stiffness, the worst of the four corners; infinite where one is unstable.
    hessian_condition : (n,)
        Condition number of the condensed Hessian; NaN for a law that is no MPC.
    """

    v: FloatArray
    bend: FloatArray
    stable: npt.NDArray[np.bool_]
    radius: FloatArray
    damping: FloatArray
    slowest: FloatArray
    gain_margin: FloatArray
    gain_reduction_margin: FloatArray
    phase_margin: FloatArray
    delay_margin: FloatArray
    disk_margin: FloatArray
    crossover: FloatArray
    bandwidth: FloatArray
    e_y_bend: FloatArray
    e_y_bend_mismatched: FloatArray
    hessian_condition: FloatArray


def loop_numbers(
    controller: Controller, view: LinearView, plant: Plant, options: PlantOptions, bend: FloatArray
) -> LoopNumbers:
    """Every number at every speed of a plant.

    Parameters
    ----------
    controller : Controller
        The design.
    view : LinearView
        Its law as linear systems, finite.
    plant : Plant
        Nominal vehicle at n speeds.
    options : PlantOptions
        Actuator and camera are read.
    bend : (n,) [rad/s]
        Lane yaw rate of the steady bend.

    Returns
    -------
    LoopNumbers
    """
    dt, actuator = plant.dt, options.actuator
    A, B, E = plant.model.matrices(plant.v)
    cameras = _cameras(plant, options)
    others = [_with_stiffness(plant, front, rear) for front in (-1.0, 1.0) for rear in (-1.0, 1.0)]
    rows = []
    for i, law in enumerate(view.models):
        side = controller_side(law, cameras[i])
        loop = Loop.of(sampled_vehicle(A[i], B[i], E[i], dt, actuator), side)
        p = poles(loop.closed_A, dt)
        row: list[float] = [p.stable, p.radius, p.damping, p.slowest]
        if p.stable:
            m = margins(loop.open, dt)
            r = float(bend[i])
            row += [m.gain, m.gain_reduction, m.phase, m.delay, m.disk, m.crossover]
            row += [bandwidth(A[i], B[i], actuator.lag, side, dt), loop.steady_offset() * r]
            row += [_worst([(a[i], b[i], e[i]) for a, b, e in others], side, dt, options) * r]
        else:
            row += [math.nan] * 6 + [bandwidth(A[i], B[i], actuator.lag, side, dt)] + [math.nan] * 2
        rows.append(row)
    columns = np.array(rows, dtype=float).T
    condition = hessian_condition(controller, plant)
    names = [field.name for field in dataclasses.fields(LoopNumbers)][3:-1]
    return LoopNumbers(
        v=plant.v.copy(),
        bend=bend,
        stable=columns[0].astype(bool),
        hessian_condition=condition,
        **dict(zip(names, columns[1:], strict=True)),
    )


def _worst(
    vehicles: list[tuple[FloatArray, FloatArray, FloatArray]], side: System, dt: float, options: PlantOptions
) -> float:
    """Largest steady offset per lane yaw rate on some vehicles, with its sign; infinite if one of them is unstable."""
    offsets = []
    for A, B, E in vehicles:
        loop = Loop.of(sampled_vehicle(A, B, E, dt, options.actuator), side)
        offsets.append(loop.steady_offset() if poles(loop.closed_A, dt).stable else math.inf)
    return max(offsets, key=abs)


def _with_stiffness(plant: Plant, front: float, rear: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Continuous-time matrices of the vehicle on other tyres."""
    p = plant.model.parameters
    other = dataclasses.replace(p, C_af=p.C_af * (1.0 + front * MISMATCH), C_ar=p.C_ar * (1.0 + rear * MISMATCH))
    return BicycleModel(other, plant.model.convention).matrices(plant.v)


def _cameras(plant: Plant, options: PlantOptions) -> list[Camera]:
    """The camera at each speed; a period of p samples ages a frame by up to p - 1 more, half of it on average."""
    sensors = options.sensors
    period, delay = sensors.in_samples(plant.dt)
    delay += math.ceil((period - 1) / 2)
    gains: list[FloatArray | None] = [None] * plant.n
    if sensors.kalman is not None:
        from ldctoolkit.simulation.kalman import filter_gain

        gains = list(filter_gain(plant, sensors.kalman, 1))
    step = plant.step
    return [Camera(delay, gains[i], step.A[i], step.B[i], step.E_0[i] + step.E_1[i]) for i in range(plant.n)]
