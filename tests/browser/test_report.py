"""The report in a real browser: no error, nothing wider than the screen, sorting works, figures are drawn."""

from __future__ import annotations

import html
import json
import re
import subprocess
from pathlib import Path
from types import ModuleType

import pytest

from studies.report import write_report
from studies.results import Case

pytestmark = [pytest.mark.browser, pytest.mark.slow]

FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--hide-scrollbars", "--enable-logging=stderr", "--v=0",
)  # fmt: skip

# a headless window is never narrower than 500 px: the page is put into a frame of the wanted size
FRAME = """<!DOCTYPE html><body style="margin:0"><iframe id="f" style="border:0;width:{width}px;height:{height}px"
srcdoc="{page}"></iframe><pre id="out"></pre><script>
document.getElementById("f").addEventListener("load", function () {{
  var page = document.getElementById("f").contentDocument, view = page.defaultView, out = {{}};
  out.width = view.innerWidth;
  out.overflow = page.documentElement.scrollWidth - view.innerWidth;
  out.wide = Array.from(page.querySelectorAll("main *")).filter(function (e) {{
    return !e.closest(".scroll, pre, svg") && e.getBoundingClientRect().right > view.innerWidth + 0.5;
  }}).map(function (e) {{ return e.tagName + "." + e.className; }});
  out.empty = Array.from(page.querySelectorAll(".panel svg")).filter(function (e) {{
    var box = e.getBoundingClientRect(); return box.width < 200 || box.height < 100;
  }}).length;
  out.cut = Array.from(page.querySelectorAll(".panel svg text")).filter(function (e) {{
    var t = e.getBoundingClientRect(), s = e.ownerSVGElement.getBoundingClientRect();
    return t.width && (t.left < s.left - 1 || t.right > s.right + 1 || t.top < s.top - 1 || t.bottom > s.bottom + 1);
  }}).map(function (e) {{ return e.textContent; }});
  var body = page.querySelector("table.ranking tbody");
  var ranks = function () {{ return Array.from(body.rows).map(function (r) {{ return +r.cells[0].textContent; }}); }};
  out.before = ranks();
  var rank = page.querySelector("table.ranking th button");
  rank.click(); rank.click();
  out.after = ranks();
  document.getElementById("out").textContent = JSON.stringify(out);
}});
</script>"""


def run(chromium: str, profile: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [chromium, *FLAGS, f"--user-data-dir={profile}", *arguments],
        capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip


@pytest.fixture(scope="module")
def page(make: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    cases = (Case("departure", "consistent"), Case("control", "as_printed"))
    results = make.run(make.grid(), make.invented_scenarios(40, 40), cases)
    return write_report(make.report_input(results), tmp_path_factory.mktemp("report") / "report.html")


@pytest.mark.parametrize(("width", "height"), [(1366, 768), (390, 844)])
def test_layout(chromium: str, page: Path, tmp_path: Path, width: int, height: int) -> None:
    frame = tmp_path / "frame.html"
    frame.write_text(FRAME.format(width=width, height=height, page=html.escape(page.read_text())), encoding="utf-8")
    done = run(
        chromium,
        tmp_path / "profile",
        "--window-size=1400,900",
        "--dump-dom",
        "--virtual-time-budget=5000",
        frame.as_uri(),
    )
    found = re.search(r'<pre id="out">(.*?)</pre>', done.stdout, re.DOTALL)
    assert found is not None
    out = json.loads(html.unescape(found[1]))
    assert out["width"] == width
    assert out["overflow"] <= 0
    assert out["wide"] == []
    assert out["empty"] == 0
    assert out["cut"] == []
    assert out["before"] == sorted(out["before"])
    assert out["after"] == out["before"][::-1]
    assert "CONSOLE" not in done.stderr


def test_opens_from_disk_without_a_message(chromium: str, page: Path, tmp_path: Path) -> None:
    picture = tmp_path / "report.png"
    done = run(chromium, tmp_path / "profile", "--window-size=1366,768", f"--screenshot={picture}", page.as_uri())
    assert picture.stat().st_size > 20_000
    assert "CONSOLE" not in done.stderr
