"""Compile all closed loops, so that no first run waits for it: ``python tools/compile_loops.py``.

Two processes compile at the same time; a first run compiles in one, and only what it needs.
"""

import multiprocessing

import numpy as np

import ldctoolkit.compiling as compiling
from ldctoolkit.controllers import LQR, PID, LinearMPC
from ldctoolkit.mixture import BoundedGaussianMixture
from ldctoolkit.plant_options import PlantOptions, Tyres
from ldctoolkit.scenario_model.model import load_model
from ldctoolkit.setup import Setup
from ldctoolkit.simulation.loop import simulate
from ldctoolkit.studies.study_file import load_study

_SCENARIOS = load_model("reference").sample(6, 6, seed=1)


def _compile_linear() -> None:
    """The loops of linear laws and the kernel of the linear MPC; the other process tells."""
    compiling.silence()
    LinearMPC().prepare(Setup().plant(np.array([20.0]))).linearised()
    simulate(LQR(), _SCENARIOS)
    simulate(LQR(), _SCENARIOS, options=PlantOptions(speed="profile", tyres=Tyres(model="magic_formula")))


def main() -> None:
    """Compile all of it."""
    other = multiprocessing.get_context("spawn").Process(target=_compile_linear)
    other.start()
    simulate(PID(), _SCENARIOS)
    simulate(LQR(), _SCENARIOS, setup=load_study("my-vehicle").setup())
    BoundedGaussianMixture(1, lower=0.0, upper=1.0).fit([[0.2], [0.4], [0.5], [0.9]])
    other.join()
    simulate(LinearMPC(always_solve=True), _SCENARIOS)  # what is left of it
    if other.exitcode:
        raise SystemExit(other.exitcode)


if __name__ == "__main__":
    main()
