"""Nonlinear MPC against do-mpc: time a step and cost of the plans, on the same states.

`nonlinear_mpc` drives its own model in closed loop, scenario by scenario, and the states, previous commands and lanes
on the way are kept. do-mpc then solves the same problems in the same order, each warm started from the one before, as
it does by itself: same model as a discrete one (the very CasADi expression), same horizon, weights, references and
limits; the change of the command is its input and the command a state, so that all limits are boxes. Set up as its
documentation advises: one controller for all scenarios with parameters and time-varying parameters, IPOPT with
MUMPS and its output off, no storing of full solutions. IPOPT's tolerance is its default, 1e-8. Printed by `make bench`.
"""

import importlib.metadata
import platform
import time
import warnings
from typing import Any

import casadi as ca
import numpy as np

from ldctoolkit import BicycleModel, EventStatus, Plant, Preview
from ldctoolkit.controllers._nmpc_solver import SIZE, sample, steady_cornering, unpack
from ldctoolkit.controllers.nonlinear_mpc import NonlinearMPC

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # it names the optional packages that it does not find
    import do_mpc

DT, SCENARIOS, STEPS = 0.05, 12, 40
CASES = {
    "friction 1.0, default weights": NonlinearMPC(r_delta=100.0),
    "friction 0.5, harsh weights": NonlinearMPC(mu=0.5, r_delta=10.0),
}


class Drives:
    """Scenarios, their lanes, and the states that `nonlinear_mpc` passes."""

    def __init__(self, design: NonlinearMPC) -> None:
        rng = np.random.default_rng(2)
        n, N = SCENARIOS, design.horizon
        self.design = design
        self.plant = Plant.build(BicycleModel(), rng.uniform(10, 33, n), DT)
        grip = min(design.mu * 9.81 * 0.5, 3.0)
        times = DT * np.arange(STEPS + N + 1)
        bend, turn = rng.uniform(-0.6, 0.6, (n, 1)), rng.uniform(-0.3, 0.3, (n, 1))
        self.r = grip / self.plant.v[:, None] * (bend + turn * np.minimum(times, 2.0))
        self.law = design.prepare(self.plant)
        nodes = steady_cornering(self.plant, design.mu, self.r)
        self.e_ref = nodes.e_psi
        self.u_ref = steady_cornering(self.plant, design.mu, 0.5 * (self.r[:, :-1] + self.r[:, 1:])).delta
        x, u, r_0, r_1 = ca.SX.sym("x", 4), ca.SX.sym("u"), ca.SX.sym("r_0"), ca.SX.sym("r_1")
        c = ca.SX.sym("c", SIZE)
        self.model = ca.Function("model", [x, u, r_0, r_1, c], [sample(x, u, r_0, r_1, c)[0]])
        self.x = np.zeros((STEPS, n, 4))
        self.prev = np.zeros((STEPS, n))
        self.delta = np.zeros((STEPS, n))
        self.U = np.zeros((STEPS, n, N))
        self.seconds = 0.0
        self.active = self.failed = self.iterations = 0
        self._drive(rng)

    def _drive(self, rng: np.random.Generator) -> None:
        n, d = SCENARIOS, self.design
        x = np.column_stack([rng.uniform(0.6, 1.4, n), rng.uniform(0, 0.5, n), rng.uniform(0, 0.02, n), np.zeros(n)])
        prev = self.u_ref[:, 0].copy()
        laws = [self.law.take(np.array([i]), self.law.init(n)) for i in range(n)]
        laws[0][0].step(np.zeros(1), x[:1], self._preview(0, 0), prev[:1], laws[0][1])  # compiled or loaded
        states = [state for _, state in laws]
        for k in range(STEPS):
            self.x[k], self.prev[k] = x, prev
            for i, (law, _) in enumerate(laws):
                given = np.full(1, k * DT), x[i : i + 1], self._preview(k, i), prev[i : i + 1], states[i]
                start = time.perf_counter()
                delta, states[i], status = law.step(*given)
                self.seconds += time.perf_counter() - start
                self.failed += int(status[0] != EventStatus.OK)
                self.iterations += int(states[i].iterations[0])
                U = states[i].U[0]
                change = np.abs(np.diff(U, prepend=prev[i])).max()
                self.active += bool(np.abs(U).max() > d.delta_max - 1e-9 or change > d.rate_max * DT - 1e-9)
                self.delta[k, i], self.U[k, i] = delta[0], U
            x = np.array(
                [
                    np.asarray(
                        self.model(x[i], self.delta[k, i], self.r[i, k], self.r[i, k + 1], self.law.columns[i])
                    ).ravel()
                    for i in range(n)
                ]
            )
            x += rng.normal(size=x.shape) * [0.002, 0.01, 0.0005, 0.005]  # what no model foresees
            prev = self.delta[k]

    def _preview(self, k: int, i: int) -> Preview:
        r = self.r[i : i + 1, k : k + self.design.horizon + 1]
        return Preview(r, np.zeros_like(r))

    def cost(self, k: int, i: int, U: np.ndarray) -> float:
        """Of a plan, by driving the model."""
        c = {name: np.asarray(part) for name, part in unpack(self.law.columns[i]).items()}
        x, total, N = self.x[k, i], 0.0, self.design.horizon
        for j in range(N):
            x = np.asarray(self.model(x, U[j], self.r[i, k + j], self.r[i, k + j + 1], self.law.columns[i])).ravel()
            off = x - np.array([0, 0, self.e_ref[i, k + j + 1], 0])
            W = c["P"].reshape(4, 4) if j == N - 1 else np.diag(c["q"])
            total += float(off @ W @ off + c["r_delta"][0] * (U[j] - self.u_ref[i, k + j]) ** 2)
        return total


