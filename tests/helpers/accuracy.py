"""Random departures with each plant option, whose S and metrics are compared with the independent closed loop."""

import dataclasses
from typing import Any

import numpy as np

from helpers import reference_loop as reference
from ldctoolkit import LinearLaw, Scenarios, Setup, simulate
from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.control import EventStatus
from ldctoolkit.controllers import LQR, PreviewProportional
from ldctoolkit.paths.uncorrected import RandomStream, UncorrectedPath, uniforms
from ldctoolkit.plant_options import Actuator, KalmanFilter, Mismatch, PlantOptions, Residuals, Sensors, Tyres
from ldctoolkit.simulation import Takeover

from .closed_loop import METRICS, Prepared

SEED, Y_S, DT, SETTLE = 3, 0.1, 0.05, 0.5
NAMES = tuple(name for name in METRICS if "added" not in name)

STEERING = Actuator(delta_max=0.05, rate_max=0.35, lag=0.07, delay=0.083)
SHARP = Actuator(delta_max=0.2, rate_max=0.8, lag=0.04, delay=0.033)
LOCK = Actuator(delta_max=0.3)  # as far as the wheels of a car turn, or not much less
DRAWN = Mismatch(m=(0.8, 1.4), I_z=(0.9, 1.2), C_af=(0.7, 1.0), C_ar=(0.8, 1.2))
CAMERA = Sensors(e_y_bias=0.02, period=2 * DT, delay=DT, curvature_gain=0.1, kalman=KalmanFilter())
RESIDUALS = Residuals(y=True, v=True, bandwidth=2.0)
TYRES = Tyres(model="magic_formula", mu=0.9)
ICE = Tyres(model="magic_formula", mu=0.3, shape=1.6)
ANY_MU = Mismatch(mu=(1 / 3, 1.0))

CASES = {
    "linear": PlantOptions(),
    "lag": PlantOptions(actuator=Actuator(lag=0.12)),
    "actuator": PlantOptions(actuator=dataclasses.replace(STEERING, delay=0.0)),
    "delay of two samples": PlantOptions(actuator=Actuator(delay=2 * DT)),
    "delay between samples": PlantOptions(actuator=Actuator(delay=0.073)),
    "profile": PlantOptions(speed="profile"),
    "profile, residuals": PlantOptions(speed="profile", residuals=RESIDUALS),
    "tyres": PlantOptions(tyres=TYRES, mismatch=ANY_MU, actuator=LOCK),
    "tyres, mu 0.3": PlantOptions(tyres=ICE, actuator=LOCK),
    "tyres, profile, actuator": PlantOptions(tyres=TYRES, mismatch=ANY_MU, speed="profile", actuator=SHARP),
    "mismatch": PlantOptions(mismatch=DRAWN),
    "as printed": PlantOptions(),
    "camera": PlantOptions(sensors=Sensors(fps=30, delay=0.07)),
    "camera, filter": PlantOptions(sensors=CAMERA),
    "all, linear tyres": PlantOptions(
        speed="profile", actuator=STEERING, mismatch=DRAWN, sensors=CAMERA, residuals=RESIDUALS
    ),
    "all": PlantOptions(
        speed="profile", actuator=SHARP, mismatch=dataclasses.replace(DRAWN, mu=(1 / 3, 1.0)), tyres=TYRES,
        sensors=CAMERA, residuals=RESIDUALS,
    ),
}  # fmt: skip


def _times(factor: float, law: LinearLaw) -> LinearLaw:
    return dataclasses.replace(law, F=factor * law.F)


LAWS = (
    LQR(r_delta=100.0), PreviewProportional(), Prepared(lambda plant: LQR(r_delta=3.0).prepare(plant)),
)  # fmt: skip
# on saturating tyres: so hard that the slips pass the peak of the force
HARD = (
    LQR(r_delta=0.3), Prepared(lambda plant: _times(4.0, PreviewProportional().prepare(plant))), LQR(r_delta=30.0),
)  # fmt: skip


def setup(case: str) -> Setup:
    convention: Any = "as_printed" if case == "as printed" else "consistent"
    return Setup(convention=convention, options=CASES[case], dt=DT, settle=SETTLE, seed=SEED)


def departures(case: str, n: int, seed: int = 0) -> Scenarios:
    """At 6 to 60 m/s in bends, braking and accelerating, 0.5 to 8 s long; the first n are the same for every n.

    When they start, they need 70 % of the friction at most."""
    options = CASES[case]
    most = 5.0 if options.tyres.ideal else min(5.0, 9.81 * options.tyres.mu * options.mismatch.mu[0])
    u = np.array([np.random.default_rng([seed, i]).random(10) for i in range(n)]).T
    v, T, widest = 6.0 * 10.0 ** u[0], 0.5 * 16.0 ** u[1], 0.5 * most / 8.0
    d_y = 0.12 + u[2] * (np.minimum(1.2, widest * T**2) - 0.12).clip(0.0)
    T = np.maximum(T, np.sqrt(d_y / widest))
    bend = (0.4 * u[3] - 0.2) * most / v**2
    return Scenarios.from_arrays(
        side=np.where(u[4] < 0.5, -1, 1), T=T, d_y=d_y, v_mean=v, c_0=bend, dc=(1.2 * u[6] - 1.0) * bend,
        a_mean=(2.0 * u[5] - 1.0) * np.minimum(4.0, 0.6 * v / T), sigma_y=3e-3 * u[7], sigma_v=0.2 * u[8],
    )  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Expected:
    """What the reference says of one departure."""

    lost: bool
    """Beyond the bound, or spun: nothing else is compared."""

    values: FloatArray  # S, then the metrics in the order of `NAMES`
    slip: float  # Largest slip at a sample over the slip at the peak of the force; 0 on linear tyres


