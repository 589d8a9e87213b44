"""Exported C code by itself: warnings, sanitizers, checkers, the test bench, the FMU, and the solver of linear MPC."""

import ctypes
import dataclasses
import re
import shutil
import subprocess
import zipfile
from pathlib import Path
from typing import Any

import fmpy
import fmpy.fmi2
import fmpy.validation
import numpy as np
import pytest

from helpers.closed_loop import Constant, Table, make_scenarios
from helpers.predictive import Held, Slow
from ldctoolkit import Controller, Preview, Setup, load_model
from ldctoolkit.arrays import FloatArray
from ldctoolkit.control import EventStatus
from ldctoolkit.controllers import (
    LQI,
    LQR,
    PID,
    BarrierFilter,
    LinearMPC,
    NonlinearMPC,
    PurePursuit,
    SlidingMode,
    Stanley,
)
from ldctoolkit.controllers.external import compiler
from ldctoolkit.plant_options import Actuator, Driver, PlantOptions
from ldctoolkit.studies.export import export_c
from ldctoolkit.studies.export.c_code import Code
from ldctoolkit.studies.export.loop_check import Compiled, Rows, check, record, struct
from ldctoolkit.studies.study_file import load_study

REALISTIC = load_study("trigger-and-gains").setup()
DRIVER = Driver(straight=0.5, against=0.5, override_torque=2.0, override_time=0.15, ramp=0.35, return_after=0.3)
HELD = dataclasses.replace(REALISTIC, options=dataclasses.replace(REALISTIC.options, driver=DRIVER))
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-pedantic")
SOFT = LinearMPC(horizon=12, a_y_max=2.0, jerk_max=3.0, e_y_max=1.2)
LAWS: dict[str, Controller] = {
    "lqr": LQR(),
    "barrier around pid": BarrierFilter(inner="pid"),
    "pid": PID(),
    "stanley": Stanley(),
    "pure_pursuit": PurePursuit(),
    "sliding_mode": SlidingMode(),
    "table": Table("clip"),
    "mpc": LinearMPC(),
    "mpc, soft": SOFT,
    "mpc, blocks": LinearMPC(horizon=30, blocks=8, e_y_max=0.5),
    "nonlinear": NonlinearMPC(horizon=5),
    "nonlinear, soft": NonlinearMPC(horizon=5, a_y_max=2.0, jerk_max=3.0, e_y_max=1.2),
    "slow": Slow(horizon=5),
    "held": Held(horizon=6),
}
WITH_DRIVER: dict[str, Controller] = {
    "lqi, driver": LQI(conditioned=True),
    "barrier around pid, driver": BarrierFilter(inner="pid", inner_gains="conditioned=true"),
}
SETUPS = dict.fromkeys(WITH_DRIVER, HELD)
LAWS |= WITH_DRIVER


def run(*command: object, cwd: Path, text: str | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(word) for word in command], cwd=cwd, input=text, capture_output=True, text=True, check=False
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "made"


def sources(folder: Path) -> list[str]:
    return [name for name in ("ldc_controller.c", "ldc_predictions.c") if (folder / name).exists()]


def exported(controller: Controller, folder: Path, setup: Setup = REALISTIC, *, fmu: bool = False) -> Code:
    assert (
        export_c(controller, setup, 0.1, folder, scenarios=make_scenarios(60), run_check=False, fmu=fmu).check is None
    )
    return Code.of(controller, setup, 0.1)


# ------------------------------------------------------------------------------------------------ the text


@pytest.mark.parametrize(
    ("name", "single"),
    [
        ("lqr", False), ("table", True), ("lqi, driver", False),
        *(pytest.param(name, i % 2 > 0, marks=pytest.mark.slow) for i, name in enumerate(LAWS)),
    ],
)  # fmt: skip
def test_bench_repeats_the_check_without_warnings(name: str, single: bool, folder: Path) -> None:
    exported(LAWS[name], folder, SETUPS.get(name, REALISTIC))
    precision = ["-DLDC_USE_FLOAT"] if single else []
    built = run("cc", *STRICT, *precision, "-O2", "main.c", *sources(folder), "-lm", "-o", "bench", cwd=folder)
    assert built.returncode == 0, built.stderr
    vectors = (folder / "test_vectors.csv").read_text()
    done = run("./bench", cwd=folder, text=vectors)
    assert done.returncode == 0, done.stdout
    what = "phases, states or authorities of the assist" if name in SETUPS else "phases"
    assert re.fullmatch(rf"\d{{3,4}} steps, largest difference \S+ rad, 0 {what} differ\n", done.stdout)
    lines = vectors.splitlines()
    k, columns = next(i for i in range(1, len(lines)) if lines[i].startswith("0")), lines[0].split(",")
    changes = {"delta": 2e-3, "phase": 1.0} | ({"assist_state": 1.0, "authority": 2e-6} if name in SETUPS else {})
    assert columns[columns.index("delta") :] == list(changes)
    for column, change in changes.items():
        row = lines[k].split(",")
        row[columns.index(column)] = repr(float(row[columns.index(column)]) + change)
        text = "\n".join([*lines[:k], ",".join(row), *lines[k + 1 :], ""])
        assert run("./bench", cwd=folder, text=text).returncode == 1, column


