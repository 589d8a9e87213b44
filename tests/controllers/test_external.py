"""Controllers and vehicles from outside: FMUs and C code steer as the law that they are, and their faults are named."""

from __future__ import annotations

import builtins
import dataclasses
import shutil
import subprocess
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ldctoolkit as ldc
from helpers.bits import assert_same_bits
from helpers.closed_loop import Constant, make_scenarios
from helpers.errors import refused
from helpers.fmus import build
from ldctoolkit import Controller, EventStatus, Setup, registry, simulate
from ldctoolkit.code_content import content_of
from ldctoolkit.errors import InputError, LdcError, StudyError, UnknownNameError
from ldctoolkit.plant_options import Actuator, KalmanFilter, PlantOptions, Sensors
from ldctoolkit.studies.design_space import named_laws
from ldctoolkit.studies.export import export_c
from ldctoolkit.testing import check_controller_contract

SCENARIOS = make_scenarios(24)
F = (-0.02, -0.03, -0.4, -0.05)
IN = {"e_y": "in1", "e_y_rate": "in2", "e_psi": "in3", "e_psi_rate": "in4"}
VARIABLES = [
    *((f"in{i}", "input", "Real", 'start="0"') for i in range(1, 5)),
    ("delta", "output", "Real", ""),
    *((f"k.{i}", "parameter", "Real", f'start="{gain}" min="-1" max="0"') for i, gain in enumerate(F, 1)),
    ("on", "parameter", "Boolean", 'start="true"'),
    ("sum", "local", "Real", 'start="0"'),
    ("status", "output", "Integer", ""),
    ("class", "parameter", "Integer", 'start="1"'),
]  # fmt: skip
ON_TIME = "if (fabs(t - v[10]) > 1e-9) { return 3; } v[10] = t + h;"  # each step where the one before ended
WEIGHTED = "v[4] = v[9] * v[12] * (v[5]*v[0] + v[6]*v[1] + v[7]*v[2] + v[8]*v[3]);"


@pytest.fixture(autouse=True)
def nothing_stays_registered() -> Any:
    before = {kind.name for kind in registry.registered()}
    yield
    for kind in registry.registered():
        if kind.name not in before:
            registry.forget(kind.name)


@pytest.fixture
def fmu(tmp_path: Path) -> Path:
    return build(tmp_path / "weights.fmu", VARIABLES, f"{WEIGHTED} return 0;")


SETUPS = {
    "ideal plant": Setup(),
    "actuator and camera": Setup(
        options=PlantOptions(
            actuator=Actuator(lag=0.1, delay=0.07, rate_max=0.4),
            sensors=Sensors(delay=0.08, period=0.1, e_y_noise=0.01),
        )
    ),
    "trigger by time": Setup(trigger="ttlc", ttlc=0.4, dt=0.04),
    "camera behind a filter": Setup(
        options=PlantOptions(sensors=Sensors(delay=0.08, period=0.15, e_y_step=0.02, kalman=KalmanFilter()))
    ),
    "the catalog": ldc.load_study("trigger-and-gains").setup(),
}
LAWS: dict[str, Controller] = {
    "lqi": ldc.LQI(), "pid": ldc.PID(), "stanley": ldc.Stanley(k_d_steer=0.2), "pure_pursuit": ldc.PurePursuit(),
    "linear_mpc": ldc.LinearMPC(horizon=12, a_y_max=2.0), "preview": ldc.PreviewProportional(),
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "setup"),
    [
        *((name, "actuator and camera") for name in ("lqi", "pid")),
        *(pytest.param(name, "actuator and camera", marks=pytest.mark.slow) for name in list(LAWS)[2:]),
        ("lqi", "ideal plant"),
        pytest.param("linear_mpc", "trigger by time", marks=pytest.mark.slow),
        pytest.param("pid", "the catalog", marks=pytest.mark.slow),
        ("lqi", "camera behind a filter"),
    ],
)
def test_exported_laws_taken_in_again_give_the_same(name: str, setup: str, tmp_path: Path) -> None:
    law, driven = LAWS[name], SETUPS[setup]
    export_c(law, driven, 0.1, tmp_path, scenarios=make_scenarios(5), run_check=False, fmu=True)
    sources = [str(path) for path in tmp_path.glob("ldc_*.c")]
    subprocess.run(["cc", "-shared", "-fPIC", "-O2", "-o", tmp_path / "ecu.so", *sources, "-lm"], check=True)
    for y_s in (0.1, -0.1, 0.3):  # the trigger is that of the loop, not that of the code
        expected = simulate(law, SCENARIOS, setup=driven, y_s=y_s)
        for taken in (ldc.FmuLaw(tmp_path / "ldc_controller.fmu"), ldc.CLaw(tmp_path), ldc.CLaw(tmp_path / "ecu.so")):
            outcome = simulate(taken, SCENARIOS, setup=driven, y_s=y_s)
            np.testing.assert_allclose(outcome.S, expected.S, rtol=0.0, atol=1e-9)
            np.testing.assert_array_equal(outcome.status, expected.status)
            assert (outcome.status != EventStatus.NEVER_TRIGGERED).sum() > 10
            if name != "lqi":
                break


