"""A design is its code: after an edit old results are not met again, and nothing else is run again."""

import dataclasses
import importlib
import itertools
import logging
import os
import re
import signal
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar

import numpy as np
import pytest

import ldctoolkit as ldc
from helpers.errors import refused
from helpers.kills import killing
from helpers.results import assert_same_results
from ldctoolkit import registry
from ldctoolkit.code_content import content_of
from ldctoolkit.errors import StoreError
from ldctoolkit.studies.cli import main
from ldctoolkit.studies.running import tasks

LAW = """
import dataclasses
from typing import ClassVar
import numpy as np
import ldctoolkit as ldc
{imports}

{before}

@dataclasses.dataclass(frozen=True)
class Mine({base}):
    name: ClassVar[str] = "mine"
    title: ClassVar[str] = "Mine"
    K: float = ldc.gain(-0.02, unit="rad/m", lower=-1.0, upper=0.0, description="gain on e_y")

    def prepare(self, plant):
        {inside}
        return ldc.LinearLaw(F=np.tile([{factor} * self.K, 0.0, -0.3, 0.0], (plant.n, 1)))
"""
USUAL = {"imports": "", "before": "", "base": "ldc.Controller", "inside": "pass", "factor": "1.0"}
SCENARIOS = {"left": 8, "right": 6}
NEW, OLD = 0.05, 1.0

names = (f"designers_laws_{i}" for i in itertools.count())


class Folder:
    """A package of a designer's that is imported anew after each edit."""

    def __init__(self, path: Path) -> None:
        self.path, self.name = path / next(names), ""
        self.path.mkdir()
        sys.path.insert(0, str(path))
        self.write("__init__", "")

    def write(self, module: str, text: str) -> None:
        (self.path / f"{module}.py").write_text(textwrap.dedent(text), encoding="utf-8")

    def law(self, **parts: str) -> type[ldc.Controller]:
        """The class, of an interpreter that has not imported anything of it yet."""
        self.write("laws", LAW.format(**USUAL | parts))
        for name in [name for name in sys.modules if name.startswith(self.path.name)]:
            del sys.modules[name]
        importlib.invalidate_caches()
        sys.dont_write_bytecode, before = True, sys.dont_write_bytecode
        try:
            module: Any = importlib.import_module(f"{self.path.name}.laws")
        finally:
            sys.dont_write_bytecode = before
        kind: type[ldc.Controller] = module.Mine
        return kind


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Folder]:
    made = Folder(tmp_path)
    yield made
    sys.path.remove(str(tmp_path))
    registry.forget("mine")


def study_of(*laws: Any, **tables: Any) -> ldc.Study:
    tables = {"y_s": 0.1, "name": "edited", "ranking": {"finalists": 0, "bootstrap": 100}, **SCENARIOS} | tables
    return ldc.study(ldc.NoControl, ldc.LQR, *laws, **tables)


def S_of(results: ldc.StudyResults, law: str = "mine") -> float:
    return float(next(S.mean() for d, S in zip(results.designs, results.S, strict=True) if d.law == law))


EDITS: dict[str, Callable[[Folder, float], type[ldc.Controller]]] = {
    "class": lambda f, k: f.law(factor=str(k)),
    "base": lambda f, k: (
        f.write("base", f"import ldctoolkit as ldc\nclass Base(ldc.Controller):\n    def factor(self): return {k}\n")
        or f.law(imports="from .base import Base", base="Base", factor="self.factor()")
    ),
    "helper": lambda f, k: (
        f.write("helper", f"def factor():\n    return {k}\n")
        or f.law(imports="from . import helper", factor="helper.factor()")
    ),
    "helper of a helper": lambda f, k: (
        f.write("deep", f"TABLE = {{'k': [{k}]}}\n")
        or f.write("helper", "from .deep import TABLE\ndef factor():\n    return TABLE['k'][0]\n")
        or f.law(imports="from .helper import factor", factor="factor()")
    ),
    "imported inside": lambda f, k: (
        f.write("helper", f"def factor():\n    return {k}\n")
        or f.law(inside="from .helper import factor", factor="factor()")
    ),
    "closure": lambda f, k: f.law(
        before=f"def made(k):\n    return lambda: k\nfactor = made({k})", factor="factor()"
    ),
    "default": lambda f, k: f.law(before=f"def factor(k={k}):\n    return k", factor="factor()"),
    "array": lambda f, k: f.law(before=f"GAINS = np.array([{k}])", factor="GAINS[0]"),
    "compiled": lambda f, k: f.law(
        imports="import numba", before=f"@numba.njit\ndef factor():\n    return {k}", factor="factor()"
    ),
    "cached": lambda f, k: f.law(
        imports="import functools", before=f"@functools.cache\ndef factor():\n    return {k}", factor="factor()"
    ),
    "partial": lambda f, k: f.law(
        imports="import functools", before=f"factor = functools.partial(max, -9.0, {k})", factor="factor()"
    ),
    "object": lambda f, k: f.law(
        before=f"class Box:\n    def __init__(self, k): self.k = k\nBOX = Box({k})", factor="BOX.k"
    ),
    "frozen object": lambda f, k: f.law(
        before=f"VEHICLE = dataclasses.replace(ldc.VehicleParameters(), m={2000.0 * k})", factor="VEHICLE.m / 2000.0"
    ),
    "property": lambda f, k: f.law(
        before=f"class Base(ldc.Controller):\n    @property\n    def factor(self): return {k}", base="Base",
        factor="self.factor",
    ),
    "set": lambda f, k: f.law(before=f"KNOWN = {{'a', 'b', 'c', {k}}}", factor=f"({k} if {k} in KNOWN else 9.0)"),
}  # fmt: skip