def test_the_bench_ends_at_the_end_of_its_input(folder: Path) -> None:
    """Also where the compiler may assume that there is no NaN."""
    exported(LQR(), folder)
    vectors = (folder / "test_vectors.csv").read_text()
    lines = vectors.splitlines()
    nan = ",".join(["0", "nan", *lines[2].split(",")[2:]])
    for options in (("-O0",), ("-O3", "-ffast-math")):
        built = run("cc", *STRICT, *options, "main.c", *sources(folder), "-lm", "-o", "bench", cwd=folder)
        assert built.returncode == 0, built.stderr
        for text, code, steps, unread in (
            (vectors, 0, len(lines) - 1, 0),
            (vectors.removesuffix("\n"), 0, len(lines) - 1, 0),
            (vectors.replace("\n", "\r\n"), 0, len(lines) - 1, 0),
            (vectors[:-5], 1, len(lines) - 2, 1),
            ("\n".join([*lines[:3], ""]), 0, 2, 0),
            ("\n".join([*lines[:2], "", lines[2]]), 1, 2, 1),
            ("\n".join([*lines[:2], nan]), 1, 1, 1),
            ("\n".join([*lines[:2], lines[2] + ",1"]), 1, 1, 1),
            (lines[0], 1, 0, 0),
            ("", 1, 0, 1),
        ):
            done = subprocess.run(["./bench"], cwd=folder, input=text, capture_output=True, text=True, timeout=60)
            assert done.returncode == code, (options, text[-300:], done.stdout)
            assert done.stdout.startswith(f"{steps} steps, ")
            assert (f"\n{unread} rows are not " in done.stdout) == (unread > 0)


CPP = """
#include "ldc_controller.h"
#include <cstdio>

int main()
{
    static ldc_state state;
    ldc_inputs in = ldc_inputs();
    ldc_outputs out;
    ldc_init(&state);
    in.v = 20;
    in.wheel = static_cast<ldc_real>(0.03125);
    const uint32_t status = ldc_step(&in, &state, &out);
    std::printf("%u %d %g\\n", unsigned(status | LDC_OK), int(out.phase), double(out.delta));
    return 0;
}
"""


@pytest.mark.parametrize("name", ["lqr", "mpc, soft"])
def test_a_host_in_cpp(name: str, folder: Path) -> None:
    if not shutil.which("c++"):
        pytest.skip("no C++ compiler")
    exported(LAWS[name], folder, SETUPS.get(name, REALISTIC))
    (folder / "host.cpp").write_text(CPP)
    for precision in ((), ("-DLDC_USE_FLOAT",)):
        for command in (
            ("cc", *STRICT, *precision, "-c", "ldc_controller.c"),
            ("c++", "-std=c++11", *STRICT[1:], "-Wold-style-cast", *precision, "host.cpp", "ldc_controller.o", "-lm"),
        ):
            done = run(*command, cwd=folder)
            assert (done.returncode, done.stderr) == (0, "")
        assert run("./a.out", cwd=folder).stdout == "0 0 0.03125\n"


@pytest.mark.parametrize("name", ["lqr", "lqi, driver", *(pytest.param(x, marks=pytest.mark.slow) for x in LAWS)])
def test_cppcheck_has_no_warnings(name: str, folder: Path) -> None:
    if not shutil.which("cppcheck"):
        pytest.skip("cppcheck is not installed")
    exported(LAWS[name], folder, SETUPS.get(name, REALISTIC))
    options = "--enable=all --suppress=missingIncludeSystem --inconclusive --error-exitcode=1 --std=c99 --quiet"
    done = run("cppcheck", *options.split(), "ldc_controller.c", "main.c", cwd=folder)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


