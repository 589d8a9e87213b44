"""Compile all closed loops, so that no first run waits for it: ``python tools/compile_loops.py``.

Two processes compile at the same time; a first run compiles in one, and only what it needs.
"""

import multiprocessing

import ldctoolkit.compiling as compiling
from ldctoolkit.controllers import LQR, PID, LinearMPC
from ldctoolkit.plant_options import PlantOptions, Tyres
from ldctoolkit.scenario_model.model import load_model
from ldctoolkit.simulation.loop import simulate

_SCENARIOS = load_model("reference").sample(6, 6, seed=1)


def _compile_general() -> None:
    """The loop of any plant; the other process tells."""
    compiling.silence()
    simulate(LQR(), _SCENARIOS, options=PlantOptions(speed="profile", tyres=Tyres(model="magic_formula")))


def main() -> None:
    """Compile all of it."""
    other = multiprocessing.get_context("spawn").Process(target=_compile_general)
    other.start()
    for controller in (LQR(), PID(), LinearMPC()):
        simulate(controller, _SCENARIOS)
    other.join()
    if other.exitcode:
        raise SystemExit(other.exitcode)


if __name__ == "__main__":
    main()
