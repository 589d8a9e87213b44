"""Compile the closed loops once, so that no first run waits for it: ``python -m ldctoolkit.studies.compile_loops``.

What numba compiles lies on disk afterwards, beside the code. Two processes compile at the same time.
"""

import multiprocessing


def compile_linear() -> None:
    """The loop of linear laws on the ideal plant, and that of laws that are stepped."""
    from ldctoolkit import load_model, simulate
    from ldctoolkit.controllers import LQR, PID, LinearMPC

    scenarios = load_model("reference").sample(6, 6, seed=1)
    for controller in (LQR(), PID(), LinearMPC()):
        simulate(controller, scenarios)


def compile_general() -> None:
    """The loop of any plant."""
    from ldctoolkit import load_model, simulate
    from ldctoolkit.controllers import LQR
    from ldctoolkit.plant_options import PlantOptions, Tyres

    scenarios = load_model("reference").sample(6, 6, seed=1)
    simulate(LQR(), scenarios, options=PlantOptions(speed="profile", tyres=Tyres(model="magic_formula")))


def main() -> None:
    """Compile all of it."""
    context = multiprocessing.get_context("spawn")
    other = context.Process(target=compile_general)
    other.start()
    compile_linear()
    other.join()
    if other.exitcode:
        raise SystemExit(other.exitcode)


if __name__ == "__main__":
    main()