HARNESS = """
#include "ldc_controller.h"
#include <math.h>
#include <stdio.h>
#include <string.h>

static unsigned long long seed = 88172645463325252ull;
static double uniform(void)
{{
    seed ^= seed << 13;
    seed ^= seed >> 7;
    seed ^= seed << 17;
    return (double)(seed >> 11) / 9007199254740992.0;
}}
static double wild(double size)
{{
    static const double odd[] = {{NAN, INFINITY, -INFINITY, 1e308, -1e308, 1e-320, 0.0, -0.0, 1000.0, -1000.0, 1000.1}};
    if (uniform() < 0.002) {{ return odd[(int)(uniform() * 11.0)]; }}
    return size * (2.0 * uniform() - 1.0) * (uniform() < 0.1 ? 30.0 : 1.0);
}}
int main(void)
{{
    static ldc_state s;
    ldc_inputs in;
    ldc_outputs out;
    double last = 0.0, wheel = 0.0;
    long phases[3] = {{0, 0, 0}}, states[4] = {{0, 0, 0, 0}}, bad = 0, handed_over = 0;
    int stuck = 0, row = 0;
    ldc_init(&s);
    for (long n = 0; n < {steps}; n++) {{
{fill}
        if (uniform() < 0.9) {{ in.v = (ldc_real)(1.0 + 89.0 * uniform()); }}
        stuck = (uniform() < 0.002) ? (int)(uniform() * 20.0) : stuck - 1;
        if (stuck > 0) {{ in.v = -1; }}
        in.engage = uniform() < 0.01 ? 0 : 1 + (uniform() < 0.01) * 2147483646;
        ldc_step(&in, &s, &out);
        if (!isfinite(out.delta) || out.phase < 0 || out.phase > 2) {{ return 2; }}
        if (isfinite(in.wheel) && fabs((double)in.wheel) <= 1000.0) {{ wheel = (double)in.wheel; }}
        if (out.phase == 0 && (out.side != 0 || (double)out.delta != wheel)) {{ return 6; }}
        row = (out.status & (LDC_INPUT | LDC_HELD)) ? row + 1 : 0;
        if (out.phase != 0 && row > LDC_HOLD_STEPS) {{ return 7; }}
        if (out.status & LDC_HANDED_OVER) {{
            handed_over++;
            if (out.phase != 0 || in.engage == 0) {{ return 8; }}
        }}
        if (out.phase == 0) {{ row = 0; }}
        if (out.status & LDC_INPUT) {{
            bad++;
            if (out.phase != 0 && (double)out.delta != last) {{ return 3; }}
        }} else if (!isfinite(in.v) || in.v < 1 || in.v > 90) {{
            return 4;
        }}
        if (out.iterations < 0 || out.iterations > {bound}) {{ return 5; }}
        phases[out.phase]++;
{driver}
        last = (double)out.delta;
    }}
    printf("%ld %ld %ld %ld %ld ", phases[0], phases[1], phases[2], bad, handed_over);
    printf("%ld %ld %ld %ld\\n", states[0], states[1], states[2], states[3]);
    return 0;
}}
"""
OF_DRIVER = """
        if ((out.assist_state == 0) != (out.phase == 0) || !(out.authority >= 0 && out.authority <= 1)) { return 9; }
        if ((out.assist_state == 0 || out.assist_state == 3) && out.authority > 0) { return 10; }
        states[out.assist_state]++;
"""
SIZES = {
    "v": 60.0, "driver_torque": 4.0, "e_psi": 0.5, "e_psi_rate": 0.5, "wheel": 0.1, "curvature": 0.005,
    "heading": 0.2, "frame_e_psi": 0.3,
}  # fmt: skip


