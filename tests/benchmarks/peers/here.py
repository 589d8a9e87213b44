"""The job with the toolkit: S as the peers work it out, and beside it the whole answer, a ranked study of the same."""

import time

import job
import numpy as np
from job import DELTA_MAX, HORIZON, R_LQR, R_MPC, RATE_MAX, Y_S

import ldctoolkit as ldc

# --------------------------------------------------------------------------------------------------------------- job
LAWS = {
    "none": ldc.NoControl(),
    "lqr": ldc.LQR(r_delta=R_LQR),
    "mpc": ldc.LinearMPC(horizon=HORIZON, r_delta=R_MPC, delta_max=DELTA_MAX, rate_max=RATE_MAX),
}


def scores(departures: dict[str, np.ndarray], law: str) -> np.ndarray:
    scenarios = ldc.Scenarios.from_arrays(**departures)
    return ldc.simulate(LAWS[law], scenarios, y_s=Y_S, settle=0.0, threads=1).S


def ranked(departures: dict[str, np.ndarray]) -> ldc.Ranking:
    study = ldc.study(*LAWS.values(), y_s=Y_S, require="a_y_added_peak_p95 <= 2.0")
    results = ldc.run_study(study, scenarios=ldc.Scenarios.from_arrays(**departures), workers=1)
    return ldc.rank_study(results, study)


# -------------------------------------------------------------------------------------------------------- end of job


def study(departures: dict[str, np.ndarray]) -> dict[str, object]:
    """Processor time [s] of the ranked study, the best of three after the first, and some of what it says."""
    seconds = []
    for _ in range(4):
        start = time.process_time()
        ranking = ranked(departures)
        seconds.append(time.process_time() - start)
    rows = {row["law"]: row for row in ranking.to_polars().to_dicts()}
    said = {name: rows["lqr"][f"{name}_m_s"] for name in ("S_low", "S_high")}
    said |= {name: rows["lqr"][f"baseline_difference_{name}_m_s"] for name in ("low", "high")}
    said["mpc_a_y"] = rows["linear_mpc"]["a_y_added_peak_p95_m_s2"]
    said = {name: round(value, 5) for name, value in said.items()}
    return {"study_seconds": round(min(seconds[1:]), 5), "study": said | {"mpc_unmet": rows["linear_mpc"]["unmet"]}}


if __name__ == "__main__":
    laws = {law: (lambda departures, law=law: scores(departures, law)) for law in LAWS}
    job.main("ldctoolkit", __file__, ("ldctoolkit", "numba", "daqp", "numpy"), laws, shared=0, more=study)
