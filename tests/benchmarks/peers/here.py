"""The job with the toolkit."""

import job
import numpy as np
from job import DELTA_MAX, HORIZON, R_LQR, R_MPC, RATE_MAX, Y_S

# --------------------------------------------------------------------------------------------------------------- job
import ldctoolkit as ldc

LAWS = {
    "none": ldc.NoControl(),
    "lqr": ldc.LQR(r_delta=R_LQR),
    "mpc": ldc.LinearMPC(horizon=HORIZON, r_delta=R_MPC, delta_max=DELTA_MAX, rate_max=RATE_MAX),
}


def scores(departures: dict[str, np.ndarray], law: str) -> np.ndarray:
    scenarios = ldc.Scenarios.from_arrays(**departures)
    return ldc.simulate(LAWS[law], scenarios, y_s=Y_S, settle=0.0, threads=1).S


# -------------------------------------------------------------------------------------------------------- end of job

if __name__ == "__main__":
    laws = {law: (lambda departures, law=law: scores(departures, law)) for law in LAWS}
    job.main("ldctoolkit", __file__, ("ldctoolkit", "numba", "daqp", "numpy"), laws, shared=0)
