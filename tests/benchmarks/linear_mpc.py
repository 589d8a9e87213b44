"""Linear MPC benchmark: the law in the closed loop against plain loops over raw OSQP, as ratios from one run.

The reference, written here in full, takes the scenarios one by one: the uncondensed MPC in one sparse OSQP each, eps
1e-6, updated and warm started at every sample; it drives the plant itself and keeps no score. Its commands are then
replayed by the toolkit's closed loop, so that S is compared and not the way S is worked out. It runs on every tenth
scenario; what counts is the time of one scenario-step. The law's time holds all of it: Riccati equation, condensing,
set-up of solvers, plant and score. Soft limits are a table of their own: processor time of the law's steps alone, on
the plant of a catalog study."""

import dataclasses
import time

import numpy as np
import osqp
import scipy.sparse as sp
from closed_loop import machine, scenarios, seconds
from history import report

from ldctoolkit import (
    BicycleModel,
    Controller,
    EventStatus,
    Plant,
    PredictiveController,
    Preview,
    Setup,
    Stage,
    SteeringLaw,
    gain,
    load_model,
    load_study,
)
from ldctoolkit.controllers import LinearMPC
from ldctoolkit.controllers.linear_mpc import MPCLaw, Rung
from ldctoolkit.controllers.riccati import regulator
from ldctoolkit.simulation import Takeover, drive

SCENARIOS, EVERY, STUDY = 2_000, 10, "trigger-and-gains"
DESIGN = LinearMPC(horizon=20, delta_max=0.15, rate_max=0.3, r_delta=100.0)


def raw_osqp_loop(design: LinearMPC, over: Takeover) -> np.ndarray:
    """Commands (m, steps) of the uncondensed MPC, one OSQP per scenario, NaN after the end."""
    N, dt, step = design.horizon, over.plant.dt, over.plant.step
    q = (design.q_y, design.q_y_rate, design.q_psi, design.q_psi_rate)
    P = regulator(over.plant, q, design.r_delta).P
    steady = over.plant.steady_state()
    inputs = sp.hstack([sp.csc_matrix((N, 4 * N)), sp.eye(N)])
    change = sp.csc_matrix(np.diff(np.eye(N), axis=0, prepend=0.0)) @ inputs
    commands = np.full((over.m, int(over.full_steps.max()) + 1), np.nan)
    for i in range(over.m):
        A, B, E_0, E_1 = step.A[i], step.B[i], step.E_0[i], step.E_1[i]
        weights = [np.diag(q)] * (N - 1) + [P[i]]
        H = sp.block_diag([*weights, design.r_delta * sp.eye(N)], format="csc")
        shift = np.kron(np.eye(N, k=-1), -A)
        G = sp.hstack([sp.csc_matrix(np.eye(4 * N) + shift), -sp.kron(sp.eye(N), B[:, None])])
        x, previous, solver = over.x_0[i], over.delta_0[i], None
        x_ss = np.array([0, 0, steady.e_psi[i], 0])
        for k in range(int(over.full_steps[i]) + 1):
            t = over.start[i] + k * dt + dt * np.arange(N + 1)
            T = over.triggered.T[i]
            r = over.plant.v[i] * (over.triggered.c_0[i] + over.triggered.dc[i] * np.minimum(t / T, 1.0))
            b = (np.outer(r[:-1], E_0) + np.outer(r[1:], E_1)).ravel()
            b[:4] += A @ x
            targets = np.concatenate([np.outer(r[1:], x_ss).ravel(), steady.delta[i] * 0.5 * (r[:-1] + r[1:])])
            g = -H @ targets
            first = np.zeros(N)
            first[0] = previous
            rate = design.rate_max * dt
            low = np.concatenate([b, np.full(N, -design.delta_max), first - rate])
            high = np.concatenate([b, np.full(N, design.delta_max), first + rate])
            if solver is None:
                solver = osqp.OSQP()
                solver.setup(
                    P=sp.triu(H, format="csc"), q=g, A=sp.vstack([G, inputs, change], format="csc"), l=low, u=high,
                    eps_abs=1e-6, eps_rel=1e-6, max_iter=20000, verbose=False,
                )  # fmt: skip
            else:
                solver.update(q=g, l=low, u=high)
            answer = solver.solve(raise_error=False).x
            previous = float(np.clip(answer[4 * N], -design.delta_max, design.delta_max))
            commands[i, k] = previous
            x = A @ x + B * previous + E_0 * r[0] + E_1 * r[1]
    return commands


@dataclasses.dataclass(frozen=True, eq=False)
class Replay(SteeringLaw):
    """Commands that are known beforehand; the state is the sample."""

    commands: np.ndarray
    preview_times = np.zeros(0)

    def init(self, n):
        return 0

    def step(self, t, x, preview, delta_prev, state):
        delta = self.commands[:, min(state, self.commands.shape[1] - 1)]
        return np.nan_to_num(delta), state + 1, np.zeros(delta.size, dtype=np.int8)


