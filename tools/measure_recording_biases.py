"""What sampling and noise do to each parameter of a departure: the tables of docs/explanation/recording-biases.md.

Departures of the bundled model are driven, measured, written as the tables DataLane and DataWsu, extracted and held
against what was driven. Run from the repository's root::

    python tools/measure_recording_biases.py

20,000 departures take about ten minutes on one core and 0.4 GB of disk; the same seed gives the same numbers.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ldctoolkit import extract_departures, fit_scenario_model, load_model, open_recordings
from ldctoolkit.departures import PARAMETER_NAMES, Departures

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from helpers import round_trip as making

UNITS = {"T": "s", "d_y": "m", "sigma_y": "m", "v_mean": "m/s", "a_mean": "m/s²", "sigma_v": "m/s"}
DRAW, DRIVE, MEASURE, FIT = 11, 5, 7, 1
"""Seeds."""

ROUNDING = 1e-9
"""Errors below it, in any unit, come from the digits of the tables."""


@dataclasses.dataclass(frozen=True)
class Case:
    """One way to measure the same departures."""

    name: str
    factor: float = 1.0
    speed: float | None = None  # m/s, instead of the default noise
    curvature_held: bool = False
    own_turning: bool = False


CASES = (
    Case("sampling alone", 0.0),
    Case("noise", 1.0),
    Case("three times the noise", 3.0),
    Case("speed noise 0.005 m/s", speed=0.005),
    Case("speed noise 0.02 m/s", speed=0.02),
    Case("curvature held for 1 s outside", curvature_held=True),
    Case("the vehicle's own turning in the yaw rate", own_turning=True),
    Case("the vehicle's own turning, no noise", 0.0, own_turning=True),
)


def extracted(case: Case, drive: Any) -> Departures:
    """The departures of one case, through the tables."""
    noise = making.Noise().times(case.factor) if case.factor else making.Noise.none()
    if case.speed is not None:
        noise = dataclasses.replace(noise, speed=case.speed)
    with tempfile.TemporaryDirectory() as folder:
        measured = making.measure(drive, noise, MEASURE, own_turning=case.own_turning)
        paths = making.write_tables(Path(folder), measured)
        return extract_departures(open_recordings(paths, format="spmd-das1")).departures


def lines(case: Case, drive: Any, found: Departures) -> Iterator[str]:
    """The table of one case in Markdown."""
    pairs = making.compare(found, drive)
    truth = drive.planted.parameters
    error = found.matrix()[pairs.found] - truth.matrix()[pairs.planted]
    distance = making.kolmogorov(found, truth)
    yield f"### {case.name}\n"
    yield f"Found again {pairs.found.size:,}, lost {pairs.lost}, not planted {pairs.surplus}.\n"
    yield "| parameter | mean error | median error | standard deviation | 90 % within | Kolmogorov left, right |"
    yield "| --- | --- | --- | --- | --- | --- |"
    for k, name in enumerate(PARAMETER_NAMES):
        e, unit, factor = error[:, k], UNITS.get(name, "1/km"), 1.0 if name in UNITS else 1e3
        values = [e.mean(), np.median(e), e.std(), np.quantile(np.abs(e), 0.9)]
        signs = ("+", "+", "", "")
        shown = zip(values, signs, strict=True)
        figures = [f"{factor * value:{sign}.2g}" if abs(value) > ROUNDING else "0" for value, sign in shown]
        left, right = distance["left"][k], distance["right"][k]
        yield f"| {name} [{unit}] | {' | '.join(figures)} | {left:.3f}, {right:.3f} |"
    yield ""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--events", type=int, default=20_000, help="departures, both sides (default 20000)")
    given = parser.parse_args()
    model = load_model("reference")
    drawn = model.sample(given.events // 2, given.events // 2, seed=DRAW)
    drives = {held: making.drive(drawn, DRIVE, curvature_held=held) for held in (False, True)}
    short = int(np.count_nonzero(~drives[False].planted.reached))
    print(f"{drawn.n:,} departures, {drives[False].trip.size:,} samples; sigma_y not reached in {short}\n")
    for case in CASES:
        found = extracted(case, drives[case.curvature_held])
        print("\n".join(lines(case, drives[case.curvature_held], found)), flush=True)
        if case.name == "noise":
            again = fit_scenario_model(found, components=10, transform="auto", seed=FIT, n_init=2)
            many = 10 * drawn.n
            distance = making.kolmogorov(again.sample(many, many, seed=3), model.sample(many, many, seed=4))
            fitted = (f"{n} {a:.3f}, {b:.3f}" for n, a, b in zip(PARAMETER_NAMES, *distance.values(), strict=True))
            print(f"Fitted again (left, right): {'; '.join(fitted)}\n", flush=True)


if __name__ == "__main__":
    main()