@pytest.mark.parametrize("name", ["lqr", "lqi, driver", *(pytest.param(x, marks=pytest.mark.slow) for x in LAWS)])
def test_sanitizers_are_quiet_on_wild_inputs(name: str, folder: Path) -> None:
    code = exported(LAWS[name], folder, SETUPS.get(name, REALISTIC))
    fill = []
    for field, size, kind in code.inputs:
        value = f"({kind})wild({SIZES.get(field, SIZES.get(field.removesuffix('_seen'), 2.0))})"
        if kind == "int32_t":
            value = "(int32_t)(uniform() * 4.0) - 1"
        fill.append(
            f"for (int i = 0; i < {size}; i++) {{ in.{field}[i] = {value}; }}" if size else f"in.{field} = {value};"
        )
    form = code.schedule.form
    bound = (form.sqp or form.mpc or {"iterations": 0})["iterations"] * (form.sqp or {"programs": 1})["programs"]
    # a step of a predictive controller takes a hundred to a thousand times as long as that of a linear law
    steps = 3_000 if form.sqp else 10_000 if form.mpc else 100_000
    driver = OF_DRIVER if name in SETUPS else ""
    (folder / "fuzz.c").write_text(HARNESS.format(steps=steps, fill="\n".join(fill), bound=bound, driver=driver))
    sanitizers = ("-g", "-O1", "-fsanitize=undefined,address,float-cast-overflow", "-fno-sanitize-recover=all")
    builds: tuple[tuple[tuple[str, ...], ...], ...] = (
        (sanitizers, (), ()),
        (sanitizers, ("-DLDC_USE_FLOAT",), ()),
        ((), (), ("-O3", "-ffast-math")),
        ((), ("-DLDC_USE_FLOAT",), ("-O3", "-ffast-math")),
    )
    few = form.mpc is not None and name != "mpc"  # long code takes long to compile
    for checks, precision, fast in builds[::3] if few or form.sqp else builds:
        for arguments in (
            [*fast, "-c", *sources(folder)],
            ["fuzz.c", *(name.replace(".c", ".o") for name in sources(folder)), "-lm", "-o", "fuzz"],
        ):
            built = run("cc", "-std=c99", *checks, *precision, *arguments, cwd=folder)
            assert built.returncode == 0, built.stderr
        done = run("./fuzz", cwd=folder)
        assert (done.returncode, done.stderr) == (0, "")
        armed, active, released, bad, handed_over, *states = map(int, done.stdout.split())
        assert (min(states) > 100) == (name in SETUPS)
        assert armed + active + released == steps
        assert min(armed, active, released, bad, handed_over) > min(100, steps // 200)


# ------------------------------------------------------------------------------------------------ held outputs


STEERING = {
    "v": 20.0, "engage": 1, "line_left": 0.3, "e_y": 1.1, "e_psi": 0.0, "curvature": 0.0, "frame_e_y": 1.1,
    "wheel": 0.01,
}  # fmt: skip
UNUSABLE = [("e_y", np.nan), ("v", 0.5), ("v", 91.0), ("wheel", -np.inf), ("curvature", 1.5), ("e_psi", 1001.0)]


class Instances:
    """Instances of the code, and inputs that are changed from step to step."""

    def __init__(self, code: Code, n: int = 1, *, single: bool = False) -> None:
        self.compiled = Compiled(code, ["cc"], single=single)
        self.state, self.row = self.compiled.begin(n), np.zeros(n, dtype=struct(code.inputs))

    def outputs(self, **inputs: Any) -> Rows:
        for name, value in inputs.items():
            if name in (self.row.dtype.names or ()):
                self.row[name] = value
        return self.compiled.step(self.row, self.state)

    def step(self, **inputs: float) -> tuple[float, int, int]:
        """Command, phase and status of one instance."""
        (out,) = self.outputs(**inputs)
        assert (out["side"] == 0) == (out["phase"] == 0)
        return float(out["delta"]), int(out["phase"]), int(out["status"])


def test_an_unusable_input_holds_command_and_law() -> None:
    """As if the step had not been: with the inputs of before, the next command is that of before."""
    unit, other = (Instances(Code.of(LQR(), REALISTIC, 0.1)) for _ in range(2))
    first, phase, status = unit.step(**STEERING)
    assert (phase, status) == (1, 0)
    assert first < 0.0
    other.step(**STEERING)
    for name, value in UNUSABLE:
        assert unit.step(**STEERING | {name: value}) == (first, 1, 1)
        assert unit.step(**STEERING) == other.step(**STEERING)
        first = unit.step(**STEERING)[0]
        other.step(**STEERING)


@pytest.mark.parametrize(("name", "value"), UNUSABLE)
def test_the_hand_over_with_an_unusable_input(name: str, value: float) -> None:
    """The angle of the wheels; if that is what cannot be used, the last one that could. Then it can take over again."""
    unit = Instances(Code.of(LQR(), REALISTIC, 0.1))
    command = unit.step(**STEERING)[0]
    measured = 0.01 if name == "wheel" else 0.02
    assert unit.step(**STEERING | {"engage": 0, "wheel": 0.02, name: value}) == (measured, 0, 1)
    assert unit.step(**STEERING | {"wheel": 0.03, name: value}) == (measured if name == "wheel" else 0.03, 0, 1)
    assert unit.step(**STEERING) == (command, 1, 0)
    assert unit.step(**STEERING | {"engage": 0, "wheel": -0.04}) == (-0.04, 0, 0)


@pytest.mark.parametrize(("dt", "held"), [(0.05, 4), (0.03, 7), (0.01, 20)])
@pytest.mark.parametrize("single", [False, True])
def test_inputs_that_stay_unusable_are_handed_over(dt: float, held: int, single: bool) -> None:
    """After 0.2 s; a usable input in between begins the time anew. Only `engage` 0 allows the next departure."""
    unit = Instances(Code.of(PID(), Setup(dt=dt), 0.1), single=single)
    unit.step(**STEERING | {"wheel": 0.0625})
    for _ in range(3):
        command = unit.step(**STEERING)[0]
        assert [unit.step(e_psi=np.nan) for _ in range(held)] == [(command, 1, 1)] * held
        unit.row["e_psi"] = 0.0
    unit.step(line_left=-0.5)
    command, phase, _ = unit.step()
    assert phase == 2
    assert [unit.step(e_psi=np.nan) for _ in range(held)] == [(command, 2, 1)] * held
    assert unit.step(wheel=0.03125) == (0.03125, 0, 17)
    assert unit.step(wheel=np.nan) == (0.03125, 0, 17)
    assert unit.step(**STEERING | {"wheel": 0.0625}) == (0.0625, 0, 16)
    assert unit.step(engage=0) == (0.0625, 0, 0)
    assert unit.step(engage=1)[1:] == (1, 0)


def test_commands_that_stay_not_finite_are_handed_over() -> None:
    """A law whose integral is beyond all bounds never gets back by itself."""
    unit = Instances(Code.of(Constant(f_i=-1e300), Setup(), 0.1))
    first = unit.step(**STEERING)[0]
    assert [unit.step() for _ in range(4)] == [(first, 1, 2)] * 4
    assert unit.step() == (0.01, 0, 18)
    assert unit.step() == (0.01, 0, 16)


def test_the_deeper_side_decides() -> None:
    lines = {"line_left": [0.1, 0.11, 0.2, -1.0], "line_right": [0.1, -1.0, 0.3, 0.1000001]}
    out = Instances(Code.of(PID(), Setup(), 0.1), 4).outputs(v=20.0, engage=1, **lines)
    np.testing.assert_array_equal(out["side"], [0, 1, -1, -1])


@pytest.mark.parametrize(
    ("lines", "phases"),
    [((-0.4, -0.25, -0.1, -0.2, -0.3, -0.2), [0, 1, 1, 1, 2, 2]), ((-0.2, 0.0, 0.1, -0.01, -0.5), [1, 1, 1, 2, 2])],
)
def test_an_edge_that_never_reaches_the_line_is_back_at_the_threshold(lines: tuple[float], phases: list[int]) -> None:
    unit = Instances(Code.of(PID(), Setup(), -0.3))
    assert [unit.step(v=20.0, engage=1, line_right=-2.0, line_left=line)[1] for line in lines] == phases


# ------------------------------------------------------------------------------------------------ the driver


def by_the_rule(torque: FloatArray, driver: Driver, dt: float) -> tuple[FloatArray, FloatArray]:
    """State and authority (k, n) at samples with torques (k, n): the rule of the closed loop, one by one."""
    states, authorities = np.zeros(torque.shape), np.zeros(torque.shape)
    for i in range(torque.shape[1]):
        state, authority, over, calm = 1, 1.0, 0, 0
        for k in range(len(torque)):
            beyond = k > 0 and abs(torque[k, i]) > driver.override_torque
            if state == 1:
                over = over + 1 if beyond else 0
                if beyond and over * dt >= driver.override_time - 1e-9:
                    state = 2
            if state == 2 and authority == 0.0:
                state, calm = 3, 0
            if state == 3 and driver.return_after > 0.0:
                calm = 0 if beyond else calm + 1
                if calm * dt >= driver.return_after - 1e-9:
                    state, over = 1, 0
            states[k, i], authorities[k, i] = state, authority
            change = dt / driver.ramp if driver.ramp else 1.0
            authority += change if state == 1 else -change
            authority = 1.0 if authority > 1.0 - 1e-9 else authority if authority > 1e-9 else 0.0
    return states, authorities


@pytest.mark.parametrize("single", [False, True])
@pytest.mark.parametrize(
    ("dt", "changes"),
    [
        (0.05, {}),
        (0.05, {"override_time": 0.0, "ramp": 0.0, "return_after": 0.05}),
        (0.02, {"override_time": 0.05, "ramp": 0.33}),
        (0.01, {"ramp": 0.005, "return_after": 0.0}),
        (0.03, {"override_time": 0.09, "return_after": 0.06, "ramp": 0.5}),
    ],
)
def test_states_and_authority_follow_the_rule(dt: float, changes: dict[str, float], single: bool) -> None:
    """Also with a torque at the threshold, which is not beyond it, and in the step that takes over."""
    driver, rng, n, steps = dataclasses.replace(DRIVER, **changes), np.random.default_rng(2), 40, 300
    code = Code.of(LQR(), Setup(dt=dt, options=PlantOptions(driver=driver)), 0.1)
    unit, torque = Instances(code, n, single=single), rng.choice([0.0, 1.0, 2.0, -2.0, 2.5, -3.0, 9.0], (steps, n))
    held = rng.random((steps, n)) < 0.8
    for k in range(1, steps):
        torque[k] = np.where(held[k], torque[k - 1], torque[k])
    states, authorities = by_the_rule(torque, driver, dt)
    assert {1.0, 2.0} < set(np.unique(states)) if driver.ramp else {1.0, 3.0} < set(np.unique(states))
    returns = (states[1:] == 1) & (states[:-1] == 3)
    assert (returns.sum() > 40) == (driver.return_after > 0)
    for k in range(steps):
        out = unit.outputs(**STEERING, driver_torque=torque[k])
        np.testing.assert_array_equal(out["assist_state"], states[k])
        np.testing.assert_allclose(out["authority"], authorities[k], rtol=0.0, atol=1e-7 if single else 0.0)


def test_the_driver_overrides_whatever_else_is_unusable() -> None:
    """The count goes on where the state of the lane is not known; it waits where the torque is not. Armed is armed."""
    unit = Instances(Code.of(LQR(), HELD, 0.1))

    def states(**inputs: Any) -> tuple[int, int, float]:
        (out,) = unit.outputs(**inputs)
        return int(out["phase"]), int(out["assist_state"]), float(out["authority"])

    assert states(v=20.0, engage=1, line_left=0.0, driver_torque=9.0) == (0, 0, 0.0)
    assert states(**STEERING) == (1, 1, 1.0)  # the torque before the departure does not count
    assert [states(driver_torque=torque) for torque in (9.0, np.nan, 9.0, np.inf)] == [(1, 1, 1.0)] * 4
    assert states(driver_torque=-9.0) == (1, 2, 1.0)
    assert states(e_psi=np.nan) == (1, 2, pytest.approx(6 / 7))
    assert states(driver_torque=np.nan) == (1, 2, pytest.approx(5 / 7))
    assert states(engage=0) == (0, 0, 0.0)
    assert states(**STEERING, driver_torque=0.0) == (1, 1, 1.0)
    assert [states(e_psi=np.nan, driver_torque=9.0) for _ in range(3)] == [(1, 1, 1.0)] * 2 + [(1, 2, 1.0)]
    assert states() == (1, 2, pytest.approx(6 / 7))
    assert states() == (0, 0, 0.0)  # handed over


def test_without_a_driver_nothing_of_the_driver_is_in_the_code(folder: Path) -> None:
    code = exported(LQI(conditioned=True), folder, fmu=True)
    assert [name for name, _, kind in code.inputs if kind == "int32_t"] == ["frame_new", "engage"][not code.filtered :]
    for path in folder.iterdir():
        text = path.read_bytes().decode(errors="replace")
        assert not re.search("driver|assist|authority|torque|yields", text), path.name


# ------------------------------------------------------------------------------------------------ linear MPC


def test_a_solver_that_takes_too_long_is_replaced() -> None:
    """Towards the saturated plan at the rate limit, with the bit of status, and never more iterations than stated."""
    whole, rng, n = Code.of(LAWS["mpc"], REALISTIC, 0.1), np.random.default_rng(3), 300
    form = whole.schedule.form
    few = dataclasses.replace(form, mpc=(form.mpc or {}) | {"iterations": 3})
    short = dataclasses.replace(whole, schedule=dataclasses.replace(whole.schedule, form=few))
    inputs: dict[str, Any] = {"v": rng.uniform(10.0, 40.0, n), "engage": 1, "line_left": 1.0}
    inputs["e_y"] = inputs["frame_e_y"] = rng.uniform(0.2, 3.0, n)
    inputs["wheel"] = rng.uniform(-0.05, 0.05, n)
    exact, cut = (Instances(code, n).outputs(**inputs) for code in (whole, short))
    failed = cut["status"] == 4
    assert 30 < failed.sum() < n - 30
    assert (exact["status"] == 0).all()
    np.testing.assert_array_equal(cut["iterations"], np.minimum(exact["iterations"], 3))
    np.testing.assert_array_equal(failed, exact["iterations"] > 3)
    np.testing.assert_array_equal(cut["delta"][~failed], exact["delta"][~failed])
    np.testing.assert_allclose(np.abs(cut["delta"] - inputs["wheel"])[failed], 0.01, rtol=0, atol=1e-15)


@pytest.mark.parametrize("name", ["mpc", "mpc, soft", "mpc, blocks"])
def test_the_solver_finds_what_the_toolkit_finds(name: str) -> None:
    """One step from wild states, where many limits are active at once."""
    setup = Setup(options=PlantOptions(actuator=Actuator(lag=0.1, delay=0.06)))
    code, rng, n = Code.of(LAWS[name], setup, 0.1), np.random.default_rng(4), 1500
    v = rng.uniform(5.0, 50.0, n)
    x = rng.normal(size=(n, 4)) * [1.0, 1.0, 0.05, 0.1] * rng.choice([0.1, 1.0, 3.0], (n, 1))
    last = rng.uniform(-0.13, 0.13, n)
    law = LAWS[name].prepare(setup.plant(v))
    yaw_rate = rng.normal(0.0, 0.02, (n, law.preview_times.size))
    delta, _, status = law.step(np.zeros(n), x, Preview(yaw_rate, 0.0 * yaw_rate), last, law.init(n))
    state = dict(zip(("e_y", "e_y_rate", "e_psi", "e_psi_rate"), x.T, strict=True))
    lane = {"line_left": 1.0, "curvature": yaw_rate / v[:, None]}
    out = Instances(code, n).outputs(v=v, wheel=last, engage=1, **lane, **state)
    np.testing.assert_array_equal(out["status"] == 8, status == EventStatus.BEYOND_DELTA_MAX)
    assert 10 < (out["status"] == 8).sum() < n / 2
    assert ((out["iterations"] > 1) & (out["status"] == 0)).sum() > 300
    good = status != EventStatus.SOLVER_FAILED
    assert good.sum() > 0.99 * n
    assert not (out["status"] & 4).any()
    np.testing.assert_allclose(out["delta"][good], delta[good], rtol=0.0, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mpc", "mpc, soft", "mpc, blocks"])
def test_no_step_of_many_exceeds_the_bound(name: str) -> None:
    code, rng, n = Code.of(LAWS[name], REALISTIC, 0.1), np.random.default_rng(7), 1000
    units, most, failed = Instances(code, n), 0, 0
    row = units.row
    sizes = {"e_y_rate": 2.0, "e_psi_rate": 0.3, "wheel": 0.05, "frame_e_y": 2.0, "frame_e_psi": 0.1, "e_y": 2.0}
    for _ in range(100 if name == "mpc, soft" else 200):
        row["v"], row["line_left"], row["frame_new"] = rng.uniform(2.0, 80.0, n), 1.0, rng.random(n) > 0.3
        for field, size in sizes.items():
            row[field] = rng.normal(0.0, size * rng.choice([0.1, 1.0, 3.0]), n)
        row["curvature"] = rng.normal(0.0, 0.002, row["curvature"].shape)
        row["engage"] = rng.random(n) > 0.05
        out = units.outputs()
        most, failed = max(most, int(out["iterations"].max())), failed + int((out["status"] & 4).astype(bool).sum())
    bound = code.schedule.form.mpc["iterations"]  # type: ignore[index]
    assert 20 < most <= bound
    assert failed == 0


def test_single_precision_solves_what_double_solves() -> None:
    """A small weight of steering, whose solver fails in single precision: it stays in double."""
    code, rng, n = Code.of(LinearMPC(horizon=30, r_delta=1.0), REALISTIC, 0.1), np.random.default_rng(7), 2000
    inputs: dict[str, Any] = {"v": rng.uniform(2.0, 80.0, n), "line_left": 1.0, "engage": 1}
    for field, size in {"e_y": 2.0, "e_y_rate": 2.0, "e_psi": 0.1, "e_psi_rate": 0.3, "wheel": 0.05}.items():
        inputs[field] = rng.normal(0.0, size, n)
    inputs |= {"frame_e_y": inputs["e_y"], "frame_e_psi": inputs["e_psi"]}
    inputs["curvature"] = rng.normal(0.0, 0.002, (n, code.schedule.form.times.size))
    double, single = (Instances(code, n, single=single).outputs(**inputs) for single in (False, True))
    assert (double["iterations"] > 5).sum() > 100
    np.testing.assert_array_equal(single["status"], double["status"])
    assert not (single["status"] & 4).any()
    np.testing.assert_allclose(single["delta"], double["delta"], rtol=0.0, atol=1e-5)


@pytest.mark.slow
def test_departures_in_which_the_toolkit_gave_up_are_left_out() -> None:
    law = LinearMPC(horizon=8, delta_max=0.01, rate_max=0.02, a_y_max=0.5, jerk_max=0.5, e_y_max=0.5, solver="daqp")
    result = check(record(Code.of(law, REALISTIC, 0.1), load_model("reference").sample(25, 25, seed=3)), ["cc"])
    assert result.diverged == 4
    assert result.delta < 1e-5  # 2e-4 with it


# ------------------------------------------------------------------------------------------------ the FMU


@pytest.mark.parametrize("setup", [REALISTIC, HELD])
def test_fmu_gives_the_same_commands(setup: Setup, folder: Path) -> None:
    code = exported(BarrierFilter(inner="lqi"), folder, setup, fmu=True)
    path = folder / "ldc_controller.fmu"
    assert fmpy.validation.validate_fmu(str(path)) == []
    with zipfile.ZipFile(path) as packed:
        assert {"sources/fmu.c", "sources/ldc_controller.c", "binaries/linux64/ldc_controller.so"} <= set(
            packed.namelist()
        )
    recording = record(code, make_scenarios(20))
    description, unpacked = fmpy.read_model_description(str(path)), fmpy.extract(str(path))
    references = {variable.name: variable.valueReference for variable in description.modelVariables}
    slave = fmpy.fmi2.FMU2Slave(
        guid=description.guid, unzipDirectory=unpacked, modelIdentifier="ldc_controller", instanceName="one"
    )
    slave.instantiate()
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    for i in np.flatnonzero(recording.counts[4])[:4]:
        for k in np.flatnonzero(recording.counts[:, i]):
            for name, size, kind in code.inputs:
                value = np.atleast_1d(recording.inputs[name][k, i]).tolist()
                keys = [references[f"{name}[{j + 1}]" if size else name] for j in range(max(size, 1))]
                (slave.setReal if kind == "ldc_real" else slave.setInteger)(keys, value)
            slave.doStep(currentCommunicationPoint=k * 0.05, communicationStepSize=0.05)
            assert slave.getReal([references["delta"]])[0] == pytest.approx(recording.delta[k, i], abs=1e-9)
            assert slave.getInteger([references["phase"]])[0] == recording.phase[k, i]
            if setup is HELD:
                both = slave.getInteger([references["assist_state"]]) + slave.getReal([references["authority"]])
                assert both == pytest.approx(recording.assist[:, k, i].tolist(), abs=1e-12)
        slave.reset()
    assert ("authority" in references) == (setup is HELD)
    assert setup is REALISTIC or {1.0, 2.0, 3.0} <= set(recording.assist[0][recording.counts])
    with pytest.raises(Exception, match="fmi2DoStep failed"):
        slave.doStep(currentCommunicationPoint=0.0, communicationStepSize=0.01)
    slave.terminate()
    slave.freeInstance()
    shutil.rmtree(unpacked)


def test_fmu_tells_the_reason_of_an_error(folder: Path) -> None:
    exported(PID(), folder, Setup(), fmu=True)
    path = str(folder / "ldc_controller.fmu")
    description, unpacked = fmpy.read_model_description(path), fmpy.extract(path)
    told: list[tuple[bytes, int, bytes, bytes]] = []
    host = fmpy.fmi2.fmi2CallbackFunctions()
    host.logger = fmpy.fmi2.fmi2CallbackLoggerTYPE(lambda _, *what: told.append(what))
    slave = fmpy.fmi2.FMU2Slave(
        guid=description.guid, unzipDirectory=unpacked, modelIdentifier="ldc_controller", instanceName="one"
    )
    slave.instantiate(callbacks=host)
    (speed,) = [variable.valueReference for variable in description.modelVariables if variable.name == "v"]
    assert slave.getReal([speed]) == [20.0]
    slave.setReal([0], [0.0])
    assert told == []
    for call, function, value in (
        (lambda: slave.doStep(0.0, 0.01), b"fmi2DoStep", b"0.01 s"),
        (lambda: slave.setReal([9999], [0.0]), b"fmi2SetReal", b"9999"),
        (lambda: slave.getReal([9998]), b"fmi2GetReal", b"9998"),
        (lambda: slave.setInteger([9997], [0]), b"fmi2SetInteger", b"9997"),
        (lambda: slave.getInteger([9996]), b"fmi2GetInteger", b"9996"),
        (lambda: slave.getString([0]), b"fmi2GetString", b"not supported"),
        (slave.cancelStep, b"fmi2CancelStep", b"not supported"),
    ):
        with pytest.raises(Exception, match="failed with status 3"):
            call()
        ((name, status, category, message),) = told
        assert (name, status, category) == (b"one", 3, b"logStatusError")
        assert message.startswith(function + b": ")
        assert value in message
        told.clear()
        slave.reset()  # the host stays known
    for guid, kind, reason in ((b"{x}", 1, b"GUID"), (description.guid.encode(), 0, b"co-simulation only")):
        assert slave.fmi2Instantiate(b"two", kind, guid, b"", ctypes.byref(host), 0, 0) is None
        ((name, status, _, message),) = told
        assert (name, status) == (b"two", 3)
        assert reason in message
        told.clear()
    mute = slave.fmi2Instantiate(b"three", 1, description.guid.encode(), b"", None, 0, 0)  # a host without a logger
    assert slave.dll.fmi2DoStep(ctypes.c_void_p(mute), ctypes.c_double(0.0), ctypes.c_double(0.01), 0) == 3
    slave.dll.fmi2FreeInstance(ctypes.c_void_p(mute))
    slave.freeInstance()
    shutil.rmtree(unpacked)


def test_sources_of_the_fmu_compile_without_warnings(folder: Path) -> None:
    exported(PurePursuit(), folder, fmu=True)
    with zipfile.ZipFile(folder / "ldc_controller.fmu") as packed:
        packed.extractall(folder)
    done = run("cc", *STRICT, "-c", "fmu.c", "ldc_controller.c", cwd=folder / "sources")
    assert (done.returncode, done.stderr) == (0, "")
    names = run("nm", "-D", "--defined-only", folder / "binaries/linux64/ldc_controller.so", cwd=folder).stdout
    assert len(re.findall(r" T fmi2\w+", names)) == 34


def test_the_same_export_is_the_same_bits(folder: Path, tmp_path: Path) -> None:
    exported(LQR(), folder, fmu=True)
    exported(LQR(), tmp_path / "again", fmu=True)
    for path in sorted(folder.iterdir()):
        assert path.read_bytes() == (tmp_path / "again" / path.name).read_bytes(), path.name


def test_a_compiler_from_a_package(monkeypatch: pytest.MonkeyPatch) -> None:
    assert compiler() == ["cc"]
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: object() if name == "ziglang" else None)
    assert (compiler() or [])[1:] == ["-P", "-m", "ziglang", "cc"]
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert compiler() is None


def test_fmu_in_a_co_simulation(folder: Path) -> None:
    """The importer's own master: inputs from a table, outputs a step later."""
    code = exported(PID(), folder, Setup(), fmu=True)
    recording = record(code, make_scenarios(5))
    k = np.flatnonzero(recording.counts[:, 0])
    table = np.zeros(
        k.size, dtype=[("time", float), *((name if not size else f"{name}[1]", "f8") for name, size, _ in code.inputs)]
    )
    table["time"] = np.arange(k.size) * 0.05
    for name, size, _ in code.inputs:
        table[f"{name}[1]" if size else name] = recording.inputs[name][k, 0].reshape(-1)
    simulated = fmpy.simulate_fmu(
        str(folder / "ldc_controller.fmu"), stop_time=k.size * 0.05, step_size=0.05, output_interval=0.05,
        input=table, output=["delta", "phase"],
    )  # fmt: skip
    np.testing.assert_allclose(simulated["delta"][1 : k.size], recording.delta[k[:-1], 0], rtol=0, atol=1e-9)
    np.testing.assert_array_equal(simulated["phase"][1 : k.size], recording.phase[k[:-1], 0])
