"""Nonlinear MPC against IPOPT, fatrop and do-mpc: processor time a step and cost of the plans, on the same states.

`nonlinear_mpc` drives its own model in closed loop, scenario by scenario, and the states, previous commands and lanes
on the way are kept. The others then solve the same problems in the same order, each warm started from the one before:
same model as a discrete one (the very CasADi expression), same horizon, weights, references and limits; the change of
the command is the input and the command a state, so that all limits are boxes. Set up as their documentation advises:

- IPOPT (MUMPS) and fatrop through `casadi.nlpsol`, expanded, output off, tolerance 1e-8, variables and constraints in
  the order of the stages, for fatrop with `structure_detection` "auto"; both with functions compiled by `-O2`, as
  ours are, and in CasADi's virtual machine. Warm start: states, commands and multipliers of the solve before.
- do-mpc: one controller for all scenarios with parameters and time-varying parameters, IPOPT with MUMPS and its output
  off, no storing of full solutions.

Time is that of the process; ours is the whole step of the law, all scenarios in one call, theirs the call of the
solver. Printed by `make bench`;
with the argument `simulate` it is that of `simulate` alone, for two versions of the toolkit.
"""

import dataclasses
import importlib.metadata
import platform
import sys
import time
import warnings
from typing import Any

import casadi as ca
import numpy as np
from history import report

from ldctoolkit import BicycleModel, EventStatus, Plant, Preview, load_model, simulate
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
        # (STEPS, n, N, np) what each sample of a problem is given
        self.P = np.array([self.law.samples(self.r[:, k : k + N + 1]) for k in range(STEPS)])
        self.sample = self.law.form.program(N).predict  # (x, u, p, c) -> x, a_y, a_y
        self.x = np.zeros((STEPS, n, 4))
        self.prev = np.zeros((STEPS, n))
        self.delta = np.zeros((STEPS, n))
        self.U = np.zeros((STEPS, n, N))
        self.seconds = 0.0
        self.active = self.failed = self.iterations = 0
        self._drive(rng)
        x_0, U = ca.MX.sym("x", 4), ca.MX.sym("u", N)
        P, c = ca.MX.sym("P", self.P.shape[-1], N), ca.MX.sym("c", self.law.columns.shape[1])
        x, total = x_0, 0
        for j in range(N):
            total += self.stage(x, U[j], P[:, j])
            x = self.sample(x, U[j], P[:, j], c)[0]
        self.cost = ca.Function("cost", [x_0, U, P, c], [total + self.terminal(x, P[:, N - 1], c)])

    def stage(self, x: Any, u: Any, p: Any) -> Any:
        """Cost of a sample: p holds the steady angle in row 3 and the steady states at both ends from row 4 on."""
        d = self.design
        return d.q_y * x[0] ** 2 + d.q_psi * (x[2] - p[6]) ** 2 + d.r_delta * (u - p[3]) ** 2

    def terminal(self, x: Any, p: Any, c: Any) -> Any:
        """Of the last state, with the solution of the Riccati equation."""
        P = ca.reshape(self.law.form.layout.unpack(c)["P"], 4, 4)
        return 0.5 * ca.bilin(P, x - p[8:12], x - p[8:12])

    def _drive(self, rng: np.random.Generator) -> None:
        n, d = SCENARIOS, self.design
        x = np.column_stack([rng.uniform(0.6, 1.4, n), rng.uniform(0, 0.5, n), rng.uniform(0, 0.02, n), np.zeros(n)])
        prev = self.P[0, :, 0, 3].copy()
        state = self.law.init(n)
        self.law.step(np.zeros(n), x, self._preview(0), prev, state)  # compiled or loaded
        for k in range(STEPS):
            self.x[k], self.prev[k] = x, prev
            start = time.process_time()
            self.delta[k], state, status = self.law.step(np.full(n, k * DT), x, self._preview(k), prev, state)
            self.seconds += time.process_time() - start
            self.U[k] = state.U
            self.failed += int((status != EventStatus.OK).sum())
            self.iterations += int(state.iterations.sum())
            change = np.abs(np.diff(state.U, axis=1, prepend=prev[:, None])).max(axis=1)
            bound = (np.abs(state.U).max(axis=1) > d.delta_max - 1e-9) | (change > d.rate_max * DT - 1e-9)
            self.active += int(bound.sum())
            after = (self.sample(x[i], self.delta[k, i], self.P[k, i, 0], self.law.columns[i])[0] for i in range(n))
            x = np.array([np.asarray(state).ravel() for state in after])
            x += rng.normal(size=x.shape) * [0.002, 0.01, 0.0005, 0.005]  # what no model foresees
            prev = self.delta[k]

    def _preview(self, k: int) -> Preview:
        r = self.r[:, k : k + self.design.horizon + 1]
        return Preview(r, np.zeros_like(r))