@dataclasses.dataclass(frozen=True, eq=False)
class Replayed(Controller):
    commands: np.ndarray
    name = "replayed"
    title = "Replayed"

    def prepare(self, plant):
        return Replay(self.commands)


@dataclasses.dataclass(frozen=True, eq=False)
class Watched(Controller):
    """The design's law, counting how its commands came about."""

    inner: LinearMPC
    rungs: np.ndarray
    ended: list
    spent: list = dataclasses.field(default_factory=lambda: [0.0, 0])
    name = "watched"
    title = "Watched"

    def prepare(self, plant):
        return WatchedLaw(self.inner.prepare(plant), self.rungs, self.ended, self.spent)


@dataclasses.dataclass(frozen=True, eq=False)
class WatchedLaw(SteeringLaw):
    law: MPCLaw
    rungs: np.ndarray
    ended: list
    spent: list  # processor time [s] of the steps, and their number, over scenarios

    @property
    def preview_times(self):
        return self.law.preview_times

    def init(self, n):
        return self.law.init(n)

    def step(self, t, x, preview, delta_prev, state):
        start = time.process_time()
        delta, state, status = self.law.step(t, x, preview, delta_prev, state)
        self.spent[:] = [self.spent[0] + time.process_time() - start, self.spent[1] + t.size]
        going = np.any(x != 0, axis=1)
        self.rungs[:] += np.bincount(state.rung[going], minlength=len(Rung))
        self.ended[:] = [state]
        return delta, state, status

    def take(self, rows, state):
        law, state = self.law.take(rows, state)
        return WatchedLaw(law, self.rungs, self.ended, self.spent), state


@dataclasses.dataclass(frozen=True)
class Formulated(PredictiveController):
    """The same problem as a formulation."""

    name, title, horizon = "formulated", "Formulated", DESIGN.horizon
    r_delta: float = gain(DESIGN.r_delta, unit="1/rad^2", lower=1e-6, upper=1e6, description="weight")
    delta_max: float = gain(DESIGN.delta_max, unit="rad", lower=1e-6, upper=1e6, description="limit")
    rate_max: float = gain(DESIGN.rate_max, unit="rad/s", lower=1e-6, upper=1e6, description="limit")

    def dynamics(self, x, u, lane, vehicle):
        return vehicle.linear(x, u.delta, lane)

    def stage(self, x, u, lane, k):
        cost = x.e_y**2 + (x.e_psi - lane.steady_e_psi) ** 2 + self.r_delta * (u.delta - lane.steady_delta) ** 2
        step = self.rate_max * lane.dt
        return Stage(cost, hard=[(u.delta, -self.delta_max, self.delta_max), (u.change, -step, step)])


def formulated() -> None:
    """One step of 400 situations: the formulation against the law, processor time."""
    n, steps = 400, 50
    rng = np.random.default_rng(3)
    plant = Plant.build(BicycleModel(), rng.uniform(7, 36, n), 0.05)
    spread = rng.normal(size=(n, 4)) * [0.8, 0.4, 0.03, 0.1]
    print("| 400 situations | QPs | most difference, rad | linear_mpc, us | formulation, us | ratio |")
    print("| --- | ---: | ---: | ---: | ---: | ---: |")
    for size in (0.05, 0.3, 1.0):
        r = size * rng.normal(0, 0.05, (n, 1)) * np.ones(DESIGN.horizon + 1)
        given = np.zeros(n), size * spread, Preview(r, 0.0 * r), size * rng.uniform(-0.05, 0.05, n)
        found, times = [], []
        for design in (DESIGN, Formulated()):
            law = design.prepare(plant)
            state = law.init(n)
            delta, after, _ = law.step(*given, state)
            start = time.process_time()
            for _ in range(steps):
                law.step(*given, state)
            times.append(1e6 * (time.process_time() - start) / (steps * n))
            found.append((delta, after))
        (theirs, _), (ours, after) = found
        active = 100 * np.mean(after.iterations > 0)
        most = np.abs(ours - theirs).max()
        ratio = times[1] / times[0]
        print(f"| {size:g} | {active:.0f} % | {most:.1e} | {times[0]:.1f} | {times[1]:.1f} | {ratio:.1f} |", flush=True)
    print()


def takeover(rows: slice | np.ndarray = slice(None)) -> Takeover:
    """Of scenarios that trigger, with a steering angle at the trigger that the limits can reach."""
    many, setup = scenarios(3_000), Setup(settle=0.0)
    over = Takeover.build(many, setup, y_s=0.1)
    outcome = drive(DESIGN, over).outcome("departure")
    good = np.flatnonzero(outcome.status == EventStatus.OK)[:SCENARIOS]
    if good.size < SCENARIOS:
        raise RuntimeError("too few scenarios trigger")
    return Takeover.build(many.take(good[rows]), setup, y_s=0.1)