@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("step", [None, 0.05, 0.01])
def test_a_fmu_with_names_of_its_own(version: str, step: float | None, tmp_path: Path) -> None:
    path = build(tmp_path / "my law.fmu", VARIABLES, f"{ON_TIME} {WEIGHTED} return 0;", version=version)
    law = ldc.FmuLaw(path, IN, output="delta", step=step)
    assert (law.name, law.title) == ("my_law", "My law (FMU)")
    expected = simulate(Constant(F=F), SCENARIOS, y_s=0.1)
    for _ in range(2):  # instances begin anew
        outcome = simulate(law, SCENARIOS, y_s=0.1)
        np.testing.assert_allclose(outcome.S, expected.S, rtol=0.0, atol=1e-12)
        np.testing.assert_array_equal(outcome.status, expected.status)


def test_steps_within_a_sample_hold_the_inputs(tmp_path: Path) -> None:
    """An integrator of its own: five steps of 10 ms add as much as one of 50 ms."""
    path = build(tmp_path / "i.fmu", VARIABLES, f"v[10] += h * v[0]; {WEIGHTED} v[4] -= 0.001 * v[10]; return 0;")
    outcomes = [simulate(ldc.FmuLaw(path, IN, step=step), SCENARIOS, y_s=0.1).S for step in (0.05, 0.01)]
    np.testing.assert_allclose(outcomes[0], outcomes[1], rtol=0.0, atol=1e-9)
    assert np.abs(outcomes[0] - simulate(Constant(F=F), SCENARIOS, y_s=0.1).S).max() > 1e-4


def test_parameters_are_gains(fmu: Path) -> None:
    law = ldc.FmuLaw(fmu, IN, parameters=["k.1", "on", "class"])
    assert next((g.name, g.default, g.lower, g.upper) for g in law.gains()) == ("k_1", -0.02, -1.0, 0.0)
    assert {g.name: g.default for g in law.gains()} == {"k_1": -0.02, "on": True, "class_": 1}
    for changed, expected in (
        (dataclasses.replace(law, k_1=-0.1), Constant(F=(-0.1, *F[1:]))),
        (dataclasses.replace(law, class_=2), Constant(F=tuple(2.0 * f for f in F))),
        (dataclasses.replace(law, on=False), Constant()),
        (ldc.FmuLaw(fmu, IN, parameters={"k.1": -0.1}), Constant(F=(-0.1, *F[1:]))),
    ):  # type: ignore[assignment]
        S = simulate(changed, SCENARIOS, y_s=0.1).S
        np.testing.assert_allclose(S, simulate(expected, SCENARIOS, y_s=0.1).S, rtol=0.0, atol=1e-12)
    with refused("weights.k_1", value=0.5):
        dataclasses.replace(law, k_1=0.5)


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_an_fmu_keeps_the_contract(version: str, tmp_path: Path) -> None:
    path = build(tmp_path / "w.fmu", VARIABLES, f"v[10] += h * v[0]; {WEIGHTED} v[4] -= 0.01 * v[10]; return 0;",
                 version=version)  # fmt: skip
    law = ldc.FmuLaw(path, IN, step=0.01, parameters=["k.1", "k.3"])
    check_controller_contract(law, [dataclasses.replace(law, k_1=-0.1)])


