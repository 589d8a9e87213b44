"""Make the bundled scenario model `reference`: draw departures from a stated population and fit K = 10 a side.

The departures are synthetic. The population below has the orders of magnitude of naturalistic driving, it is not
fitted to any recording. Run from the repository's root::

    python tools/make_reference_model.py

It writes ldctoolkit/models/reference.json. With 30,000 events a side it takes about 50 s on one core; the same
seed and the same library versions give the same numbers. The population is described in
docs/explanation/scenario-model.md.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ldctoolkit.departures import LEFT, PARAMETER_NAMES, RIGHT, DepartureParameters, Departures, Plausibility
from ldctoolkit.scenario_model import fit_scenario_model

FloatArray = npt.NDArray[np.float64]
OUTPUT = Path(__file__).resolve().parents[1] / "ldctoolkit" / "models" / "reference.json"
SEED = 20170601
EVENTS = 30_000


@dataclasses.dataclass(frozen=True)
class Side:
    """What differs between the sides."""

    share_urban: float  # of the events
    median_d_y: float  # m
    mean_lateral: float  # m/s^2, mean of v^2 c_0 in the outward frame: positive cuts the bend, negative runs wide


POPULATION = {LEFT: Side(0.45, 0.185, 0.15), RIGHT: Side(0.35, 0.205, -0.15)}

URBAN_SPEED = (14.0, 3.0)  # m/s, mean and standard deviation
MOTORWAY_SPEED = (28.0, 3.5)  # m/s
MEDIAN_T, SPREAD_T = 2.0, 0.6  # s, standard deviation of ln T
DEPTH_WITH_T, SPREAD_D_Y = 0.45, 0.54  # slope of ln d_y over ln T, standard deviation of ln d_y about it
DEEPEST = 1.2  # m
SHARE_SIGMA_Y, SPREAD_SIGMA_Y = 0.25, 0.35  # of d_y, standard deviation of the logarithm
SPREAD_A = 0.3  # m/s^2
MEDIAN_SIGMA_V, SPREAD_SIGMA_V = 0.04, 0.45  # m/s, standard deviation of the logarithm
SPREAD_LATERAL, MOST_LATERAL = 0.5, 2.0  # m/s^2, of v^2 c_0; no event above the second
LEAST_CURVE_SPEED = 8.0  # m/s, below it curvature no longer grows with falling speed
DC_SHARE = 0.5  # spread of v^2 dc over the spread of v^2 c_0
DC_BACK = -0.3  # regression of dc on c_0: bends tend to end


def draw(side: int, n: int, rng: np.random.Generator) -> dict[str, FloatArray]:
    """At least n events of one side; those outside the extraction criteria are left out, so a few more are drawn."""
    p = POPULATION[side]
    m = n + n // 4
    urban = rng.random(m) < p.share_urban
    v_mean = np.where(urban, rng.normal(*URBAN_SPEED, m), rng.normal(*MOTORWAY_SPEED, m))
    ln_t = SPREAD_T * rng.standard_normal(m)
    T = MEDIAN_T * np.exp(ln_t)
    d_y = p.median_d_y * np.exp(DEPTH_WITH_T * ln_t + SPREAD_D_Y * rng.standard_normal(m))
    sigma_y = SHARE_SIGMA_Y * d_y * np.exp(SPREAD_SIGMA_Y * rng.standard_normal(m))
    a_mean = SPREAD_A * rng.standard_normal(m)
    sigma_v = MEDIAN_SIGMA_V * np.exp(SPREAD_SIGMA_V * rng.standard_normal(m))
    square = np.maximum(v_mean, LEAST_CURVE_SPEED) ** 2
    lateral = p.mean_lateral + SPREAD_LATERAL * rng.standard_normal(m)
    rest = SPREAD_LATERAL * np.sqrt(DC_SHARE**2 - DC_BACK**2) * rng.standard_normal(m)
    columns = {"T": T, "d_y": d_y, "sigma_y": sigma_y, "v_mean": v_mean, "a_mean": a_mean, "sigma_v": sigma_v}
    columns |= {"c_0": lateral / square, "dc": (DC_BACK * lateral + rest) / square}
    good = (T > 0.5) & (T < 10.0) & (v_mean > 5.0) & (d_y < DEEPEST) & (np.abs(lateral) < MOST_LATERAL)
    good &= Plausibility().holds(DepartureParameters(np.full(m, side), **columns))
    return {name: columns[name][good][:n] for name in PARAMETER_NAMES}


def departures(n: int, seed: int) -> Departures:
    """n events a side."""
    rng = np.random.default_rng(seed)
    sides = {side: draw(side, n, rng) for side in (LEFT, RIGHT)}
    columns = {name: np.concatenate([sides[LEFT][name], sides[RIGHT][name]]) for name in PARAMETER_NAMES}
    counts = [sides[side]["T"].size for side in (LEFT, RIGHT)]
    total = sum(counts)
    return Departures(
        side=np.repeat([LEFT, RIGHT], counts).astype(np.int64),
        **columns,
        recording=np.full(total, "synthetic"),
        start_time=np.zeros(total),
        samples=np.maximum(np.round(10.0 * columns["T"]), 3).astype(np.int64),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--events", type=int, default=EVENTS, help=f"events a side (default {EVENTS})")
    parser.add_argument("--components", type=int, default=10, help="K a side (default 10)")
    parser.add_argument("--output", type=Path, default=OUTPUT)
    given = parser.parse_args()
    started = time.perf_counter()
    model = fit_scenario_model(
        departures(given.events, SEED),
        components=given.components,
        transform="auto",
        seed=SEED,
        synthetic=True,
        source_provenance={
            "description": "SYNTHETIC: drawn from the population stated in tools/make_reference_model.py with orders "
            "of magnitude of naturalistic driving; not fitted to any recording",
            "script": "tools/make_reference_model.py",
            "events_a_side": given.events,
        },
    )
    model.save(given.output)
    for label, fit in (("left", model.left), ("right", model.right)):
        print(f"{label}: K = {fit.weights_.size}, {fit.n_iter_} passes, converged {fit.converged_}")
    for label, side in (("left", model.provenance.left), ("right", model.provenance.right)):
        print(f"{label}: {side.fidelity.text}")
    print(f"{given.output}: {model.content_hash[:12]}, {time.perf_counter() - started:.1f} s")


if __name__ == "__main__":
    main()