@dataclasses.dataclass
class Result:
    """What a solver did with all problems."""

    seconds: float = 0.0
    iterations: int = 0
    unsolved: int = 0
    gaps: list[float] = dataclasses.field(default_factory=list)  # our cost above theirs, relative
    apart: list[float] = dataclasses.field(default_factory=list)  # [rad] of the first commands

    def add(self, drives: Drives, k: int, i: int, U: np.ndarray, iterations: int, *, solved: bool) -> None:
        """A plan; costs are those of the model driven with the commands."""
        self.iterations += iterations
        if not solved:
            self.unsolved += 1
            return
        given = drives.P[k, i].T, drives.law.columns[i]
        ours, theirs = (float(drives.cost(drives.x[k, i], plan, *given)) for plan in (drives.U[k, i], U))
        self.gaps.append((ours - theirs) / theirs)
        self.apart.append(abs(U[0] - drives.delta[k, i]))


class Rival:
    """A solver of CasADi for the same problems; variables are x, command before and its change, stage by stage."""

    def __init__(self, drives: Drives, solver: str, *, compiled: bool) -> None:
        self.drives, self.N, d = drives, drives.design.horizon, drives.design
        N, inf = self.N, np.inf
        x_0, prev_0 = ca.MX.sym("x_0", 4), ca.MX.sym("prev_0")
        P, c = ca.MX.sym("P", drives.P.shape[-1], N), ca.MX.sym("c", drives.law.columns.shape[1])
        x = [ca.MX.sym(f"x_{k}", 5) for k in range(N + 1)]
        u = [ca.MX.sym(f"u_{k}") for k in range(N)]
        total, g = 0, []
        for k in range(N):
            command = x[k][4] + u[k]
            total += drives.stage(x[k], command, P[:, k])
            g.append(x[k + 1] - ca.vertcat(drives.sample(x[k][:4], command, P[:, k], c)[0], command))
            if k == 0:
                g.append(x[0] - ca.vertcat(x_0, prev_0))
        total += drives.terminal(x[N][:4], P[:, N - 1], c)
        w = ca.vertcat(*(part for k in range(N) for part in (x[k], u[k])), x[N])
        rate = d.rate_max * DT
        low = [*[-inf] * 4, -d.delta_max, -rate]
        self.low = np.array([*[-inf] * 5, -rate, *low * (N - 1), *low[:5]])
        options: dict[str, Any] = {
            "expand": True, "print_time": False, "equality": [True] * ca.vertcat(*g).numel(),
            **({"ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.warm_start_init_point": "yes"} if solver == "ipopt"
               else {"fatrop.print_level": 0, "structure_detection": "auto"}),
        }  # fmt: skip
        if compiled:
            options |= {"jit": True, "compiler": "shell", "jit_options": {"flags": ["-O2"], "verbose": False}}
        p = ca.vertcat(x_0, prev_0, ca.vec(P), c)
        self.solve = ca.nlpsol("solve", solver, {"x": w, "p": p, "f": total, "g": ca.vertcat(*g)}, options)
        self.commands = np.arange(N) * 6

    def run(self) -> Result:
        """All problems, in the order of the drives."""
        drives, N, result = self.drives, self.N, Result()
        for i in range(SCENARIOS):
            guess: dict[str, Any] = {"x0": np.tile(np.append(drives.x[0, i], [drives.prev[0, i], 0.0]), N + 1)[:-1]}
            for k in range(STEPS):
                p = np.concatenate(
                    [drives.x[k, i], drives.prev[k : k + 1, i], drives.P[k, i].ravel(), drives.law.columns[i]]
                )
                start = time.process_time()
                found = self.solve(**guess, p=p, lbx=self.low, ubx=-self.low, lbg=0.0, ubg=0.0)
                result.seconds += time.process_time() - start
                stats = self.solve.stats()
                w = np.asarray(found["x"]).ravel()
                result.add(drives, k, i, w[4::6][1:], stats["iter_count"], solved=stats["success"])
                guess = {"x0": w, "lam_x0": found["lam_x"], "lam_g0": found["lam_g"]}
        return result


