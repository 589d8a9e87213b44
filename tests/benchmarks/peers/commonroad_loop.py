"""The job's LQR in the loop of CommonRoad's control toolbox: its dynamic bicycle, its Runge-Kutta steps.

The vehicle drives in the plane, with the sine and cosine of its angles, and e_y is taken from the lane's path: S is not
quite that of the linear error dynamics. The gain follows from the toolbox's own linearisation. There is no MPC: the
toolbox's tracks a trajectory in the plane, with the steering rate as input and without a limit on the angle, which is
another problem. The loop takes steps of its compiled discrete-time model, 0.4 ms a sample; `Simulation.simulate`, which
integrates each sample by `solve_ivp` with and without a disturbance, takes 11 ms.
"""

import job
import numpy as np
from commonroad_control.vehicle_dynamics.dynamic_bicycle.dynamic_bicycle import DynamicBicycle
from commonroad_control.vehicle_parameters.vehicle_parameters import VehicleParameters
from job import DT, R_LQR, VEHICLE, Q
from scipy.linalg import solve_discrete_are

# --------------------------------------------------------------------------------------------------------------- job
STEPS, GRAVITY = 5, 9.81  # of Runge-Kutta in a sample


def vehicle() -> DynamicBicycle:
    """The job's: stiffness of an axle over its load, as the toolbox takes it."""
    l_f, l_r, m = VEHICLE["l_f"], VEHICLE["l_r"], VEHICLE["m"]
    wheelbase = l_f + l_r
    parameters = VehicleParameters(
        l_wb=wheelbase, l_f=l_f, l_r=l_r, m=m, I_zz=VEHICLE["I_z"], h_cog=0.0, a_long_max=10.0, a_lat_max=10.0,
        steering_angle_max=1.0, steering_angle_velocity_max=1.0,
        C_f=2 * VEHICLE["C_af"] * wheelbase / (m * GRAVITY * l_r),
        C_r=2 * VEHICLE["C_ar"] * wheelbase / (m * GRAVITY * l_f),
    )  # fmt: skip
    return DynamicBicycle(parameters, DT / STEPS)


def gain(model: DynamicBicycle, v: float) -> np.ndarray:
    """LQR gain on (e_y, de_y/dt, e_psi, de_psi/dt) by the linearisation in straight driving at v."""
    _, A, _ = model.linearize_dt_nom_at(np.array([0.0, 0.0, v, 0.0, 0.0, 0.0, 0.0]), np.zeros(2))
    A = np.linalg.matrix_power(A, STEPS)
    lateral = [1, 3, 4, 5]  # y, lateral velocity, heading, yaw rate
    to_error = np.eye(4)
    to_error[1, 2] = v
    B = to_error @ A[lateral, 6]
    A = to_error @ A[np.ix_(lateral, lateral)] @ np.linalg.inv(to_error)
    P = solve_discrete_are(A, B[:, None], Q, R_LQR)
    return (B @ P @ A) / (R_LQR + B @ P @ B)


def no_control(departures: dict[str, np.ndarray]) -> np.ndarray:
    return job.takeover(departures).S


def lqr(departures: dict[str, np.ndarray]) -> np.ndarray:
    over, model, still = job.takeover(departures), vehicle(), np.zeros(2)
    x_ss, delta_ss = job.steady_turn(over.v)
    e_y, rate = np.zeros_like(over.r), np.zeros_like(over.r)
    for i, v in enumerate(over.v):
        K, end = gain(model, v), int(over.left[i] / DT) + 2
        fine = np.arange(10 * end + 1) * DT / 10  # the lane's path, by the trapezoidal rule
        r = np.interp(fine, DT * np.arange(over.r.shape[1]), over.r[i])
        turned = np.append(0.0, np.cumsum(0.5 * (r[1:] + r[:-1]) * DT / 10))
        along, aside = np.cos(turned), np.sin(turned)
        path = [np.append(0.0, np.cumsum(0.5 * v * (one[1:] + one[:-1]) * DT / 10)) for one in (along, aside)]
        e_psi, yaw_rate = over.x[i, 2], over.x[i, 3] + over.r[i, 0]
        v_y = (over.x[i, 1] - v * np.sin(e_psi)) / np.cos(e_psi)
        state = np.array([0.0, over.x[i, 0], v, v_y, e_psi, yaw_rate, over.delta[i]])
        for k in range(end):
            j = 10 * k
            e_psi = state[4] - turned[j]
            e_y[i, k] = (state[1] - path[1][j]) * along[j] - (state[0] - path[0][j]) * aside[j]
            rate[i, k] = state[2] * np.sin(e_psi) + state[3] * np.cos(e_psi)
            x = np.array([e_y[i, k], rate[i, k], e_psi, state[5] - over.r[i, k]])
            state[6] = delta_ss[i] * over.r[i, k] - K @ (x - x_ss[i] * over.r[i, k])
            for _ in range(STEPS):
                state = model.simulate_dt_nom(state, still)
    return job.score(over, e_y, rate)


# -------------------------------------------------------------------------------------------------------- end of job

if __name__ == "__main__":
    job.main(
        "CommonRoad control", __file__, ("commonroad-control", "casadi", "numpy", "scipy"),
        {"none": no_control, "lqr": lqr},
    )  # fmt: skip