def test_c_code_keeps_the_contract(tmp_path: Path) -> None:
    export_c(ldc.PID(), Setup(), 0.1, tmp_path, scenarios=make_scenarios(5), run_check=False)
    check_controller_contract(ldc.CLaw(tmp_path))


OWN_HEADER = """
#include <stdint.h>
#define LDC_LOOKAHEAD 0.0 0.5
#define PLACES (1 + 1)
typedef struct { double e_y, e_psi; float e_y_rate; double yaw_rate[PLACES]; } ldc_inputs;
typedef struct { double sum; int32_t steps; } ldc_state;
typedef struct { int32_t status; double delta; } ldc_outputs;
#ifdef __cplusplus
extern "C" {
#endif
void ldc_step(const ldc_inputs *in, ldc_state *state, ldc_outputs *out);
void ldc_init(ldc_state *state);
"""
OWN_CODE = """
#include "ldc_controller.h"
void ldc_init(ldc_state *s) { s->sum = 0.001; s->steps = 0; }
void ldc_step(const ldc_inputs *in, ldc_state *s, ldc_outputs *out) {
    s->sum += 0.0 * in->e_y_rate; s->steps++;
    out->delta = -0.02 * in->e_y - 0.4 * in->e_psi + 0.1 * in->yaw_rate[1];
    out->status = s->steps == 3 ? 4 : s->steps == 4 ? 8 : 0; }
"""


def test_c_code_of_ones_own(tmp_path: Path) -> None:
    (tmp_path / "ldc_controller.h").write_text(OWN_HEADER)
    (tmp_path / "mine.c").write_text(OWN_CODE)
    outcome = simulate(ldc.CLaw(tmp_path / "mine.c"), SCENARIOS, y_s=0.1)
    driven = outcome.status[outcome.status != EventStatus.NEVER_TRIGGERED]
    assert {*driven.tolist()} == {EventStatus.SOLVER_FAILED}
    content = content_of(type(ldc.CLaw(tmp_path / "mine.c")))
    (tmp_path / "table.h").write_text("")  # it may be included
    assert content_of(type(ldc.CLaw(tmp_path / "mine.c"))) not in ("", content)


def test_the_content_of_files_is_the_identity(fmu: Path, tmp_path: Path) -> None:
    law = ldc.FmuLaw(fmu, IN)
    moved = shutil.copy(fmu, tmp_path / "elsewhere.fmu")
    assert content_of(type(ldc.FmuLaw(moved, IN, name="weights"))) == content_of(type(law))
    assert content_of(type(ldc.FmuLaw(fmu, IN, step=0.01))) != content_of(type(law))
    before = simulate(law, SCENARIOS, y_s=0.1).S
    build(fmu, VARIABLES, f"{WEIGHTED} v[4] *= 2.0; return 0;")
    after = ldc.FmuLaw(fmu, IN)
    assert content_of(type(after)) != content_of(type(law))
    assert_same_bits(simulate(law, SCENARIOS, y_s=0.1).S, before)  # it was loaded, and stays what it was
    assert np.abs(simulate(after, SCENARIOS, y_s=0.1).S - before).max() > 1e-3


@pytest.mark.slow
def test_a_study_with_workers_and_a_file_that_is_exchanged(tmp_path: Path) -> None:
    path = build(tmp_path / "ecu.fmu", VARIABLES, f"{WEIGHTED} return 0;")
    export_c(ldc.LQR(), Setup(), 0.1, tmp_path / "code", scenarios=make_scenarios(5), run_check=False)
    (tmp_path / "laws.py").write_text(
        "from pathlib import Path\nimport ldctoolkit as ldc\nhere = Path(__file__).parent\n"
        f"ecu = ldc.FmuLaw(here / 'ecu.fmu', {IN}, parameters=['k.1'])\nCode = type(ldc.CLaw(here / 'code'))\n"
    )
    (tmp_path / "study.toml").write_text(
        '[scenarios]\nleft = 8\nright = 8\n[[design]]\nlaw = ["lqr", "laws.py:Code"]\n'
        '[[design]]\nlaw = "laws.py:ecu"\ny_s = 0.1\ngains.k_1 = [-0.02, -0.04]\n'.replace("[scen", 'name = "s"\n[scen')
    )
    study = ldc.load_study(tmp_path / "study.toml")
    tables = [ldc.run_study(study, tmp_path / f"out{n}", workers=n).to_polars() for n in (1, 2)]
    assert tables[0].equals(tables[1])
    by_python = ldc.study(
        ldc.LQR(), {"law": ldc.FmuLaw(path, IN, parameters=["k.1"]), "gains": {"k_1": [-0.02, -0.04]}}, y_s=0.1
    )
    assert {design.id for design in study.designs} >= {d.id for d in by_python.designs if d.law == "ecu"}
    build(path, VARIABLES, f"{WEIGHTED} v[4] *= 2.0; return 0;")
    with ThreadPoolExecutor(1) as other, refused(str(path)):  # where it was not loaded before
        other.submit(simulate, study.designs[-1].controller(), SCENARIOS, y_s=0.1).result()