def do_mpc_controller(drives: Drives, given: dict[str, np.ndarray]) -> Any:
    """The same problem; `given` holds P (N + 1, np) and c, and is read at each step."""
    design, sizes = drives.design, {"P": drives.P.shape[-1], "c": drives.law.columns.shape[1]}
    model = do_mpc.model.Model("discrete", "SX")
    x, delta = model.set_variable("_x", "x", (4, 1)), model.set_variable("_x", "delta")
    change = model.set_variable("_u", "change")
    p, column = model.set_variable("_tvp", "P", (sizes["P"], 1)), model.set_variable("_p", "c", (sizes["c"], 1))
    model.set_rhs("x", drives.sample(x, delta + change, p, column)[0])
    model.set_rhs("delta", delta + change)
    model.setup()

    mpc = do_mpc.controller.MPC(model)
    mpc.settings.n_horizon, mpc.settings.t_step, mpc.settings.n_robust = design.horizon, DT, 0
    mpc.settings.state_discretization = "discrete"
    mpc.settings.store_full_solution = mpc.settings.store_lagr_multiplier = False
    mpc.settings.supress_ipopt_output()
    # the row after the last sample is the last once more: the terminal cost takes the references at its end
    mpc.set_objective(lterm=drives.stage(x, delta + change, p), mterm=drives.terminal(x, p, column))
    mpc.set_rterm(rterm=ca.SX(0))
    rate = design.rate_max * DT
    mpc.bounds["lower", "_u", "change"], mpc.bounds["upper", "_u", "change"] = -rate, rate
    mpc.bounds["lower", "_x", "delta"], mpc.bounds["upper", "_x", "delta"] = -design.delta_max, design.delta_max
    mpc.terminal_bounds["lower", "delta"], mpc.terminal_bounds["upper", "delta"] = -design.delta_max, design.delta_max
    ahead, fixed = mpc.get_tvp_template(), mpc.get_p_template(1)

    def tvp(_: float) -> Any:
        for j in range(design.horizon + 1):
            ahead["_tvp", j, "P"] = given["P"][min(j, design.horizon - 1)]
        return ahead

    def parameters(_: float) -> Any:
        fixed["_p", 0, "c"] = given["c"]
        return fixed

    mpc.set_tvp_fun(tvp)
    mpc.set_p_fun(parameters)
    mpc.setup()
    return mpc


def run_do_mpc(drives: Drives) -> Result:
    """All problems by do-mpc, in the order of the drives."""
    given, result, N = {"P": drives.P[0, 0], "c": drives.law.columns[0]}, Result(), drives.design.horizon
    mpc = do_mpc_controller(drives, given)
    for i in range(SCENARIOS):
        given["c"] = drives.law.columns[i]
        mpc.reset_history()
        for k in range(STEPS):
            given["P"] = drives.P[k, i]
            x_0 = np.append(drives.x[k, i], drives.prev[k, i])[:, None]
            if k == 0:
                mpc.x0, mpc.u0 = x_0, np.zeros((1, 1))
                mpc.set_initial_guess()
            start = time.process_time()
            mpc.make_step(x_0)
            result.seconds += time.process_time() - start
            plan = [float(mpc.opt_x_num["_u", j, 0]) for j in range(N)]
            stats = mpc.solver_stats
            result.add(drives, k, i, drives.prev[k, i] + np.cumsum(plan), stats["iter_count"], solved=stats["success"])
    return result


def compare(name: str, drives: Drives) -> None:
    """A row for each solver."""
    steps = SCENARIOS * STEPS
    print(
        f"| {name} | nonlinear_mpc | {1e6 * drives.seconds / steps:.0f} | 1.0 | {drives.iterations / steps:.1f} | "
        f"| | | {drives.failed} |"
    )
    rivals = {
        f"{solver}, {'compiled' if compiled else 'virtual machine'}": Rival(drives, solver, compiled=compiled).run
        for solver in ("ipopt", "fatrop")
        for compiled in (True, False)
    }
    for rival, run in (rivals | {"do-mpc, virtual machine": lambda: run_do_mpc(drives)}).items():
        result = run()
        gap = np.array(result.gaps)
        report(f"{name}, {rival}", result.seconds / drives.seconds)
        print(
            f"| | {rival} | {1e6 * result.seconds / steps:.0f} | {result.seconds / drives.seconds:.1f} | "
            f"{result.iterations / steps:.1f} | {gap.max():.1e} | {gap.min():.1e} | {np.median(result.apart):.0e} | "
            f"{result.unsolved} |",
            flush=True,
        )
    print(f"Limits are active in {100 * drives.active / steps:.0f} % of these {steps} problems.\n")


def simulated() -> None:
    """Processor time of whole simulations, by public names alone."""
    scenarios = load_model("reference").sample(20, 20, seed=1)
    for name, design in CASES.items():
        simulate(design, scenarios, y_s=0.15)  # compiled or loaded
        seconds = []
        for _ in range(5):
            start = time.process_time()
            simulate(design, scenarios, y_s=0.15)
            seconds.append(time.process_time() - start)
        print(f"{name}: {1e3 * min(seconds):.0f} ms of 40 departures, best of 5")


def main() -> None:
    if sys.argv[1:] == ["simulate"]:
        simulated()
        return
    warnings.simplefilter("ignore", FutureWarning)  # of CasADi, about calls inside do-mpc
    versions = {name: importlib.metadata.version(name) for name in ("casadi", "daqp", "do-mpc", "numpy")}
    shown = ", ".join(f"{name} {version}" for name, version in versions.items())
    print(f"\n{platform.machine()}; Python {platform.python_version()}, {shown}.")
    print(f"{SCENARIOS} scenarios of {STEPS} steps; processor time.\n")
    for name, design in CASES.items():
        print(
            "| case | solver | us a step | ratio | iterations | our cost above theirs, worst | best | "
            "first command apart, median [rad] | unsolved |\n"
            "| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |"
        )
        compare(name, Drives(design))


if __name__ == "__main__":
    main()