QUICK = ("closure", "compiled", "frozen object", "property")  # in the shorter tier


@pytest.mark.parametrize(
    "edit", [pytest.param(edit, id=x, marks=() if x in QUICK else pytest.mark.slow) for x, edit in EDITS.items()]
)
def test_an_edit_runs_that_law_again_and_no_other(
    edit: Callable[[Folder, float], type[ldc.Controller]],
    folder: Folder,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    driven: list[str] = []
    drive_many = tasks.drive_many

    def watched(controllers: Any, *rest: Any, **named: Any) -> Any:
        driven.extend(controller.name for controller in controllers)
        return drive_many(controllers, *rest, **named)

    monkeypatch.setattr(tasks, "drive_many", watched)
    before = S_of(ldc.run_study(study_of(edit(folder, OLD)), tmp_path / "out", workers=1))
    assert sorted(driven) == ["lqr", "mine", "none"]
    driven.clear()
    ldc.run_study(study_of(edit(folder, OLD)), tmp_path / "out", workers=1)  # the same code, imported again
    assert driven == []
    assert not caplog.records
    after = S_of(ldc.run_study(study_of(edit(folder, NEW)), tmp_path / "out", workers=1))
    assert driven == ["mine"]
    assert "'mine' has changed" in caplog.text
    fresh = S_of(ldc.run_study(study_of(edit(folder, NEW)), workers=1))
    assert after == fresh
    assert abs(after - before) > 0.05


def test_content_is_that_of_another_process(folder: Folder) -> None:
    """With other hashes of strings, other addresses, and what laws keep in memory while they run."""
    folder.write("helper", "SEEN = {}\ndef factor(n):\n    return SEEN.setdefault(n, 1.0)\n")
    kind = folder.law(
        imports="import enum, logging, threading\nfrom . import helper",
        before="LOCK = threading.Lock()\nlog = logging.getLogger('x')\nclass Way(enum.Enum):\n    A = 'a'",
        inside="assert Way.A.value in {'a', 'b'}; log.debug(LOCK)",
        factor="helper.factor(plant.n)",
    )
    content = content_of(kind)
    ldc.simulate(kind(), ldc.load_model("reference").sample(2, 2), 0.1)
    assert content_of(kind) == content
    program = f"from ldctoolkit.code_content import content_of; from {folder.path.name}.laws import Mine; "
    for seed in ("1", "2"):
        words = [sys.executable, "-B", "-c", f"{program}print(content_of(Mine))"]
        done = subprocess.run(
            words, cwd=folder.path.parent, env={"PYTHONHASHSEED": seed, "PYTHONPATH": "."}, capture_output=True,
            text=True, check=True,
        )  # fmt: skip
        assert done.stdout.strip() == content
    assert content_of(ldc.LQR) == ""


def test_comments_alone_run_nothing_again(folder: Folder) -> None:
    assert content_of(folder.law()) == content_of(folder.law(before="# a comment\n\n", inside="pass  # another"))


def notebook(factor: float) -> ModuleType:
    """A cell that is run again: one namespace, one name of the class, no file."""
    cell = ModuleType("__main__")
    exec(LAW.format(**USUAL | {"factor": "FACTOR", "before": f"FACTOR = {factor}"}), vars(cell))
    return cell


def test_each_study_keeps_the_class_that_it_was_made_with() -> None:
    old, new = notebook(OLD), notebook(NEW)
    try:
        first = study_of(old.Mine)
        second = study_of(new.Mine, name="second")
        scores = [S_of(ldc.run_study(study, workers=1)) for study in (first, second, first.changed(), first)]
        assert scores[0] == scores[2] == scores[3]
        assert abs(scores[1] - scores[0]) > 0.05
        with refused("design", value="mine"):
            study_of(old.Mine, new.Mine)
        assert len(study_of(old.Mine, notebook(OLD).Mine).designs) == 3  # the same cell, run twice
    finally:
        registry.forget("mine")


def test_a_value_of_another_cell_is_changed(tmp_path: Path) -> None:
    """The class is the same object; what it refers to is not, also in a study that was made before."""
    cell = notebook(OLD)
    try:
        study = study_of(cell.Mine)
        before = ldc.run_study(study, tmp_path / "out", workers=1)
        cell.FACTOR = NEW
        with pytest.raises(StoreError, match="'mine': its code has changed since the study was run"):
            ldc.read_results(tmp_path / "out")
        after = ldc.run_study(study, tmp_path / "out", workers=1)
        assert abs(S_of(after) - S_of(before)) > 0.05
        assert {d.id for d in after.designs} & {d.id for d in before.designs} == {
            d.id for d in after.designs if d.law != "mine"
        }
        assert S_of(ldc.read_results(tmp_path / "out")) == S_of(after)
    finally:
        registry.forget("mine")


def test_a_law_inside_another_is_edited(folder: Folder, tmp_path: Path) -> None:
    registry.register(folder.law())
    filtered = {"law": "barrier_filter", "gains": {"inner": ["mine"], "e_y_max": [9.0]}}
    before = S_of(ldc.run_study(study_of(filtered), tmp_path / "out", workers=1), "barrier_filter")
    registry.register(folder.law(factor="0.05"))
    with pytest.raises(StoreError, match="law 'mine'"):
        ldc.read_results(tmp_path / "out")
    after = S_of(ldc.run_study(study_of(filtered), tmp_path / "out", workers=1), "barrier_filter")
    assert abs(after - before) > 0.05


def test_a_law_that_is_inside_by_default_is_edited(folder: Folder, tmp_path: Path) -> None:
    """A filter of the designer's, whose study does not name the law inside."""

    @dataclasses.dataclass(frozen=True)
    class Filter(ldc.Controller):
        name: ClassVar[str] = "filter_of_mine"
        title: ClassVar[str] = "Filter"
        law_options: ClassVar[tuple[str, ...]] = ("inner",)
        inner: str = ldc.option("mine", choices=None, description="the law inside")

        def prepare(self, plant: ldc.Plant) -> Any:
            return ldc.controller_class(self.inner)().prepare(plant)

    try:
        registry.register(folder.law())
        before = S_of(ldc.run_study(study_of(Filter), tmp_path / "out", workers=1), "filter_of_mine")
        registry.register(folder.law(factor="0.05"))
        with pytest.raises(StoreError, match="law 'mine'"):
            ldc.read_results(tmp_path / "out")
        after = S_of(ldc.run_study(study_of(Filter), tmp_path / "out", workers=1), "filter_of_mine")
        assert abs(after - before) > 0.05
    finally:
        registry.forget("filter_of_mine")


def test_a_report_of_changed_code_is_refused(
    folder: Folder, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    ldc.run_study(study_of(folder.law()), tmp_path / "out", workers=1)
    monkeypatch.setattr(registry, "_by_code", {})  # another process does not know the class
    registry.register(folder.law(factor="0.05"))
    for command in ("report", "rank"):
        assert main([command, str(tmp_path / "out")]) == 2
        printed = capsys.readouterr()
        assert "law 'mine': its code has changed since the study was run; run it into this folder again" in printed.err
        assert printed.err.count("\n") == 1
    assert not (tmp_path / "out" / "report.html").exists()
    ldc.run_study(study_of(folder.law(factor="0.05")), tmp_path / "new", workers=1)
    # stored numbers are compared as they are
    compared = ldc.compare(tmp_path / "out", tmp_path / "new")
    assert (compared.shared.n, compared.only_old, compared.only_new) == (14, (), ())
    assert compared.differences == ("law mine: other code",)


def test_numbers_of_other_versions_are_read_and_never_added_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    from ldctoolkit.studies.storage import manifest

    study = study_of(ranking={"finalists": 2, "bootstrap": 100})
    reference = ldc.run_study(study, tmp_path / "out", workers=1)
    parts = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("part-*")}
    robustness = tmp_path / "out" / "robustness.json"
    assert main(["report", str(tmp_path / "out"), "--no-figures"]) == 0
    assert robustness.exists()
    capsys.readouterr()
    assert main(["rank", str(tmp_path / "out")]) == 0
    before = capsys.readouterr().out
    versions = manifest.versions()
    monkeypatch.setattr(manifest, "versions", lambda *_: (*versions[:-1], ("osqp", "0.0.1")))
    assert main(["rank", str(tmp_path / "out")]) == 0
    out, err = capsys.readouterr()
    assert out == before
    assert re.search(r"out: was run with osqp \S+ \(now 0\.0\.1\); its numbers are read as they are", err)
    assert main(["report", str(tmp_path / "out"), "--no-figures"]) == 0
    assert "This study was run with osqp" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    np.testing.assert_array_equal(ldc.read_results(tmp_path / "out").S, reference.S)
    unlink = Path.unlink

    def interrupted(path: Path, **rest: Any) -> None:
        unlink(path, **rest)
        if path.name.startswith("part-"):
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:  # it is stopped while it clears the folder
        patch.setattr(Path, "unlink", interrupted)
        with pytest.raises(KeyboardInterrupt):
            ldc.run_study(study, tmp_path / "out", workers=1)
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        again = ldc.run_study(study, tmp_path / "out", workers=1)
    assert sum("everything is computed anew" in record.message for record in caplog.records) == 1
    assert all(not path.exists() or path.stat().st_mtime_ns != before for path, before in parts.items())
    assert again.fresh is not None
    assert not robustness.exists()
    np.testing.assert_array_equal(again.S, reference.S)


@pytest.mark.slow
def test_workers_have_the_loaded_code(folder: Folder, tmp_path: Path) -> None:
    """Whatever their own files say, and whatever an earlier study left in them."""
    scores = []
    for factor in (OLD, NEW, OLD):
        for edit in ("helper", "base"):
            study = study_of(EDITS[edit](folder, factor))
            folder.write("helper", "raise SystemExit")
            scores.append(S_of(ldc.run_study(study, workers=2)))
    assert scores[0] == scores[1] == scores[4] == scores[5] != scores[2] == scores[3]


@pytest.mark.slow
def test_a_killed_run_is_resumed_with_edited_code(folder: Folder, tmp_path: Path) -> None:
    """Parts of the old code are there, and of the law that was not edited."""
    folder.law()
    program = (
        f"import ldctoolkit as ldc; from {folder.path.name}.laws import Mine; "
        "from ldctoolkit.studies.running import campaign; "
        "campaign._STORE_EVERY = -1.0; study = ldc.study(ldc.NoControl, ldc.LQR, Mine, y_s=[0.05, 0.1, 0.2], "
        "name='edited', ranking={'finalists': 0, 'bootstrap': 100}, left=8, right=6); "
        "ldc.run_study(study, 'out', workers=1, block_size=1)"
    )
    for step in (27, 20, 22):  # of making, writing and renaming files of the folder
        words = [sys.executable, "-B", "-c", killing(tmp_path / "out", step) + program]
        done = subprocess.run(words, cwd=tmp_path, env=os.environ | {"PYTHONPATH": "."}, check=False, timeout=600)
        assert done.returncode == -signal.SIGKILL
    assert len(list((tmp_path / "out" / "results").glob("part-*"))) > 2
    study = study_of(folder.law(factor="0.05"), y_s=[0.05, 0.1, 0.2])
    assert_same_results(ldc.run_study(study, tmp_path / "out", workers=1), ldc.run_study(study, workers=1))


@pytest.mark.slow
def test_a_dask_worker_that_lives_on_has_the_edited_code(folder: Folder) -> None:
    distributed = pytest.importorskip("distributed")
    scores = []
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        for factor in (OLD, NEW, OLD):
            study = study_of(EDITS["helper"](folder, factor))
            scores.append(S_of(ldc.run_study(study, dask=cluster.scheduler_address)))
    assert scores[0] == scores[2] != scores[1]
