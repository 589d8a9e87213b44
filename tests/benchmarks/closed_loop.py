"""Closed-loop benchmark: the batch loop against plain per-scenario references, as ratios from one run.

References, written here in full: the same linear law driven scenario by scenario with `control.forced_response` between
samples; and the MPC driven scenario by scenario with one sparse, updated, warm-started OSQP each. Gains over speed are
computed once and kept for both sides. Print with `make bench`.
"""

from __future__ import annotations

import platform
import time
from collections.abc import Callable

import control
import numpy as np
import osqp
import scipy.sparse as sp

from controllers import LQR, LinearMPC, PreviewProportional
from controllers.riccati import regulator
from ldctoolkit import Controller, LinearLaw, Scenarios, simulate
from ldctoolkit.simulation import Takeover
from ldctoolkit.vehicle import BicycleModel


def scenarios(n: int) -> Scenarios:
    rng = np.random.default_rng(0)
    v = np.where(rng.random(n) < 0.5, rng.normal(14, 2, n), rng.normal(28, 3, n)).clip(6)
    return Scenarios.from_arrays(
        T=np.exp(rng.normal(np.log(2), 0.6, n)).clip(0.5, 10),
        d_y=np.exp(rng.normal(np.log(0.3), 0.5, n)).clip(0.02, 1.0),
        v_mean=v,
        a_mean=rng.normal(0, 0.3, n).clip(-0.6, 0.6),
        c_0=rng.normal(0, 0.5, n) / v**2,
    )


def seconds(run: Callable[[], object], repeats: int) -> float:
    """Best of several runs after a warm-up."""
    run()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return min(times)


def forced_response_loop(design: Controller, over: Takeover, rows: range) -> None:
    """One `control.forced_response` per scenario and sample, with the lane's yaw rate as a straight line."""
    law = design.prepare(over.plant)
    if not isinstance(law, LinearLaw):
        raise TypeError(design.name)
    A, B, E = over.plant.model.matrices(over.plant.v)
    dt = over.plant.dt
    for i in rows:
        system = control.ss(A[i], np.column_stack([B[i], E[i]]), np.eye(4), np.zeros((4, 2)))
        x = over.x_0[i]
        for k in range(int(over.full_steps[i])):
            t = np.full(over.m, over.start[i] + k * dt)
            ahead = over.preview(t, law.preview_times)
            delta = law.F[i] @ x + law.G_yaw_rate[i] @ ahead.yaw_rate[i] + law.G_heading[i] @ ahead.heading[i]
            r = [over.yaw_rate(t)[i], over.yaw_rate(t + dt)[i]]
            response = control.forced_response(system, [0.0, dt], np.array([[delta, delta], r]), x)
            x = response.states[:, -1]


def raw_osqp_loop(design: LinearMPC, over: Takeover) -> None:
    """The uncondensed MPC, one OSQP per scenario at eps 1e-6, updated and warm started at every sample."""
    N, dt, step = design.horizon, over.plant.dt, over.plant.step
    q = (design.q_y, design.q_y_rate, design.q_psi, design.q_psi_rate)
    P = regulator(over.plant, q, design.r_delta).P
    steady = over.plant.steady_state()
    inputs = sp.hstack([sp.csc_matrix((N, 4 * N)), sp.eye(N)])
    change = sp.csc_matrix(np.diff(np.eye(N), axis=0, prepend=0.0)) @ inputs
    for i in range(over.m):
        A, B, E_0, E_1 = step.A[i], step.B[i], step.E_0[i], step.E_1[i]
        weights = [np.diag(q)] * (N - 1) + [P[i]]
        H = sp.block_diag([*weights, design.r_delta * sp.eye(N)], format="csc")
        shift = np.kron(np.eye(N, k=-1), -A)
        G = sp.hstack([sp.csc_matrix(np.eye(4 * N) + shift), -sp.kron(sp.eye(N), B[:, None])])
        x, previous, solver = over.x_0[i], over.delta_0[i], None
        x_ss = np.array([0, 0, steady.e_psi[i], 0])
        for k in range(int(over.full_steps[i])):
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
            x = A @ x + B * previous + E_0 * r[0] + E_1 * r[1]


def main() -> None:
    print(f"Python {platform.python_version()}, NumPy {np.__version__}, {platform.machine()}")
    print(f"{'case':<44}{'ours [ms]':>12}{'reference [ms]':>17}{'ratio':>9}")
    few = Takeover.build(scenarios(60), BicycleModel(), y_s=0.1, dt=0.05)
    many = scenarios(2000)
    share = len(many) / len(few.scenarios)
    for design in (PreviewProportional(), LQR()):
        ours = seconds(lambda design=design: simulate(design, many, y_s=0.1), 3)
        theirs = share * seconds(lambda design=design: forced_response_loop(design, few, range(few.m)), 1)
        line = f"{design.name}, 2,000 scenarios, vs forced_response"
        print(f"{line:<44}{1e3 * ours:>12.1f}{1e3 * theirs:>17.1f}{theirs / ours:>9.1f}")
    design = LinearMPC()
    subset = many.take(slice(0, 300))
    ours = seconds(lambda: simulate(design, subset, y_s=0.1), 2)
    over = Takeover.build(subset.take(slice(0, 60)), BicycleModel(), y_s=0.1, dt=0.05)
    theirs = 5 * seconds(lambda: raw_osqp_loop(design, over), 1)
    line = "linear_mpc, 300 scenarios, vs raw OSQP loop"
    print(f"{line:<44}{1e3 * ours:>12.1f}{1e3 * theirs:>17.1f}{theirs / ours:>9.1f}")


if __name__ == "__main__":
    main()
