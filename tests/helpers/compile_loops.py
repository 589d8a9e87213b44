"""Run what is compiled once, so that the compiled code is on disk before several test workers ask for it."""

from __future__ import annotations

from controllers import LQR, PID, LinearMPC
from ldctoolkit import load_model, simulate
from ldctoolkit.plant_options import PlantOptions, Tyres


def main() -> None:
    scenarios = load_model("reference").sample(6, 6, seed=1)
    for controller in (LQR(), PID(), LinearMPC()):
        simulate(controller, scenarios)
    simulate(LQR(), scenarios, options=PlantOptions(speed="profile", tyres=Tyres(model="magic_formula")))


if __name__ == "__main__":
    main()
