"""One battery for every registered controller."""

from __future__ import annotations

import copy
import dataclasses
import pickle
from pathlib import Path

import numpy as np
import pytest

import controllers
from ldctoolkit import (
    BicycleModel,
    Controller,
    LinearLaw,
    Plant,
    Preview,
    RecordedPath,
    Scenarios,
    SteeringLaw,
    controller_class,
    controller_names,
    register,
    simulate,
)
from ldctoolkit.errors import InputError, UnknownNameError
from ldctoolkit.law_checks import check_controller, check_law, check_step

ZOO = ["linear_mpc", "lqr", "none", "preview_proportional"]


@pytest.fixture(params=ZOO)
def kind(request: pytest.FixtureRequest) -> type[Controller]:
    return controller_class(request.param)


def test_the_zoo_is_found_by_entry_points() -> None:
    assert set(ZOO) <= set(controller_names())
    folder = Path(controllers.__file__).parent
    for name in ZOO:
        assert (folder / f"{name}.py").is_file()
        assert controller_class(name).name == name


def test_frozen_equal_picklable_and_documented(kind: type[Controller]) -> None:
    one, other = kind(), kind()
    assert one == other
    assert hash(one) == hash(other)
    assert pickle.loads(pickle.dumps(one)) == one  # worker processes receive designs
    assert copy.deepcopy(one) == one
    for declared in kind.gains():
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(one, declared.name, 0.0)
        assert declared.description
        assert declared.unit
        assert f"{declared.name}" in (kind.__doc__ or "")
        assert declared.check(declared.default, kind.name) == declared.default
    assert kind.title


def test_bounds_are_enforced(kind: type[Controller]) -> None:
    for declared in kind.gains():
        if declared.choices:
            with pytest.raises(InputError, match=rf"{kind.name}\.{declared.name}: 'x'"):
                kind(**{declared.name: "x"})
        elif not isinstance(declared.default, bool):
            for beyond in (declared.lower - 1.0, declared.upper + 1.0):
                with pytest.raises(InputError, match=rf"{kind.name}\.{declared.name}: .*allowed"):
                    kind(**{declared.name: beyond})


def test_quiet_on_a_straight_centred_road(kind: type[Controller]) -> None:
    plant = Plant.build(BicycleModel(), [10.0, 20.0, 30.0], 0.05)
    law = check_law(check_controller(kind()).prepare(plant), 3, kind.name)
    if isinstance(law, LinearLaw | RecordedPath):
        return  # no constant term by its type
    nothing = Preview(*[np.zeros((3, law.preview_times.size))] * 2)
    result = law.step(np.zeros(3), np.zeros((3, 4)), nothing, np.zeros(3), law.init(3))
    delta, _, status = check_step(result, 3, kind.name)
    np.testing.assert_array_equal(delta, 0.0)
    np.testing.assert_array_equal(status, 0)


def test_same_input_same_output_and_inputs_untouched(kind: type[Controller]) -> None:
    scenarios = Scenarios.from_arrays(T=[2.0, 5.0, 3.0], d_y=[0.4, 0.7, 0.3], v_mean=[14.0, 28.0, 20.0], c_0=1e-3)
    before = copy.deepcopy(scenarios)
    design = kind()
    first, second = simulate(design, scenarios), simulate(design, scenarios)
    np.testing.assert_array_equal(first.S, second.S)
    for field in dataclasses.fields(scenarios):
        np.testing.assert_array_equal(getattr(scenarios, field.name), getattr(before, field.name))
    assert np.isfinite(first.S).all()


def test_a_law_that_can_be_cut_down_commands_the_same(kind: type[Controller]) -> None:
    """`take` between two steps, twice in a row: what remains sees no difference."""
    n = 9
    rng = np.random.default_rng(5)
    plant = Plant.build(BicycleModel(), rng.uniform(8, 35, n), 0.05)
    law = kind().prepare(plant)
    if isinstance(law, LinearLaw | RecordedPath):
        return  # the compiled loops take them scenario by scenario
    p = law.preview_times.size

    def given(rows: np.ndarray, k: int) -> tuple[np.ndarray, np.ndarray, Preview, np.ndarray]:
        rng = np.random.default_rng(k)
        x = rng.normal(size=(n, 4)) * [0.8, 0.4, 0.03, 0.1]
        yaw_rate, heading, previous = rng.normal(0, 0.03, (n, p)), rng.normal(0, 0.03, (n, p)), rng.normal(0, 0.05, n)
        return np.full(rows.size, 0.05 * k), x[rows], Preview(yaw_rate[rows], heading[rows]), previous[rows]

    everything = np.arange(n)
    whole, part, rows = law.init(n), law.init(n), everything
    some: SteeringLaw = law
    for k, kept in enumerate(([0, 1, 3, 4, 6, 8], [1, 2, 5], [0])):
        delta, whole, status = law.step(*given(everything, k), whole)
        ours, part, ours_status = some.step(*given(rows, k), part)
        np.testing.assert_array_equal(ours, delta[rows])
        np.testing.assert_array_equal(ours_status, status[rows])
        taken = some.take(np.array(kept), part)
        if taken is None:
            return  # it cannot: scenarios that have ended are shown to it as zeros
        some, part = taken
        rows = rows[kept]
        assert isinstance(some, SteeringLaw)


def test_names_are_checked() -> None:
    with pytest.raises(UnknownNameError, match=r"law 'lqq': no such controller; did you mean 'lqr'\?"):
        controller_class("lqq")
    with pytest.raises(InputError, match="already registered"):

        @register
        @dataclasses.dataclass(frozen=True)
        class Second(Controller):
            name = "lqr"
            title = "Second"

            def prepare(self, plant: Plant) -> RecordedPath:
                return RecordedPath()

    with pytest.raises(InputError, match="subclass of Controller"):
        register(int)  # type: ignore[arg-type]
