"""A law outside the repository, as the guide tells it: written, installed, checked, swept, reported; broken ones."""

from __future__ import annotations

import csv
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from helpers.docs import blocks, install
from ldctoolkit.testing import CHECKS

pytestmark = pytest.mark.slow

GUIDE = "docs/writing-a-controller.md"
RUN = "-m ldctoolkit run sweep.toml -o out --no-robustness --no-figures --workers"


def process(line: str, cwd: Path, site: Path) -> subprocess.CompletedProcess[str]:
    """Python with the packages of a folder."""
    path = os.pathsep.join([str(site), *filter(None, [os.environ.get("PYTHONPATH")])])
    env = os.environ | {"PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, *line.split()]
    return subprocess.run(command, cwd=cwd, env=env, capture_output=True, text=True, check=False)


def ranking(folder: Path) -> list[dict[str, str]]:
    with (folder / "ranking.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """The guide's files where the guide puts them."""
    folder = tmp_path / "lane-laws"
    (folder / "lane_laws").mkdir(parents=True)
    (folder / "tests").mkdir()
    (folder / "lane_laws" / "__init__.py").write_text("")
    (folder / "lane_laws" / "offset.py").write_text(blocks(GUIDE, "python")[0], encoding="utf-8")
    (folder / "tests" / "test_offset.py").write_text(blocks(GUIDE, "py")[0], encoding="utf-8")
    (folder / "lane_laws" / "limited.py").write_text("\n\n".join(blocks(GUIDE, "python")), encoding="utf-8")
    limited = re.sub(r"\bOffset\b", "LimitedOffset", blocks(GUIDE, "py")[0]).replace("laws.offset", "laws.limited")
    (folder / "tests" / "test_limited.py").write_text(limited, encoding="utf-8")
    pyproject, sweep = blocks(GUIDE, "toml")
    (folder / "pyproject.toml").write_text(pyproject, encoding="utf-8")
    small = sweep.replace("= 200", "= 15") + "\n[ranking]\nbootstrap = 200\n"
    (folder / "sweep.toml").write_text(small, encoding="utf-8")
    return folder


def test_the_guide_from_the_file_to_the_report(project: Path, tmp_path: Path) -> None:
    site = tmp_path / "site"
    install(project, site)

    listed = process("-m ldctoolkit controllers offset", project, site)
    assert listed.returncode == 0, listed.stderr
    assert "K_rate" in listed.stdout

    ran = process(f"{RUN} 2", project, site)
    assert ran.returncode == 0, ran.stderr
    assert "Offset" in ran.stdout
    rows = ranking(project / "out")
    assert [row["law"] for row in rows].count("offset") == 8
    assert {row["gain_K_y_rad_per_m"] for row in rows if row["law"] == "offset"} == {"-0.04", "-0.03", "-0.02", "-0.01"}
    assert all(float(row["reduction"]) > 0 for row in rows if row["law"] != "none")
    assert not any(row["failure"] for row in rows)
    page = (project / "out" / "report.html").read_text(encoding="utf-8")
    assert page.count("<br><code>offset</code>") == 8
    assert "K<sub>y</sub>" in page

    checked = process("-m pytest -q -p no:cacheprovider tests", project, site)
    assert checked.returncode == 0, checked.stdout
    assert re.search(rf"^{2 * len(CHECKS)} passed", checked.stdout, flags=re.M)  # both laws of the guide


BROKEN = """
import dataclasses
from typing import ClassVar

import numpy as np

from ldctoolkit import Controller, EventStatus, SteeringLaw, gain

CALLS = []


@dataclasses.dataclass(frozen=True)
class Law(SteeringLaw):
    how: str

    @property
    def preview_times(self):
        return np.zeros(0)

    def init(self, n):
        return None

    def step(self, t, x, preview, delta_prev, state):
        status = np.full(t.size, EventStatus.OK, dtype=np.int8)
        if self.how == "raises":
            raise RuntimeError("the map has no lane here")
        if self.how == "no_number":
            return np.full(t.size, np.nan), None, status
        if self.how == "shape":
            return np.zeros((t.size, 2)), None, status
        if self.how == "kind":
            return None, None, status
        CALLS.append(self.how)
        return -1e-4 * x[:, 0] * (1 + 1e-3 * len(CALLS)), None, status


class Broken(Controller):
    how: ClassVar[str]
    gains_made: ClassVar[int] = 0

    def prepare(self, plant):
        return Law(self.how)


def made(how):
    fields = [("K", float, gain(0.0, unit="1", lower=0.0, upper=1.0, description="nothing"))]
    space = {"name": how, "title": how.title(), "how": how, "__module__": __name__}
    return dataclasses.make_dataclass(how, fields, bases=(Broken,), namespace=space, frozen=True)


raises, no_number, shape, kind, remembers = map(made, ("raises", "no_number", "shape", "kind", "remembers"))
"""

SENTENCES = {
    "raises": r"RuntimeError: the map has no lane here \(broken\.py, line \d+\)",
    "shape": r"controller 'shape': step returned shapes \(\d+, 2\), \(\d+,\); allowed: \(\d+,\)",
    "kind": r"controller 'kind': delta is None; allowed: an array of real numbers",
    "remembers": r"keeps state between runs: the same departure, driven twice, gave S = .* m s and then .*",
}

CONTRACT = {
    "raises": "interface: RuntimeError: the map has no lane here (broken.py, line ",
    "no_number": "finite: the command is nan at ",
    "shape": "interface: controller 'shape': step returned shapes (12, 2), (12,); allowed: (12,)",
    "kind": "interface: controller 'kind': delta is None; allowed: an array of real numbers",
    "remembers": "repeatable: a second run of the same law: delta is ",
}


@pytest.fixture
def broken(project: Path) -> Path:
    """The same project with five laws more, all broken."""
    (project / "lane_laws" / "broken.py").write_text(BROKEN, encoding="utf-8")
    names = list(CONTRACT)
    with (project / "pyproject.toml").open("a", encoding="utf-8") as file:
        file.writelines(f'{name} = "lane_laws.broken:{name}"\n' for name in names)
    with (project / "sweep.toml").open("a", encoding="utf-8") as file:
        file.writelines(f'[[design]]\nlaw = "{name}"\n[design.gains]\nK = [0, 1]\n' for name in names)
    lines = (f"class Test_{name}(ControllerContract):\n    controller = broken.{name}\n" for name in names)
    tests = "from lane_laws import broken\nfrom ldctoolkit.testing import ControllerContract\n\n\n" + "\n\n".join(lines)
    (project / "tests" / "test_broken.py").write_text(tests, encoding="utf-8")
    return project


@pytest.mark.parametrize("workers", ["1", "2"])
def test_broken_laws_are_named_and_stop_nothing(broken: Path, tmp_path: Path, workers: str) -> None:
    site = tmp_path / "site"
    install(broken, site)
    ran = process(f"{RUN} {workers}", broken, site)
    assert ran.returncode == 3, ran.stderr
    assert "Traceback" not in ran.stderr
    assert "8 designs failed and are not ranked:" in ran.stdout
    rows = ranking(broken / "out")
    assert len(rows) == 1 + 1 + 8 + 5 * 2
    for row in rows:
        if row["law"] in SENTENCES:
            assert re.fullmatch(SENTENCES[row["law"]], row["failure"]), row["failure"]
            assert row["rank"] == row["S_m_s"] == ""
        else:
            assert row["failure"] == ""
            assert float(row["S_m_s"]) > 0
    assert all(int(row["failed_solves"]) > 0 for row in rows if row["law"] == "no_number")
    page = (broken / "out" / "report.html").read_text(encoding="utf-8")
    for name in SENTENCES:
        assert page.count(f"<code>{name}</code>") == 2
    assert "8 more designs failed and are not ranked" in page
    assert "No_Number" in page

    # the same laws mended: only they are tried again
    parts = {path: path.stat().st_mtime_ns for path in (broken / "out" / "results").iterdir()}
    text = BROKEN.replace("return Law(self.how)", "return Law('no_number')")
    (broken / "lane_laws" / "broken.py").write_text(text, encoding="utf-8")
    ran = process(f"{RUN} {workers}", broken, site)
    assert ran.returncode == 0, ran.stderr
    assert parts.items() <= {path: path.stat().st_mtime_ns for path in (broken / "out" / "results").iterdir()}.items()
    assert not any(row["failure"] for row in ranking(broken / "out"))


def test_the_contract_names_each_of_them(broken: Path, tmp_path: Path) -> None:
    site = tmp_path / "site"
    install(broken, site)
    checked = process("-m pytest -q -p no:cacheprovider tests/test_broken.py", broken, site)
    assert checked.returncode == 1, checked.stdout
    for name, sentence in CONTRACT.items():
        assert f"ContractError: {name}: {sentence}" in checked.stdout, name