def expected(case: str, scenarios: Scenarios, i: int, law: reference.Law) -> Expected:
    """Of scenario i, with the package's draws."""
    options = CASES[case]
    a, b = (), ()
    if not options.residuals.ideal:
        uncorrected = UncorrectedPath.of(scenarios, options.residuals, SEED)
        a, b = tuple(uncorrected.modes_y[i]), tuple(uncorrected.modes_v[i])
    nominal = reference.Vehicle(mu=options.tyres.mu, as_printed=case == "as printed")
    names = [field.name for field in dataclasses.fields(Mismatch)]
    draws = uniforms(SEED, scenarios.index, RandomStream.MISMATCH, len(names))[i]
    ranges = [getattr(options.mismatch, name) for name in names]
    true = nominal.times(**{n: low + (high - low) * u for n, (low, high), u in zip(names, ranges, draws, strict=True)})
    path = reference.Path.of(scenarios, i, a, b)
    try:
        out = reference.drive(
            path, law, options=options, vehicle=nominal, true=true, y_s=Y_S, dt=DT, settle=SETTLE, rtol=5e-13
        )
    except reference.LostError:
        return Expected(True, np.full(1 + len(NAMES), np.nan), np.inf)
    return Expected(
        False, np.array([out.S, *(out.metrics[name] for name in NAMES)]), _largest_slip(options, path, true, out)
    )


def _largest_slip(options: PlantOptions, path: reference.Path, p: reference.Vehicle, out: reference.Drive) -> float:
    if options.tyres.ideal or out.t.size == 0:
        return 0.0
    t = np.minimum(out.t, path.T)
    v = path.v(np.full_like(t, out.t_s) if options.speed == "frozen" else t)
    _, rate, psi, turn = path.side * out.x.T
    across, omega = (rate - v * np.sin(psi)) / np.cos(psi), turn + v * path.c(t)
    C, L = options.tyres.shape, p.l_f + p.l_r
    peak = np.tan(0.5 * np.pi / C) * C * p.mu * p.m * reference.G / (2 * L)  # times C_a/arm
    front = path.side * out.delta - np.arctan2(across + p.l_f * omega, v)
    rear = np.arctan2(across - p.l_r * omega, v)
    return float(max(np.abs(front).max() / (peak * p.l_r / p.C_af), np.abs(rear).max() / (peak * p.l_f / p.C_ar)))


def driven(case: str, scenarios: Scenarios) -> tuple[FloatArray, BoolArray]:
    """What the package makes of them: S and metrics (n, k), and which diverged."""
    values, lost = np.zeros((scenarios.n, 1 + len(NAMES))), np.zeros(scenarios.n, dtype=np.bool_)
    for rows, design in _by_law(case, scenarios):
        out = simulate(design, scenarios.take(rows), y_s=Y_S, setup=setup(case))
        values[rows] = np.column_stack([out.S, *(getattr(out.metrics, name) for name in NAMES)])
        lost[rows] = out.status == EventStatus.DIVERGED
    return values, lost


def prepared(case: str, scenarios: Scenarios) -> dict[int, tuple[LinearLaw, int]]:
    """The law of each scenario that triggers, and its row in it."""
    found = {}
    for rows, design in _by_law(case, scenarios):
        over = Takeover.build(scenarios.take(rows), setup(case), y_s=Y_S)
        law = design.prepare(over.plant)
        found |= {int(rows[i]): (law, j) for j, i in enumerate(over.rows)}
    return found


def _by_law(case: str, scenarios: Scenarios) -> list[tuple[IntArray, Any]]:
    designs = LAWS if CASES[case].tyres.ideal else HARD
    return [
        (rows, design) for k, design in enumerate(designs) if (rows := np.flatnonzero(scenarios.index % 3 == k)).size
    ]


def differences(values: FloatArray, expected: FloatArray) -> FloatArray:
    """Of S [m s], and of each metric over the larger of 1 and its value."""
    with np.errstate(invalid="ignore"):
        apart = np.where(values == expected, 0.0, np.abs(values - expected))
    size = np.where(np.isfinite(expected), np.abs(expected), 1.0)
    size[:, 0] = 1.0
    return apart / np.maximum(1.0, size)
