"""Closed-loop benchmark: the compiled loops against plain references, as ratios from one run.

References, written here in full: a vectorised NumPy loop over time steps, one array a quantity, of the same law on the
same plant, with S alone or with all metrics; one `control.forced_response` call a scenario on the closed loop as a
discrete-time system. Times are the best of several runs; a design's own preparation is in both of a pair, what designs
share in neither. Printed with `make bench` as the table that `docs/explanation/benchmarks.md` keeps; `--memory`
measures the memory of 1,000 designs and is called by the script itself. The linear MPC has a script of its own."""

import dataclasses
import importlib.metadata
import platform
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import control
import numpy as np
from history import processor, report

from ldctoolkit import Controller, EventStatus, LinearLaw, Plant, Scenarios, Setup, SteeringLaw
from ldctoolkit.controllers import LQR, PreviewProportional
from ldctoolkit.plant_options import Actuator, Driver, KalmanFilter, Mismatch, PlantOptions, Sensors, Tyres
from ldctoolkit.simulation import Takeover, drive, drive_many
from ldctoolkit.surroundings import usable_cores

SCENARIOS, DESIGNS = 10_000, 1_000


def scenarios(n: int) -> Scenarios:
    rng = np.random.default_rng(0)
    v = np.where(rng.random(n) < 0.5, rng.normal(14, 2, n), rng.normal(28, 3, n)).clip(12)
    return Scenarios.from_arrays(
        T=np.exp(rng.normal(np.log(2), 0.6, n)).clip(0.5, 10),
        d_y=np.exp(rng.normal(np.log(0.3), 0.5, n)).clip(0.02, 1.0), v_mean=v,
        a_mean=rng.normal(0, 0.3, n).clip(-0.6, 0.6), c_0=rng.normal(0, 0.5, n) / v**2,
    )  # fmt: skip


def seconds(run: Callable[[], object], repeats: int) -> float:
    """Best of several runs after a warm-up."""
    run()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return min(times)


def linear_law(design: Controller, over: Takeover) -> LinearLaw:
    law = design.prepare(over.plant)
    if not isinstance(law, LinearLaw):
        raise TypeError(design.name)
    return law


def numpy_tables(over: Takeover) -> Any:
    """What designs share in `numpy_loop`, worked out once and outside the timing, as on our side."""

    def columns(step):
        matrix = [[np.ascontiguousarray(step.A[:, i, j]) for j in (1, 2, 3)] for i in range(4)]
        vectors = [[np.ascontiguousarray(a[:, i]) for i in range(4)] for a in (step.B, step.E_0, step.E_1, step.area_x)]
        return (*vectors, matrix, step.area_delta.copy(), step.area_r_0.copy(), step.area_r_1.copy())

    v = over.plant.v
    A, B, E = over.setup.model.matrices(v)
    lateral = *(np.ascontiguousarray(A[:, 1, j]) for j in (1, 2, 3)), np.ascontiguousarray(B[:, 1]), E[:, 1] + v
    return columns(over.plant.step), columns(over.setup.model.discretize(v, over.rest)), lateral