FAULTS: list[tuple[dict[str, Any], str, Any, str | set[str]]] = [
    ({"inputs": {"e_yy": "in1"}}, "w.fmu: inputs", "e_yy", {"e_y", "takeover"}),
    ({"inputs": {"e_y@0.5": "in1"}}, "w.fmu: inputs", "e_y@0.5", ""),
    ({"inputs": {"curvature@nan": "in1"}}, "w.fmu: inputs", "curvature@nan", ""),
    ({"inputs": {"e_y": "in9"}}, "w.fmu: inputs.e_y", "in9", {"in1", "in4"}),
    ({"inputs": {"e_y": "delta"}}, "w.fmu: inputs.e_y", "delta", "input"),
    ({"output": "in1"}, "w.fmu: output", "in1", "output"),
    ({"output": "status"}, "w.fmu: output", "status", ""),
    ({"parameters": ["k.9"]}, "w.fmu: parameters", "k.9", {"k.1"}),
    ({"parameters": ["sum"]}, "w.fmu: parameters", "sum", "parameter"),
    ({"step": 0.0}, "step", 0.0, ""),
    ({"inputs": None}, "w.fmu: inputs", "in1", {"e_y"}),
]


@pytest.mark.parametrize(("given", "path", "value", "allowed"), FAULTS)
def test_what_does_not_fit_the_fmu(
    given: dict[str, Any], path: str, value: Any, allowed: str | set[str], tmp_path: Path
) -> None:
    file = build(tmp_path / "w.fmu", VARIABLES, "return 0;")
    with refused(path, LdcError, value=value, allowed=allowed):
        ldc.FmuLaw(file, **({"inputs": IN} | given))


@pytest.mark.parametrize(
    ("given", "problem"),
    [
        ({"version": "1.0"}, "FMI 2.0 or 3.0"), ({"kind": "ModelExchange"}, "model exchange only"),
        ({"platform": "win64"}, "win64"),
    ],
)  # fmt: skip
def test_fmus_that_cannot_be_used(given: dict[str, Any], problem: str, tmp_path: Path) -> None:
    file = build(tmp_path / "w.fmu", VARIABLES, "return 0;", **given)
    with pytest.raises(InputError, match=problem) as caught:
        ldc.FmuLaw(file, IN)
    assert caught.value.path == str(file)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 no archive"])
def test_files_that_are_no_fmu(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "w.fmu").write_bytes(content)
    with refused(str(tmp_path / "w.fmu")):
        ldc.FmuLaw(tmp_path / "w.fmu", IN)
    with refused(str(tmp_path / "none.fmu")):
        ldc.FmuLaw(tmp_path / "none.fmu", IN)
    with refused(str(tmp_path)):
        ldc.FmuLaw(tmp_path, IN)


