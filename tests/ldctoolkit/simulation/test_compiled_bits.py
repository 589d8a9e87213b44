"""The same bits whatever was compiled first, and whatever was there already: each process here starts with no cache."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = """
import dataclasses
import sys

import numpy as np

from controllers import LQR, LinearMPC, PreviewProportional
from ldctoolkit import Scenarios, Setup
from ldctoolkit.mixture._kernels import log_density_of_rows, statistics_of_rows
from ldctoolkit.plant_options import Actuator, KalmanFilter, Mismatch, PlantOptions, Sensors, Tyres
from ldctoolkit.simulation import Takeover, drive

rng = np.random.default_rng(5)
v = rng.uniform(8, 30, 40)
scenarios = Scenarios.from_arrays(
    T=rng.uniform(0.5, 6, 40), d_y=rng.uniform(0.05, 0.9, 40), v_mean=v, a_mean=rng.normal(0, 0.3, 40).clip(-0.6, 0.6),
    c_0=rng.normal(0, 0.5, 40) / v**2, dc=rng.normal(0, 0.2, 40) / v**2,
)
options = {
    "ideal": PlantOptions(),
    "actuator": PlantOptions(actuator=Actuator(delta_max=0.5, rate_max=0.4, lag=0.1, delay=0.12)),
    "all": PlantOptions(
        speed="profile", mismatch=Mismatch(m=(0.9, 1.3), mu=(0.4, 1.0)), tyres=Tyres(model="magic_formula"),
        sensors=Sensors(e_y_noise=0.03, delay=0.1, period=0.1, kalman=KalmanFilter()),
    ),
}
x, theta = rng.normal(size=(1000, 3)), 0.3 * rng.normal(size=(3, 10))
theta[:, [4, 7, 9]] = -0.5


def driven(design, option):
    over = Takeover.build(scenarios, Setup(options=options[option]), y_s=0.1)
    outcome = drive(design, over).outcome("control")
    names = [f.name for f in dataclasses.fields(outcome.companions)]
    return [outcome.S, *(getattr(outcome.companions, name) for name in names)]


def mixture(rows):
    pieces = [x[:700], x[700:]] if rows == "parts" else [x]
    density = np.concatenate([log_density_of_rows(piece, np.zeros(3), np.ones(3), theta) for piece in pieces])
    return [density, statistics_of_rows(x, None, np.zeros(3), np.ones(3), theta)[1]]


def frozen():
    x.flags.writeable = False
    return mixture("whole")


cases = {
    "lanes": lambda: driven(LQR(), "ideal"),
    "one by one": lambda: driven(PreviewProportional(), "actuator"),
    "everything": lambda: driven(PreviewProportional(), "all"),
    "stepped": lambda: driven(LinearMPC(horizon=5), "actuator"),
    "mixture": lambda: mixture("whole"),
    "mixture of read-only rows": frozen,
}
order = list(cases) if sys.argv[1] in ("forwards", "backwards") else [sys.argv[1]]
if sys.argv[1] == "backwards":
    order.reverse()
values = {name: cases[name]() for name in order}
for name in sorted(order):
    print(name, *(np.ascontiguousarray(value).tobytes().hex() for value in values[name]))
"""


def numbers(order: str, cache: Path) -> str:
    """What a process of its own prints."""
    run = subprocess.run(
        [sys.executable, "-c", PROGRAM, order],
        env=os.environ | {"NUMBA_CACHE_DIR": str(cache)},
        capture_output=True, text=True, check=False, timeout=900,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    return run.stdout


@pytest.mark.slow
def test_no_number_depends_on_what_was_compiled_before(tmp_path: Path) -> None:
    """Compiled in one order or in the other, some of it by another process, or all of it: the same bits."""
    forwards = numbers("forwards", tmp_path / "a")
    assert len(forwards.splitlines()) == 6
    assert numbers("stepped", tmp_path / "b") in forwards
    assert numbers("backwards", tmp_path / "b") == forwards
    assert numbers("forwards", tmp_path / "b") == forwards
