"""Run what is compiled once, so that the compiled code is on disk before several test workers ask for it."""

from __future__ import annotations

import sys

from controllers import LQR, PID, LinearMPC
from ldctoolkit import load_model, simulate
from ldctoolkit.plant_options import PlantOptions, Tyres


def main(which: str) -> None:
    scenarios = load_model("reference").sample(6, 6, seed=1)
    if which == "linear":
        simulate(LQR(), scenarios)
        return
    for controller in (PID(), LinearMPC()):
        simulate(controller, scenarios)
    simulate(LQR(), scenarios, options=PlantOptions(speed="profile", tyres=Tyres(model="magic_formula")))


if __name__ == "__main__":
    main(sys.argv[1])