def test_without_fmpy(fmu: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def fails(name: str, *rest: Any) -> Any:
        if name.startswith("fmpy"):
            raise ImportError(name)
        return real(name, *rest)

    with zipfile.ZipFile(fmu, "a") as packed:
        packed.comment = b"content that no other test has read"
    monkeypatch.setattr(builtins, "__import__", fails)
    with pytest.raises(LdcError) as caught:
        ldc.FmuLaw(fmu, IN, name="x")
    assert caught.value.hint == "pip install 'ldctoolkit[fmu]'"


def test_a_step_that_is_no_divisor(fmu: Path) -> None:
    for step in (0.03, 0.1):
        with refused("weights.step", value=step):
            simulate(ldc.FmuLaw(fmu, IN, step=step), SCENARIOS, y_s=0.1)


def test_steps_that_fail_are_counted(tmp_path: Path) -> None:
    """From its fifth sample on each instance fails, ends, or gives no number: the last command is held."""
    for i, end in enumerate(("return 3;", "return 9;", "v[4] = NAN; return 0;")):
        path = build(
            tmp_path / f"f{i}.fmu", VARIABLES, f"{WEIGHTED} if (t > 0.19) {{ {end} }} return 0;", version="3.0"
        )
        outcome = simulate(ldc.FmuLaw(path, IN), SCENARIOS, y_s=0.1)
        driven = outcome.status[outcome.status != EventStatus.NEVER_TRIGGERED]
        assert {*driven.tolist()} <= {EventStatus.SOLVER_FAILED, EventStatus.DIVERGED}
        assert (driven == EventStatus.SOLVER_FAILED).any()
        assert np.isfinite(outcome.S).all()


def test_an_fmu_that_fails_from_the_start(tmp_path: Path) -> None:
    path = build(tmp_path / "w.fmu", VARIABLES, "return 3;")
    with pytest.raises(LdcError, match="fmi2DoStep"):
        simulate(ldc.FmuLaw(path, IN), SCENARIOS, y_s=0.1)
    results = ldc.run_study(ldc.study(ldc.NoControl, ldc.FmuLaw(path, IN), y_s=0.1, left=5, right=5), workers=1)
    assert "fmi2DoStep" in str(results.failed[0])
    with refused(str(path.with_name("n.fmu")), LdcError):
        path = build(tmp_path / "n.fmu", VARIABLES, "return 0;", instance="NULL")
        simulate(ldc.FmuLaw(path, IN), SCENARIOS, y_s=0.1)


def test_whether_an_fmu_fails_does_not_depend_on_designs_before(tmp_path: Path) -> None:
    path = build(tmp_path / "w.fmu", VARIABLES, f"if (v[5] > -0.015) {{ return 3; }} {WEIGHTED} return 0;")
    law = ldc.FmuLaw(path, IN, parameters=["k.1"])
    assert (simulate(law, SCENARIOS, y_s=0.1).status != EventStatus.SOLVER_FAILED).all()
    with refused("w.fmu", LdcError):
        simulate(dataclasses.replace(law, k_1=-0.01), SCENARIOS, y_s=0.1)


@pytest.mark.parametrize(("signal", "unit"), [("delta", "deg"), ("in1", "mm"), ("delta", "unnamed")])
def test_units_that_are_not_si_are_refused(signal: str, unit: str, tmp_path: Path) -> None:
    changed = [(*v[:3], f'{v[3]} unit="{unit}"' if v[0] == signal else v[3]) for v in VARIABLES]
    path = build(tmp_path / "w.fmu", changed, "return 0;")
    if unit == "unnamed":
        ldc.FmuLaw(path, IN)
        with zipfile.ZipFile(path) as packed:
            files = {name: packed.read(name) for name in packed.namelist()}
        units = b'<UnitDefinitions><Unit name="unnamed"><BaseUnit rad="1" factor="0.01"/></Unit></UnitDefinitions>'
        text = files["modelDescription.xml"].replace(b"<ModelVariables>", units + b"<ModelVariables>")
        with zipfile.ZipFile(path, "w") as packed:
            for name, content in (files | {"modelDescription.xml": text}).items():
                packed.writestr(name, content)
    with refused(f"w.fmu: {'output' if signal == 'delta' else 'inputs.e_y'}", value=signal):
        ldc.FmuLaw(path, IN)


def test_an_fmu_that_cannot_be_reset_is_made_anew(tmp_path: Path) -> None:
    body = f"v[10] += h * v[0]; {WEIGHTED} v[4] -= 0.01 * v[10]; return 0;"
    laws = [
        ldc.FmuLaw(build(tmp_path / f"{name}.fmu", VARIABLES, body, reset=reset), IN)
        for name, reset in (("a", "(void)0"), ("b", "return 3"))
    ]
    S = [simulate(law, SCENARIOS, y_s=0.1).S for law in (*laws, *laws)]
    assert all(np.array_equal(S[0], other) for other in S)


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_an_fmu_for_one_instance_a_process(version: str, tmp_path: Path) -> None:
    path = build(
        tmp_path / "w.fmu", VARIABLES, f"{WEIGHTED} return 0;", version=version,
        flags='canBeInstantiatedOnlyOncePerProcess="true"',
    )  # fmt: skip
    law = ldc.FmuLaw(path, IN)
    with refused(str(path), allowed="one scenario at a time"):
        simulate(law, SCENARIOS, y_s=0.1)
    results = ldc.run_study(ldc.study(ldc.NoControl, law, y_s=0.1, left=6, right=6), workers=1)
    assert not results.failed
    assert type(law).batch == 1


def test_faults_of_c_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    header, code = tmp_path / "ldc_controller.h", tmp_path / "mine.c"
    code.write_text(OWN_CODE)
    with refused(str(header)):
        ldc.CLaw(code)
    header.write_text(OWN_HEADER.replace("e_psi;", "e_psii;"))
    with refused("cc", LdcError):  # the code does not have it
        ldc.CLaw(code)
    code.write_text(OWN_CODE.replace("e_psi", "e_psii"))
    with refused(f"{header}: ldc_inputs", UnknownNameError, value="e_psii", allowed={"e_psi"}):
        ldc.CLaw(code)
    code.write_text(OWN_CODE)
    header.write_text(OWN_HEADER.replace("#define LDC_LOOKAHEAD 0.0 0.5", "#define LDC_LOOKAHEAD 0.0"))
    with refused("ldc_controller.h: yaw_rate[2]"):
        ldc.CLaw(code)
    header.write_text(OWN_HEADER.replace("ldc_step", "other_step"))
    code.write_text(OWN_CODE.replace("ldc_step", "other_step"))
    with refused(str(header)):
        ldc.CLaw(code)
    (tmp_path / "empty").mkdir()
    with refused(str(tmp_path / "empty")):
        ldc.CLaw(tmp_path / "empty")
    (tmp_path / "mine.so").write_bytes(b"no library")
    header.write_text(OWN_HEADER)
    with refused(str(header)):
        ldc.CLaw(tmp_path / "mine.so")
    monkeypatch.setattr("ldctoolkit.controllers.external.compiler", lambda: None)
    with refused("cc", LdcError):
        ldc.CLaw(code)


def test_laws_of_files_that_cannot_be_loaded(tmp_path: Path) -> None:
    (tmp_path / "laws.py").write_text("import ldctoolkit as ldc\nlaw, other = ldc.LQR(r_delta=5e4), 3\n")
    for law in ("laws.py:other", "laws.py:nothing", "none.py:law"):
        with refused("study: design[0].law", StudyError):
            ldc.Study.from_dict({"name": "s", "design": [{"law": law}]}, folder=tmp_path)
    for law in (ldc.LQR(r_delta=5e4), "laws.py:law"):  # its gain would be that of the other law too
        with refused("design", InputError, value=ldc.LQR(r_delta=5e4)):
            named_laws({"law": [law, ldc.LQI]}, {}, tmp_path)
    assert named_laws({"law": [ldc.LQR(), ldc.LQI()]}, {}) == {"law": ["lqr", "lqi"]}
    study = ldc.Study.from_dict({"name": "s", "design": [{"law": "laws.py:law"}]}, folder=tmp_path)
    assert dict(study.designs[0].gains)["r_delta"] == 5e4


CAR = [
    ("steer", "input", "Real", 'start="0"'), ("speed", "input", "Real", 'start="20"'),
    ("bend", "input", "Real", 'start="0"'), *((f"x{i}", "parameter", "Real", 'start="0"') for i in range(4)),
    *((name, "output", "Real", "") for name in ("y", "y_rate", "psi", "psi_rate", "ay", "vy", "r")),
    ("begun", "local", "Real", 'start="0"'),
]  # fmt: skip
BICYCLE = """
    double x[4], s = h / 50.0;  /* the paper's vehicle, by Heun's method */
    if (v[14] == 0.0) { memcpy(v + 7, v + 3, sizeof x); v[14] = 1.0; }
    memcpy(x, v + 7, sizeof x);
    for (int k = 0; k < 50; k++) {
        double rate[2][4], ahead[4], *at[2] = {x, ahead};
        for (int p = 0; p < 2; p++) {
            const double *z = at[p];
            const double front = 160000.0 * (v[0] + z[2] - (z[1] + 1.43 * (z[3] + v[2])) / v[1]);
            const double rear = 160000.0 * (z[2] - (z[1] - 1.47 * (z[3] + v[2])) / v[1]);
            v[11] = (front + rear) / 1000.0;
            rate[p][0] = z[1], rate[p][1] = v[11] - v[1] * v[2];
            rate[p][2] = z[3], rate[p][3] = (1.43 * front - 1.47 * rear) / 3344.0;
            for (int i = 0; (i < 4) && (p == 0); i++) { ahead[i] = x[i] + s * rate[0][i]; }
        }
        for (int i = 0; i < 4; i++) { x[i] += 0.5 * s * (rate[0][i] + rate[1][i]); }
    }
    memcpy(v + 7, x, sizeof x);
    v[12] = x[1] - v[1] * x[2], v[13] = x[3] + v[2];
"""
STEERED = {"delta": "steer", "v": "speed", "lane_yaw_rate": "bend"}
WHOLE = {"e_y": "y", "e_y_rate": "y_rate", "e_psi": "psi", "e_psi_rate": "psi_rate", "a_y": "ay"}
BEGUN = {"e_y": "x0", "e_y_rate": "x1", "e_psi": "x2", "e_psi_rate": "x3"}


@pytest.mark.parametrize(
    ("version", "outputs", "step", "largest"),
    [
        pytest.param("2.0", WHOLE, 0.01, 1e-4, marks=pytest.mark.slow),
        pytest.param("3.0", WHOLE, 0.0025, 1e-5, marks=pytest.mark.slow),
        # it is linear, and its v_y is taken for that of an exact geometry
        ("2.0", {"v_y": "vy", "yaw_rate": "r", "a_y": "ay"}, 0.01, 5e-3),
    ],
)  # fmt: skip
def test_a_linear_bicycle_as_an_fmu(
    version: str, outputs: dict[str, str], step: float, largest: float, tmp_path: Path
) -> None:
    path = build(tmp_path / "car.fmu", CAR, f"{BICYCLE} return 0;", version=version)
    options = PlantOptions(actuator=Actuator(lag=0.1, delay=0.06))
    model = ldc.FmuVehicle(path, STEERED, outputs, BEGUN, step=step)
    for law in (ldc.LQR(), ldc.PID()):
        expected = simulate(law, SCENARIOS, setup=Setup(options=options), y_s=0.1)
        for _ in range(2):
            driven = simulate(law, SCENARIOS, setup=Setup(options=options, vehicle_model=model), y_s=0.1)
            np.testing.assert_allclose(driven.S, expected.S, rtol=0.0, atol=largest)
            np.testing.assert_array_equal(driven.status, expected.status)
            added = driven.metrics.a_y_peak - expected.metrics.a_y_peak
            assert np.nanmax(np.abs(added)) < 0.05


def test_a_vehicle_that_fails_or_does_not_fit(tmp_path: Path) -> None:
    path = build(tmp_path / "car.fmu", CAR, f"{BICYCLE} return 0;")
    same = ldc.FmuVehicle(path, STEERED, WHOLE, BEGUN)
    assert ldc.FmuVehicle(shutil.copy(path, tmp_path / "moved.fmu"), STEERED, WHOLE, BEGUN) == same
    for given, at, value in (
        ({"inputs": {"speed": "speed"}}, "car.fmu: inputs", "speed"),
        ({"inputs": {"v": "sped"}}, "car.fmu: inputs.v", "sped"),
        ({"outputs": {"a_y": "ay", "v_y": "vy"}}, "car.fmu: outputs", ["a_y", "v_y"]),
        ({"start": {"e_y": "y"}}, "car.fmu: start.e_y", "y"),
        ({"step": -1.0}, "step", -1.0),
    ):  # type: ignore[assignment]
        with refused(at, LdcError, value=value):
            ldc.FmuVehicle(path, **({"inputs": STEERED, "outputs": WHOLE, "start": BEGUN} | given))  # type: ignore[arg-type]
    late = build(tmp_path / "late.fmu", CAR, f"{BICYCLE} return t > 0.5 ? 3 : 0;")
    other = ldc.FmuVehicle(late, STEERED, WHOLE, BEGUN)
    assert other != same
    with refused("late.fmu", LdcError):
        simulate(ldc.LQR(), SCENARIOS, setup=Setup(vehicle_model=other), y_s=0.1)