def numpy_loop(design: Controller, over: Takeover, tables: Any, *, metrics: bool) -> np.ndarray:
    """S of every triggered scenario over [t_s, T], and on demand what the kernel reports beside it, in NumPy. Struct of
    arrays: a column of length m for every number, scenarios sorted so that those still driven come first. A step in
    which e_y changes its sign is split by a straight line. Without metrics the loop ends at T."""
    law = linear_law(design, over)
    dt, v, p = over.setup.dt, over.plant.v, over.triggered
    edge, l_f = over.setup.vehicle.edge_offset, over.setup.vehicle.l_f

    whole, last, (a_1, a_2, a_3, b_1, e_1) = tables
    F = [np.ascontiguousarray(law.F[:, i]) for i in range(4)]
    uses_rate, uses_turn = bool(np.any(law.G_yaw_rate)), bool(np.any(law.G_heading))
    m = over.m
    x = [over.x_0[:, i].copy() for i in range(4)]
    u, S = over.delta_0.copy(), np.zeros(m)
    steps = over.full_steps + (round(over.setup.settle / over.setup.dt) if metrics else 0)
    if metrics:
        deep, front, over_line = x[0].copy(), x[0] + l_f * x[2], -x[0]
        back, peak, jerk, angle, rate, effort, travel = (np.zeros(m) for _ in range(7))
        size = round(0.5 / dt)
        before = a_1 * x[1] + a_2 * x[2] + a_3 * x[3] + b_1 * u + e_1 * v * (p.c_0 + p.dc * over.start / p.T)
        past = [[before.copy(), before.copy()] for _ in range(size)]

    def lane(t, n):
        return v[:n] * (p.c_0[:n] + p.dc[:n] * np.minimum(t / p.T[:n], 1.0))

    def turned(t, n):
        inside = np.minimum(t, p.T[:n])
        return p.c_0[:n] * t + p.dc[:n] * (0.5 * inside**2 / p.T[:n] + (t - inside))

    def advance(n, t, h, table, counted, k):
        nonlocal x, u
        b, e_0, e_h, area, matrix, area_delta, area_0, area_h = table
        y = [column[:n] for column in x]
        r_0, r_1 = lane(t, n), lane(t + h, n)
        d = F[0][:n] * y[0] + F[1][:n] * y[1] + F[2][:n] * y[2] + F[3][:n] * y[3]
        for j, ahead in enumerate(law.preview_times):
            if uses_rate:
                d += law.G_yaw_rate[:n, j] * lane(t + ahead, n)
            if uses_turn:
                d += law.G_heading[:n, j] * (v[:n] * (turned(t + ahead, n) - turned(t, n)))
        new = [
            matrix[i][0][:n] * y[1] + matrix[i][1][:n] * y[2] + matrix[i][2][:n] * y[3]
            + b[i][:n] * d + e_0[i][:n] * r_0 + e_h[i][:n] * r_1
            for i in range(4)
        ]  # fmt: skip
        new[0] += y[0]
        if np.any(counted):
            signed = area[0][:n] * y[0] + area[1][:n] * y[1] + area[2][:n] * y[2] + area[3][:n] * y[3]
            signed += area_delta[:n] * d + area_0[:n] * r_0 + area_h[:n] * r_1
            part = np.abs(signed)
            rows = np.flatnonzero(y[0] * new[0] < 0)
            if rows.size:
                share = y[0][rows] / (y[0][rows] - new[0][rows])
                hs = h if np.ndim(h) == 0 else h[rows]
                part[rows] = 0.5 * hs * (share * np.abs(y[0][rows]) + (1 - share) * np.abs(new[0][rows]))
            S[:n] += np.where(counted, part, 0.0)
        if metrics:
            a_right = a_1[:n] * y[1] + a_2[:n] * y[2] + a_3[:n] * y[3] + b_1[:n] * d + e_1[:n] * r_0
            a_left = a_1[:n] * new[1] + a_2[:n] * new[2] + a_3[:n] * new[3] + b_1[:n] * d + e_1[:n] * r_1
            np.maximum(deep[:n], np.where(counted, new[0], -np.inf), out=deep[:n])
            np.maximum(front[:n], np.where(counted, new[0] + l_f * new[2], -np.inf), out=front[:n])
            np.maximum(over_line[:n], -new[0], out=over_line[:n])
            came = (back[:n] == 0) & (y[0] >= edge) & (new[0] < edge)
            back[:n] = np.where(came, t + h * (y[0] - edge) / (y[0] - new[0]), back[:n])
            np.maximum(peak[:n], np.maximum(np.abs(a_right), np.abs(a_left)), out=peak[:n])
            old = past[k % size]
            change = np.maximum(np.abs(a_right - old[0][:n]), np.abs(a_left - past[(k + 1) % size][1][:n]))
            np.maximum(jerk[:n], change / 0.5, out=jerk[:n])
            old[0][:n], past[(k + 1) % size][1][:n] = a_right, a_left
            np.maximum(angle[:n], np.abs(d), out=angle[:n])
            turn = np.abs(d - u[:n])
            np.maximum(rate[:n], turn / dt, out=rate[:n])
            effort[:n] += d * d * h
            travel[:n] += turn
        for column, value in zip(x, new, strict=True):
            column[:n] = value
        u[:n] = d

    counts = np.searchsorted(-steps, -np.arange(int(steps[0])), side="left")
    for k, n in enumerate(counts):
        counted = k < over.full_steps[:n]
        advance(int(n), over.start[:n] + k * dt, dt, whole, counted, k)
    if not metrics:  # the horizon's last, shorter step would come here too
        advance(m, over.start + over.full_steps * dt, over.rest, last, np.ones(m, dtype=bool), 0)
    return S


