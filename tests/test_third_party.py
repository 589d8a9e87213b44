"""A law outside the repository, as the guide tells it: written, installed, checked, swept, reported."""

import os
import re
from pathlib import Path

import pytest

from helpers.cli import blocks, csv_rows, install, python
from ldctoolkit.testing import CHECKS

pytestmark = pytest.mark.slow

GUIDE = "docs/how-to/my-law.md"
RUN = "-m ldctoolkit run sweep.toml -o out --no-robustness --no-figures --workers"


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
    path = os.pathsep.join([str(site), *filter(None, [os.environ.get("PYTHONPATH")])])

    def process(line: str) -> str:
        return python(*line.split(), cwd=project, PYTHONPATH=path, PYTHONDONTWRITEBYTECODE="1")

    assert "K_rate" in process("-m ldctoolkit controllers offset")
    assert "Offset" in process(f"{RUN} 2")
    rows = csv_rows(project / "out" / "ranking.csv")
    assert [row["law"] for row in rows].count("offset") == 8
    assert {row["gain_K_y_rad_per_m"] for row in rows if row["law"] == "offset"} == {"-0.04", "-0.03", "-0.02", "-0.01"}
    assert all(float(row["reduction"]) > 0 for row in rows if row["law"] != "none")
    assert not any(row["failure"] for row in rows)
    page = (project / "out" / "report.html").read_text(encoding="utf-8")
    table = page.split('<table id="designs"')[1].split("</table>")[0]
    assert table.count("K<sub>y</sub>") == 6  # two have the default

    checked = process("-m pytest -q -p no:cacheprovider tests")
    assert re.search(rf"^{2 * len(CHECKS)} passed", checked, flags=re.M)  # both laws of the guide
