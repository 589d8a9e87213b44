"""The job with do-mpc and NumPy.

The LQR's gains are do-mpc's, one for each speed; the loop drives all departures at once in NumPy. The MPC is one do-mpc
controller for all departures, with the vehicle's matrices as parameters and the lane as a time-varying one, so that it
is set up once. As its documentation advises: output of IPOPT off, no storing of full solutions, warm start from the
solution before. IPOPT is told that the problem is a QP, and to start close to the last solution: 3 iterations a sample
instead of 5. The problem compiled to C, as `compile_nlp` does it, was tried and gained nothing: two thirds of the time
go into setting parameters and reading solutions, in Python.
"""

import warnings
from typing import Any

import casadi as ca
import job
import numpy as np
from job import DELTA_MAX, DT, HORIZON, R_LQR, R_MPC, RATE_MAX, Q
from scipy.linalg import expm, solve_discrete_are

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # it names the optional packages that it does not find
    import do_mpc

# --------------------------------------------------------------------------------------------------------------- job


def sampled(v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A, B, E_0, E_1 over DT: the angle is held, the lane's yaw rate is a straight line."""
    A, B, E = job.single_track(v)
    M = np.zeros((v.size, 7, 7))
    M[:, :4, :4], M[:, :4, 4], M[:, :4, 5] = A * DT, B * DT, E * DT
    M[:, 5, 6] = 1.0
    M = expm(M)
    return M[:, :4, :4], M[:, :4, 4], M[:, :4, 5] - M[:, :4, 6], M[:, :4, 6]


def no_control(departures: dict[str, np.ndarray]) -> np.ndarray:
    return job.takeover(departures).S


def lqr(departures: dict[str, np.ndarray]) -> np.ndarray:
    over = job.takeover(departures)
    A, B, E_0, E_1 = sampled(over.v)
    x_ss, delta_ss = job.steady_turn(over.v)
    model = do_mpc.model.LinearModel("discrete")
    model.set_variable("_x", "x", (4, 1))
    model.set_variable("_u", "delta")
    model.setup(A[0], B[0][:, None])
    law = do_mpc.controller.LQR(model)
    law.settings.t_step, law.settings.n_horizon = DT, None
    law.set_objective(Q=Q, R=np.array([[R_LQR]]))
    law.setup()
    K = np.array([law.discrete_gain(A[i], B[i][:, None])[0] for i in range(over.v.size)])
    x, e_y, rate = over.x, [over.x[:, 0]], [over.x[:, 1]]
    for k in range(over.r.shape[1] - HORIZON - 1):
        r = over.r[:, k, None]
        delta = np.sum(K * (x - x_ss * r), axis=1, keepdims=True) + delta_ss[:, None] * r
        x = np.einsum("nij,nj->ni", A, x) + B * delta + E_0 * r + E_1 * over.r[:, k + 1, None]
        e_y.append(x[:, 0])
        rate.append(x[:, 1])
    return job.score(over, np.column_stack(e_y), np.column_stack(rate))


def controller(given: dict[str, np.ndarray]) -> Any:
    """States are x and the command before, the input is its change; `given` is read at every sample."""
    model = do_mpc.model.Model("discrete", "SX")
    x, before = model.set_variable("_x", "x", (4, 1)), model.set_variable("_x", "before")
    change, r = model.set_variable("_u", "change"), model.set_variable("_tvp", "r", (2, 1))
    shapes = {"A": (4, 4), "B": (4, 1), "E": (4, 2), "P": (4, 4), "x_ss": (4, 1), "delta_ss": (1, 1)}
    p = {name: model.set_variable("_p", name, shape) for name, shape in shapes.items()}
    delta = before + change
    model.set_rhs("x", p["A"] @ x + p["B"] * delta + p["E"] @ r)
    model.set_rhs("before", delta)
    model.setup()
    mpc = do_mpc.controller.MPC(model)
    mpc.settings.n_horizon, mpc.settings.t_step, mpc.settings.n_robust = HORIZON, DT, 0
    mpc.settings.state_discretization = "discrete"
    mpc.settings.store_full_solution = mpc.settings.store_lagr_multiplier = False
    mpc.settings.supress_ipopt_output()
    mpc.settings.nlpsol_opts |= {
        "expand": True, "ipopt.hessian_constant": "yes", "ipopt.jac_c_constant": "yes", "ipopt.mu_init": 1e-6,
        "ipopt.warm_start_init_point": "yes", "ipopt.warm_start_bound_push": 1e-8,
        "ipopt.warm_start_mult_bound_push": 1e-8,
    }  # fmt: skip
    x, r, p = model.x["x"], model.tvp["r"], model.p
    delta = model.x["before"] + model.u["change"]
    off, turn = x - p["x_ss"] * r[0], delta - p["delta_ss"] * (r[0] + r[1]) / 2
    mpc.set_objective(lterm=ca.bilin(Q, off, off) + R_MPC * turn**2, mterm=ca.bilin(p["P"], off, off))
    mpc.set_rterm(rterm=ca.SX(0))
    for side, sign in (("lower", -1), ("upper", 1)):
        mpc.bounds[side, "_u", "change"] = sign * RATE_MAX * DT
        mpc.bounds[side, "_x", "before"] = mpc.terminal_bounds[side, "before"] = sign * DELTA_MAX
    ahead, fixed = mpc.get_tvp_template(), mpc.get_p_template(1)

    def lane(_: float) -> Any:
        ahead["_tvp"] = list(np.column_stack([given["r"][:-1], given["r"][1:]]))
        return ahead

    def matrices(_: float) -> Any:
        fixed["_p", 0] = given["p"]
        return fixed

    mpc.set_tvp_fun(lane)
    mpc.set_p_fun(matrices)
    mpc.setup()
    return mpc


def mpc(departures: dict[str, np.ndarray]) -> np.ndarray:
    over = job.takeover(departures)
    A, B, E_0, E_1 = sampled(over.v)
    x_ss, delta_ss = job.steady_turn(over.v)
    given: dict[str, np.ndarray] = {"r": over.r[0]}
    e_y = np.zeros((over.v.size, over.r.shape[1] - HORIZON))
    rate = np.zeros_like(e_y)
    for i in range(over.v.size):
        P = solve_discrete_are(A[i], B[i][:, None], Q, R_MPC)
        lane = np.column_stack([E_0[i], E_1[i]])
        given["p"] = np.concatenate([one.ravel("F") for one in (A[i], B[i], lane, P, x_ss[i], delta_ss[i : i + 1])])
        if not CONTROLLER:
            CONTROLLER.append((controller(given), given))
        law, read = CONTROLLER[0]
        read.update(given)
        law.reset_history()
        x = np.append(over.x[i], over.delta[i])
        law.x0 = x
        law.set_initial_guess()
        for k in range(int(over.left[i] / DT) + 2):
            e_y[i, k], rate[i, k] = x[:2]
            read["r"] = over.r[i, k : k + HORIZON + 2]
            delta = x[4] + float(law.make_step(x[:, None])[0, 0])
            x = np.append(A[i] @ x[:4] + B[i] * delta + E_0[i] * over.r[i, k] + E_1[i] * over.r[i, k + 1], delta)
    return job.score(over, e_y, rate)


CONTROLLER: list[Any] = []  # made and compiled once
# -------------------------------------------------------------------------------------------------------- end of job

if __name__ == "__main__":
    warnings.simplefilter("ignore", FutureWarning)  # of CasADi, about calls inside do-mpc
    job.main(
        "do-mpc + NumPy", __file__, ("do-mpc", "casadi", "numpy", "scipy"),
        {"none": no_control, "lqr": lqr, "mpc": mpc}, once=("mpc",),
    )  # fmt: skip