def forced_response_loop(design: Controller, over: Takeover, rows: range) -> None:
    """One `control.forced_response` call a scenario, on the closed loop sampled with dt, from the trigger to T."""
    law = linear_law(design, over)
    dt, step = over.setup.dt, over.plant.step
    for i in rows:
        gains = np.concatenate([law.G_yaw_rate[i], law.G_heading[i]])
        closed = step.A[i] + np.outer(step.B[i], law.F[i])
        inputs = np.column_stack([np.outer(step.B[i], gains), step.E_0[i], step.E_1[i]])
        t = over.start[i] + dt * np.arange(int(over.full_steps[i]) + 1)
        v, p, T = over.plant.v[i], over.triggered, over.triggered.T[i]

        def r(at, v=v, p=p, T=T, i=i):
            return v * (p.c_0[i] + p.dc[i] * np.minimum(at / T, 1.0))

        def turned(at, v=v, p=p, T=T, i=i):
            inside = np.minimum(at, T)
            return v * (p.c_0[i] * at + p.dc[i] * (0.5 * inside**2 / T + at - inside))

        rates = [r(t + ahead) for ahead in law.preview_times]
        turns = [turned(t + ahead) - turned(t) for ahead in law.preview_times]
        system = control.ss(closed, inputs, np.eye(4), np.zeros((4, inputs.shape[1])), dt)
        if t.size > 1:
            control.forced_response(system, None, np.array([*rates, *turns, r(t), r(t + dt)]), over.x_0[i])


@dataclasses.dataclass(frozen=True)
class Stepped(Controller):
    """A linear law as any other law: through `SteeringLaw.step`."""

    name = "stepped"
    title = "Stepped"
    inner: Controller = dataclasses.field(default_factory=LQR)

    def prepare(self, plant: Plant) -> SteeringLaw:
        law = self.inner.prepare(plant)
        if not isinstance(law, LinearLaw):
            raise TypeError(self.inner.name)
        return SteppedLaw(law)


@dataclasses.dataclass(frozen=True)
class SteppedLaw(SteeringLaw):
    law: LinearLaw

    @property
    def preview_times(self) -> np.ndarray:
        return self.law.preview_times

    def init(self, n: int) -> None:
        return None

    def step(self, t, x, preview, delta_prev, state):
        law = self.law
        delta = (law.F * x).sum(axis=1) + (law.G_yaw_rate * preview.yaw_rate).sum(axis=1)
        delta += (law.G_heading * preview.heading).sum(axis=1) + law.f_u * delta_prev
        return delta, state, np.zeros(delta.size, dtype=np.int8)

    def take(self, rows, state):
        law = self.law
        cut = LinearLaw(law.F[rows], law.preview_times, law.G_yaw_rate[rows], law.G_heading[rows], law.f_u[rows])
        return SteppedLaw(cut), state


REAL = PlantOptions(
    speed="profile",
    actuator=Actuator(delta_max=0.5, rate_max=0.4, lag=0.1, delay=0.12),
    mismatch=Mismatch(m=(0.9, 1.3), C_af=(0.8, 1.1), C_ar=(0.8, 1.1), mu=(0.4, 1.0)),
    tyres=Tyres(model="magic_formula"),
    sensors=Sensors(e_y_noise=0.03, e_psi_noise=0.003, delay=0.1, period=0.1, kalman=KalmanFilter()),
)
OPTIONS = {
    "actuator: lag, rate limit, delay": PlantOptions(actuator=REAL.actuator),
    "camera with noise and Kalman filter": PlantOptions(sensors=REAL.sensors),
    "speed profile": PlantOptions(speed="profile"),
    "saturating tyres": PlantOptions(tyres=REAL.tyres),
    "all of these and mismatch": REAL,
    "the same with the arms of a driver": dataclasses.replace(
        REAL, driver=Driver(model="arms", straight=0.4, recorded=0.4, against=0.2)
    ),
}


def measure_memory() -> None:
    """Run 1,000 designs on 10,000 scenarios, keep every per-scenario number, and print seconds and peak memory."""
    over = Takeover.build(scenarios(SCENARIOS), Setup(), y_s=0.1)
    list(drive_many([PreviewProportional()], over))
    gains = np.linspace(-0.05, -0.001, DESIGNS)
    start = time.perf_counter()
    kept = []
    for run in drive_many((PreviewProportional(K_y=float(K_y)) for K_y in gains), over):
        outcome = run.outcome("departure")
        metrics = [getattr(outcome.metrics, f.name) for f in dataclasses.fields(outcome.metrics)]
        kept.append((outcome.S, outcome.status, outcome.failed_solves, np.array(metrics, dtype=np.float32)))
    elapsed = time.perf_counter() - start
    if len(kept) != DESIGNS or not np.isfinite(sum(S.sum() for S, *_ in kept)):
        raise RuntimeError("the designs were not all driven")
    print(elapsed, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0)


def header() -> None:
    print(machine("numpy", "numba", "control", "scipy"))
    print()
    print("| case | ours [ms] | reference [ms] | ratio |")
    print("| --- | ---: | ---: | ---: |")


