"""Translate the nonlinear plant from CasADi into the source that numba compiles.

Run from the repository's root after a change of tools/nonlinear_plant.py::

    python tools/compile_nonlinear.py

It writes ldctoolkit/vehicle/_nonlinear_compiled.py. A test compares the file with the text made here.
"""

from __future__ import annotations

from pathlib import Path

from casadi_to_numba import numba_function
from nonlinear_plant import nonlinear_dynamics

from ldctoolkit.errors import LdcError
from ldctoolkit.whole_file import write_whole

OUTPUT = Path(__file__).resolve().parents[1] / "ldctoolkit" / "vehicle" / "_nonlinear_compiled.py"

HEADER = '''\
"""The nonlinear plant for compiled loops. Generated: do not edit.

Made by ``python tools/compile_nonlinear.py`` from `nonlinear_dynamics` of `tools/nonlinear_plant.py`, operation by
operation. The compiler takes a while to import: callers import this module where they call it.
"""

import math

import numba

'''

DOCSTRING = """\
Accelerations of the lane errors and lateral acceleration, of `nonlinear_dynamics`: same order, same units.

    Returns
    -------
    tuple of three floats
        e_y_acceleration [m/s^2], e_psi_acceleration [rad/s^2], a_y [m/s^2].
    """


def text() -> str:
    """The whole file."""
    return HEADER + "\n" + numba_function(nonlinear_dynamics(), "nonlinear_rhs", DOCSTRING)


def main() -> None:
    write_whole(OUTPUT, text().encode(), LdcError)
    print(OUTPUT)


if __name__ == "__main__":
    main()
