"""Every law of the zoo keeps the contract, and drives real departures."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from helpers.closed_loop import ZOO
from helpers.errors import refused
from ldctoolkit import BicycleModel, Plant, Scenarios, controller_class, controllers, register, simulate
from ldctoolkit.control import Controller, EventStatus, SteeringLaw
from ldctoolkit.controllers import PID, PurePursuit, SlidingMode, Stanley
from ldctoolkit.errors import InputError
from ldctoolkit.studies import Study
from ldctoolkit.testing import CHECKS, ContractSettings, contract_faults

ITERATIVE = {"linear_mpc", "nonlinear_mpc"}
"""Laws with a solver: mirrored to 1e-9 of the largest command; all others to the bit."""

SLOW = {(name, "extremes") for name in ZOO if name != "lqr"} | {
    (name, "picklable") for name in ZOO if name not in ("lqr", "barrier_filter")
}
"""A solver prepared again for every gain; a process of its own for every law."""

CASES = [
    pytest.param(name, check, marks=pytest.mark.slow if (name, check) in SLOW else ())
    for name in ZOO
    for check in CHECKS
]


@pytest.mark.parametrize(("name", "check"), CASES)
def test_the_contract(name: str, check: str) -> None:
    settings = ContractSettings(mirror_tolerance=1e-9 if name in ITERATIVE else 0.0)
    assert not [str(fault) for fault in contract_faults(controller_class(name), checks=[check], settings=settings)]


DESIGNS: dict[str, Controller] = {
    "stanley": controllers.Stanley(k=2.0, k_d_steer=0.3),
    "pid": controllers.PID(K_i=-0.01, T_t=0.3, delta_max=0.05, K_p=-0.015),
    "sliding_mode": controllers.SlidingMode(lambda_=3.0, k_1=4.0, k_2=2.0, T_lp=0.0),
    "pure_pursuit": controllers.PurePursuit(T_lp=0.4, l_min=12.0, delta_max=0.05),
    "lqi": controllers.LQI(q_i=3.0, r_delta=30.0),
    **{
        f"linear_mpc, {solver}": controllers.LinearMPC(
            horizon=10, delta_max=0.03, rate_max=0.1, r_delta=5.0, solver=solver, always_solve=solver == "osqp"
        )
        for solver in ("osqp", "daqp")
    },
    "linear_mpc, soft": controllers.LinearMPC(
        horizon=10, r_delta=20.0, a_y_max=2.0, jerk_max=9.0, e_y_max=1.0, blocks=4
    ),
    "nonlinear_mpc, soft": controllers.NonlinearMPC(
        horizon=8, mu=0.3, a_y_max=2.0, jerk_max=20.0, e_y_max=0.5, r_delta=100.0
    ),
    **{
        f"barrier_filter, {inner}": controllers.BarrierFilter(inner=inner, inner_gains=gains, e_y_max=0.9, gamma_1=0.3)
        for inner, gains in (("pid", "K_i=-0.01"), ("stanley", "k_d_steer=0.3"), ("sliding_mode", ""), ("lqi", ""))
    },
}
"""Gains that switch on what the defaults leave off, or are far from them."""


LONG = ("linear_mpc, osqp", "linear_mpc, soft", "nonlinear_mpc, soft")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if name in LONG else ()) for name in DESIGNS]
)
def test_designs_off_the_defaults_keep_it(name: str) -> None:
    """Without `picklable`, a process that asks nothing of the gains; those of a solver or around another law without
    `extremes`, which prepares them again for every gain.
    """
    design = DESIGNS[name]
    checks = [check for check in CHECKS if check != "picklable" and (check != "extremes" or "," not in name)]
    settings = ContractSettings(mirror_tolerance=1e-9 if design.name in ITERATIVE else 0.0)
    assert not [str(fault) for fault in contract_faults(design, checks=checks, settings=settings)]


def test_the_zoo_is_found_by_entry_points() -> None:
    config = tomllib.loads((Path(controllers.__file__).parent.parent / "pyproject.toml").read_text(encoding="utf-8"))
    listed = config["project"]["entry-points"]["ldctoolkit.controllers"]
    assert set(listed) <= set(ZOO)
    for name, value in listed.items():
        assert value.partition(":")[0] == f"ldctoolkit.controllers.{name}"
        assert (Path(controllers.__file__).parent / f"{name}.py").is_file()
        assert controller_class(name).name == name


@pytest.mark.parametrize("name", ZOO)
def test_every_gain_is_documented(name: str) -> None:
    kind = controller_class(name)
    assert kind.__doc__
    for declared in kind.gains():
        assert declared.name in kind.__doc__


@pytest.mark.parametrize("name", ZOO)
def test_a_design_in_a_study_file_is_the_same_design(name: str, tmp_path: Path) -> None:
    """Gains at their bounds, or another word: written by hand's rules, read by the study, the same controller."""
    kind = controller_class(name)
    given = {}
    for declared in kind.gains():
        if declared.choices:
            given[declared.name] = declared.choices[-1]
        elif not isinstance(declared.default, str | bool) and declared.name != "l_min":  # its range is the vehicle's
            middle = declared.default + 0.25 * (min(declared.upper, 1e3) - declared.default)
            given[declared.name] = type(declared.default)(middle)
    try:
        design = kind(**given)
    except InputError:  # gains that exclude each other
        design, given = kind(), {}
    values = (f"{key} = {value!r}" for key, value in given.items())
    text = "\n".join(['name = "s"', "[[design]]", f'law = "{name}"', "[design.gains]", *values])
    (tmp_path / "s.toml").write_text(text, encoding="utf-8")
    (read,) = Study.from_toml(tmp_path / "s.toml").designs
    for declared in kind.gains():
        if declared.name != "convention":  # which follows the case unless it is given
            assert getattr(read.controller(), declared.name) == getattr(design, declared.name)
    (again,) = Study.from_dict(Study.from_toml(tmp_path / "s.toml").content()).designs
    assert (again, again.id) == (read, read.id)