def do_mpc_controller(design: NonlinearMPC, lane: dict[str, np.ndarray]) -> Any:
    """The same problem; `lane` holds r_0, r_1, e_ref, u_ref (N+1) and c (SIZE) and is read at each step."""
    model = do_mpc.model.Model("discrete", "SX")
    x, delta = model.set_variable("_x", "x", (4, 1)), model.set_variable("_x", "delta")
    change = model.set_variable("_u", "change")
    r_0, r_1, e_ref, u_ref = (model.set_variable("_tvp", name) for name in ("r_0", "r_1", "e_ref", "u_ref"))
    column = model.set_variable("_p", "c", (SIZE, 1))
    model.set_rhs("x", sample(x, delta + change, r_0, r_1, column)[0])
    model.set_rhs("delta", delta + change)
    model.setup()

    mpc = do_mpc.controller.MPC(model)
    mpc.settings.n_horizon, mpc.settings.t_step, mpc.settings.n_robust = design.horizon, DT, 0
    mpc.settings.state_discretization = "discrete"
    mpc.settings.store_full_solution = mpc.settings.store_lagr_multiplier = False
    mpc.settings.supress_ipopt_output()
    c = unpack(column)
    off = x - ca.vertcat(0, 0, e_ref, 0)
    mpc.set_objective(
        lterm=ca.dot(c["q"], off**2) + c["r_delta"] * (delta + change - u_ref) ** 2,
        mterm=ca.bilin(ca.reshape(c["P"], 4, 4), off, off),
    )
    mpc.set_rterm(rterm=ca.SX(0))
    rate = design.rate_max * DT
    mpc.bounds["lower", "_u", "change"], mpc.bounds["upper", "_u", "change"] = -rate, rate
    mpc.bounds["lower", "_x", "delta"], mpc.bounds["upper", "_x", "delta"] = -design.delta_max, design.delta_max
    mpc.terminal_bounds["lower", "delta"], mpc.terminal_bounds["upper", "delta"] = -design.delta_max, design.delta_max
    ahead, fixed = mpc.get_tvp_template(), mpc.get_p_template(1)

    def tvp(_: float) -> Any:
        for name in ("r_0", "r_1", "e_ref", "u_ref"):
            for j in range(design.horizon + 1):
                ahead["_tvp", j, name] = lane[name][j]
        return ahead

    def parameters(_: float) -> Any:
        fixed["_p", 0, "c"] = lane["c"]
        return fixed

    mpc.set_tvp_fun(tvp)
    mpc.set_p_fun(parameters)
    mpc.setup()
    return mpc


def compare(name: str, drives: Drives) -> None:
    design, N = drives.design, drives.design.horizon
    lane = {name: np.zeros(N + 1) for name in ("r_0", "r_1", "e_ref", "u_ref")} | {"c": np.zeros(SIZE)}
    mpc = do_mpc_controller(design, lane)
    seconds, iterations, unsolved = 0.0, 0, 0
    difference, command = [], []
    for i in range(SCENARIOS):
        lane["c"] = drives.law.columns[i]
        mpc.reset_history()
        for k in range(STEPS):
            r = drives.r[i, k : k + N + 2]
            lane["r_0"], lane["r_1"] = r[: N + 1], np.append(r[1 : N + 1], 0.0)
            lane["e_ref"] = drives.e_ref[i, k : k + N + 1]
            lane["u_ref"] = np.append(drives.u_ref[i, k : k + N], 0.0)
            x_0 = np.append(drives.x[k, i], drives.prev[k, i])[:, None]
            if k == 0:
                mpc.x0, mpc.u0 = x_0, np.zeros((1, 1))
                mpc.set_initial_guess()
            start = time.perf_counter()
            change = mpc.make_step(x_0)
            seconds += time.perf_counter() - start
            iterations += mpc.solver_stats["iter_count"]
            if not mpc.solver_stats["success"]:
                unsolved += 1
                continue
            plan = [float(mpc.opt_x_num["_u", j, 0]) for j in range(N)]
            U = drives.prev[k, i] + np.cumsum(plan)
            ours, theirs = drives.cost(k, i, drives.U[k, i]), drives.cost(k, i, U)
            difference.append((ours - theirs) / theirs)
            command.append(abs(drives.prev[k, i] + float(change[0, 0]) - drives.delta[k, i]))
    steps = SCENARIOS * STEPS
    gap = np.array(difference)
    print(
        f"| {name} | {1e6 * drives.seconds / steps:.0f} | {1e6 * seconds / steps:.0f} | "
        f"{seconds / drives.seconds:.1f} | {drives.iterations / steps:.1f} | {iterations / steps:.1f} | "
        f"{100 * drives.active / steps:.0f} % | {gap.max():.1e} | {gap.min():.1e} | {np.median(command):.0e} | "
        f"{drives.failed}, {unsolved} |",
        flush=True,
    )


def main() -> None:
    warnings.simplefilter("ignore", FutureWarning)  # of CasADi, about calls inside do-mpc
    versions = {name: importlib.metadata.version(name) for name in ("casadi", "daqp", "do-mpc", "numpy")}
    shown = ", ".join(f"{name} {version}" for name, version in versions.items())
    print(f"\n{platform.machine()}; Python {platform.python_version()}, {shown}.")
    print(f"{SCENARIOS} scenarios of {STEPS} steps, one scenario a call.\n")
    print(
        "| case | ours [us/step] | do-mpc [us/step] | ratio | our iterations | IPOPT's | steps with active limits | "
        "our cost above theirs, worst | best | first command apart, median [rad] | unsolved: ours, theirs |"
    )
    print("| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |")
    for name, design in CASES.items():
        compare(name, Drives(design))


if __name__ == "__main__":
    main()