def score(design: Controller, over: Takeover) -> np.ndarray:
    return drive(design, over).outcome("control").S


def soft_limits() -> None:
    """Steps with and without a soft limit on the plant of a catalog study, by each solver."""
    over = Takeover.build(load_model("reference").sample(250, 250, seed=1), load_study(STUDY).setup(), y_s=0.15)
    print(f"{STUDY}, y_s = 0.15 m, linear_mpc, r_delta = 2500, rate_max = 0.33\n")
    print("| case | us a scenario-step | left to the solver | mean S |")
    print("| --- | ---: | ---: | ---: |")
    for jerk_max in (0.0, 4.5, 3.5, 2.5):
        for solver in ("osqp", "daqp") if jerk_max else ("daqp",):
            design, best = LinearMPC(r_delta=2500.0, rate_max=0.33, jerk_max=jerk_max, solver=solver), np.inf
            for _ in range(5):
                watched = Watched(design, np.zeros(len(Rung), dtype=int), [])
                S = drive(watched, over).outcome("departure").S.mean()
                best = min(best, watched.spent[0] / watched.spent[1])
            share = 100 * watched.rungs[Rung.SOLVED :].sum() / watched.rungs.sum()
            name = f"jerk_max = {jerk_max:g}, solver = {solver!r}" if jerk_max else "without soft limits"
            print(f"| {name} | {1e6 * best:.1f} | {share:.1f} % | {S:.9f} |", flush=True)


def main() -> None:
    print(machine("numpy", "numba", "osqp", "daqp", "scipy"))
    print()
    formulated()
    print("| case | us a scenario-step | ratio |")
    print("| --- | ---: | ---: |")
    over, few = takeover(), takeover(slice(0, None, EVERY))
    steps, few_steps = int((over.full_steps + 1).sum()), int((few.full_steps + 1).sum())
    start = time.perf_counter()
    commands = raw_osqp_loop(DESIGN, few)
    raw = (time.perf_counter() - start) / few_steps
    print(f"| raw OSQP loop, every {EVERY}th scenario | {1e6 * raw:.1f} | 1.0 |")
    found = {}
    for solver in ("osqp", "daqp"):
        design = dataclasses.replace(DESIGN, solver=solver)
        each = seconds(lambda design=design: drive(design, over), 5) / steps
        print(f"| linear_mpc, solver = {solver!r} | {1e6 * each:.1f} | {raw / each:.0f} |", flush=True)
        report(solver, raw / each)
        found[solver] = score(design, over)
        always = dataclasses.replace(design, always_solve=True)
        each = seconds(lambda always=always: drive(always, few), 1) / few_steps
        print(f"| the same, the solver called at every step | {1e6 * each:.1f} | {raw / each:.1f} |", flush=True)
        report(f"{solver}, called at every step", raw / each)
        found[f"{solver}, at every step"] = score(always, few)
    print()
    reference = score(Replayed(commands), few)
    print("| S against | of | most, relative, one scenario | sum, relative |")
    print("| --- | --- | ---: | ---: |")
    pairs = [
        ("raw OSQP loop", reference, "osqp", found["osqp"][::EVERY]),
        ("raw OSQP loop", reference, "daqp", found["daqp"][::EVERY]),
        ("osqp", found["osqp"], "daqp", found["daqp"]),
        ("daqp", found["daqp"][::EVERY], "osqp, at every step", found["osqp, at every step"]),
        ("daqp", found["daqp"][::EVERY], "daqp, at every step", found["daqp, at every step"]),
    ]
    for name, one, other, two in pairs:
        most, total = np.max(np.abs(two - one) / one), abs(two.sum() - one.sum()) / one.sum()
        print(f"| {name} | {other} | {most:.1e} | {total:.1e} |")
    print()
    for solver in ("osqp", "daqp"):
        rungs, ended = np.zeros(len(Rung), dtype=int), []
        turned = np.random.default_rng(0).permutation(SCENARIOS)
        watched = Watched(dataclasses.replace(DESIGN, solver=solver), rungs, ended)
        drive(watched, over)
        same = np.array_equal(score(watched.inner, reordered(over, turned)), found[solver][turned])
        counts = ", ".join(f"{rung.name.lower()} {count:,}" for rung, count in zip(Rung, rungs, strict=True))
        print(
            f"{solver}: limits active in {100 * (1 - rungs[Rung.FREE] / rungs.sum()):.1f} % of {rungs.sum():,} steps; "
            f"{counts}; the same bits in another order: {same}."
        )
    print()
    soft_limits()


def reordered(over: Takeover, rows: np.ndarray) -> Takeover:
    return Takeover.build(over.scenarios.take(rows), over.setup, y_s=0.1)


if __name__ == "__main__":
    main()