@pytest.mark.parametrize("name", ZOO)
def test_a_law_that_steers_can_be_cut_down(name: str) -> None:
    """So that scenarios that have ended cost nothing; that no command changes with it is in the contract."""
    law = controller_class(name)().prepare(Plant.build(BicycleModel(), [10.0, 20.0], 0.05))
    if isinstance(law, SteeringLaw):
        assert type(law).take is not SteeringLaw.take


def test_only_controllers_are_registered() -> None:
    with refused("controller", value=int, allowed="a subclass of Controller"):
        register(int)  # type: ignore[arg-type]


SOME = Scenarios.from_arrays(
    T=[2.5, 6.0, 4.0, 5.0], d_y=[0.4, 0.7, 0.6, 0.9], v_mean=[11.0, 18.0, 27.0, 38.0], c_0=[1e-3, -2e-3, 0.0, 5e-4]
)


@pytest.mark.parametrize(
    ("design", "reduction", "left", "beyond"),
    [
        (PID(K_p=-0.015), 0.1, 0.1, 0.25),
        (Stanley(), 0.2, 0.03, 0.05),
        (SlidingMode(), 0.1, 1e-3, 0.01),
        (PurePursuit(T_lp=1.0), 0.2, 0.15, 0.3),  # what side slip leaves in a bend
    ],
    ids=lambda value: value.name if isinstance(value, Controller) else "",
)
def test_it_brings_departures_back(design: Controller, reduction: float, left: float, beyond: float) -> None:
    """What is left of e_y [m] in the end, and how far it goes beyond the centre on the way."""
    out = simulate(design, SOME, y_s=0.1, settle=20.0 if design.name == "pid" else 10.0, trajectories=True)
    assert (out.status == EventStatus.OK).all()
    assert (out.reduction > reduction).all()
    paths = out.trajectories
    for i in range(4):
        e_y = paths.x[i, np.isfinite(paths.t[i]), 0]
        straight = design.name == "pure_pursuit" and SOME.c_0[i] == 0.0
        assert abs(e_y[-1]) < (0.01 if straight else left)
        assert e_y.min() > -beyond
    assert np.nanmax(np.abs(paths.delta)) <= 0.1