def machine(*packages: str) -> str:
    """Processor, cores and versions of the packages, as a sentence."""
    shown = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in packages)
    return f"{processor()}, {usable_cores()} cores; Python {platform.python_version()}, {shown}."


def check(ours: np.ndarray | None, theirs: np.ndarray) -> None:
    """The reference does the same work: S to what a straight line through a change of sign costs."""
    if ours is None or not np.allclose(ours, theirs, rtol=0, atol=2e-4):
        raise RuntimeError("the reference does not give the same S")


def row(case: str, ours: float, theirs: float) -> None:
    print(f"| {case} | {1e3 * ours:.2f} | {1e3 * theirs:.1f} | {theirs / ours:.1f} |", flush=True)
    report(case, theirs / ours)


def main() -> None:
    if sys.argv[1:] == ["--memory"]:
        measure_memory()
        return
    header()
    many = scenarios(SCENARIOS)
    event = Takeover.build(many, Setup(settle=0.0), y_s=0.1)
    whole = Takeover.build(many, Setup(), y_s=0.1)
    event_tables, whole_tables = numpy_tables(event), numpy_tables(whole)
    for design in (PreviewProportional(), LQR(r_delta=100.0)):
        check(drive(design, event).area, numpy_loop(design, event, event_tables, metrics=False))
        name = f"{design.name}, {SCENARIOS:,} scenarios"
        for over in (event, whole):
            drive(design, over)
        ours = seconds(lambda design=design: drive(design, event), 20)
        theirs = seconds(lambda design=design: numpy_loop(design, event, event_tables, metrics=False), 3)
        row(f"{name}, to T, all metrics, vs NumPy loop with S alone", ours, theirs)
        few = range(0, event.m, 50)
        calls = seconds(lambda design=design, few=few: forced_response_loop(design, event, few), 2)
        forced = event.m / len(few) * calls
        row(f"{name}, to T, all metrics, vs control.forced_response", ours, forced)
        ours = seconds(lambda design=design: drive(design, whole), 20)
        theirs = seconds(lambda design=design: numpy_loop(design, whole, whole_tables, metrics=True), 3)
        row(f"{name}, to T + 3 s, vs NumPy loop with all metrics", ours, theirs)
        together = [design] * 20
        ours = seconds(lambda together=together: list(drive_many(together, whole)), 3) / len(together)
        row(f"{name}, to T + 3 s, a design of 20 in one call, vs the same", ours, theirs)
        ours = seconds(lambda together=together: list(drive_many(together, event)), 5) / len(together)
        theirs = seconds(lambda design=design: numpy_loop(design, event, event_tables, metrics=False), 3)
        row(f"{name}, to T, all metrics, a design of 20 in one call, vs NumPy loop with S alone", ours, theirs)
        row(f"{name}, the same, vs control.forced_response", ours, forced)

    print("\nWhat other loops and plants cost: LQR, 10,000 scenarios, to T + 3 s, against the ideal plant in lanes.\n")
    print("| case | ms | times the ideal |")
    print("| --- | ---: | ---: |")
    ideal = seconds(lambda: drive(LQR(r_delta=100.0), whole), 10)
    print(f"| ideal plant | {1e3 * ideal:.2f} | 1.0 |")
    cost = seconds(lambda: drive(Stepped(), whole), 2)
    print(f"| ideal plant, the law called step by step | {1e3 * cost:.1f} | {cost / ideal:.1f} |")
    for name, options in OPTIONS.items():
        real = Takeover.build(many, Setup(options=options), y_s=0.1)
        run = drive(LQR(r_delta=100.0), real)
        cost = seconds(lambda real=real: drive(LQR(r_delta=100.0), real), 2)
        lost = int((run.status == EventStatus.DIVERGED).sum())
        print(
            f"| {name} | {1e3 * cost:.1f} | {cost / ideal:.1f} |" + (f" <!-- {lost} diverged -->" if lost else ""),
            flush=True,
        )
    for name, plant in (("ideal plant", PlantOptions()), ("all options", REAL)):
        cost = seconds(lambda plant=plant: Takeover.build(many, Setup(options=plant), y_s=0.1).scene, 2)
        print(f"| takeover, once for all designs: {name} | {1e3 * cost:.1f} | {cost / ideal:.1f} |")

    answer = subprocess.run([sys.executable, __file__, "--memory"], capture_output=True, text=True, check=True)
    elapsed, peak = map(float, answer.stdout.split())
    print(
        f"\n{DESIGNS:,} designs (preview_proportional) on {SCENARIOS:,} scenarios to T + 3 s, every per-scenario "
        f"number kept: {elapsed:.1f} s, peak memory of the process {peak:.0f} MiB."
    )


if __name__ == "__main__":
    main()
