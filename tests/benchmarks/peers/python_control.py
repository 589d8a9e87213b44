"""The job with python-control.

For each departure: the plant with the lane as two more states, yaw rate and its slope, so that sampling it is exact;
`control.dlqr` for gain and terminal weight; the closed loop as a discrete-time system, simulated by
`control.initial_response`. The library has no QP solver: the MPC's QP goes to OSQP, set up once for each departure and
warm started. Its own `control.optimal` is for nonlinear problems: SLSQP that simulates the plant for each trial, 2 s a
sample here.
"""

import control as ct
import job
import numpy as np
import osqp
import scipy.sparse as sp
from job import DELTA_MAX, DT, HORIZON, R_LQR, R_MPC, RATE_MAX, Q

# --------------------------------------------------------------------------------------------------------------- job


def sampled(v: np.ndarray) -> list[ct.StateSpace]:
    """Plants with the states x, yaw rate of the lane, its slope; the input is the angle."""
    plants = []
    for A, B, E in zip(*job.single_track(v), strict=True):
        whole = np.zeros((6, 6))
        whole[:4, :4], whole[:4, 4], whole[4, 5] = A, E, 1.0
        plants.append(ct.sample_system(ct.ss(whole, np.append(B, [0.0, 0.0])[:, None], np.eye(6), 0), DT, "zoh"))
    return plants


def no_control(departures: dict[str, np.ndarray]) -> np.ndarray:
    return job.takeover(departures).S


def lqr(departures: dict[str, np.ndarray]) -> np.ndarray:
    over = job.takeover(departures)
    x_ss, delta_ss = job.steady_turn(over.v)
    e_y = np.zeros((over.v.size, over.r.shape[1]))
    rate = np.zeros_like(e_y)
    for i, plant in enumerate(sampled(over.v)):
        K, _, _ = ct.dlqr(plant.A[:4, :4], plant.B[:4], Q, np.array([[R_LQR]]))
        F = np.concatenate([-K[0], [delta_ss[i] + K[0] @ x_ss[i], 0.0]])
        loop = ct.ss(plant.A + plant.B * F, np.zeros((6, 1)), np.eye(6)[:2], 0, DT)
        t = DT * np.arange(int(over.left[i] / DT) + 2)
        start = np.concatenate([over.x[i], [over.r[i, 0], over.slope[i]]])
        e_y[i, : t.size], rate[i, : t.size] = ct.initial_response(loop, t, start).outputs
    return job.score(over, e_y, rate)


def mpc(departures: dict[str, np.ndarray]) -> np.ndarray:
    over = job.takeover(departures)
    x_ss, delta_ss = job.steady_turn(over.v)
    e_y = np.zeros((over.v.size, over.r.shape[1]))
    rate = np.zeros_like(e_y)
    N = HORIZON
    angles = sp.hstack([sp.csc_matrix((N, 4 * N)), sp.eye(N)])
    rows = sp.vstack([angles, sp.csc_matrix(np.eye(N) - np.eye(N, k=-1)) @ angles])
    most = np.repeat([DELTA_MAX, RATE_MAX * DT], N)
    for i, plant in enumerate(sampled(over.v)):
        A, B = plant.A[:4, :4], plant.B[:4]
        E_1 = plant.A[:4, 5] / DT
        E_0 = plant.A[:4, 4] - E_1
        _, P, _ = ct.dlqr(A, B, Q, np.array([[R_MPC]]))
        H = sp.block_diag([*[Q] * (N - 1), P, R_MPC * sp.eye(N)], format="csc")
        motion = sp.hstack([sp.eye(4 * N) - sp.kron(sp.eye(N, k=-1), A), -sp.kron(sp.eye(N), B)])
        x, delta, solver = over.x[i], over.delta[i], osqp.OSQP()
        for k in range(int(over.left[i] / DT) + 2):
            e_y[i, k], rate[i, k] = x[:2]
            r = over.r[i, k : k + N + 1]
            b = np.outer(r[:-1], E_0) + np.outer(r[1:], E_1)
            b[0] += A @ x
            known = np.concatenate([np.outer(r[1:], x_ss[i]).ravel(), delta_ss[i] * 0.5 * (r[:-1] + r[1:])])
            q, first = -(H @ known), np.zeros(2 * N)
            first[N] = delta
            low, high = np.concatenate([b.ravel(), first - most]), np.concatenate([b.ravel(), first + most])
            if k == 0:
                solver.setup(
                    sp.triu(H, format="csc"), q, sp.vstack([motion, rows], format="csc"), low, high,
                    eps_abs=1e-6, eps_rel=1e-6, max_iter=20_000, verbose=False,
                )  # fmt: skip
            else:
                solver.update(q=q, l=low, u=high)
            delta = float(solver.solve().x[4 * N])
            x = A @ x + B[:, 0] * delta + E_0 * r[0] + E_1 * r[1]
    return job.score(over, e_y, rate)


# -------------------------------------------------------------------------------------------------------- end of job

if __name__ == "__main__":
    job.main(
        "python-control", __file__, ("control", "osqp", "numpy", "scipy"),
        {"none": no_control, "lqr": lqr, "mpc": mpc}, once=("mpc",),
    )  # fmt: skip
