"""The fit page in a real browser, at the widths of a desk and of a hand: nothing overflows, figures are drawn."""

from __future__ import annotations

import html
import importlib.util
import json
import re
import subprocess
from pathlib import Path

import pytest

from studies.fit_page import write_fit_page

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
  var all = function (what) {{ return Array.from(page.querySelectorAll(what)); }};
  out.width = view.innerWidth;
  out.overflow = page.documentElement.scrollWidth - view.innerWidth;
  out.wide = all("main *").filter(function (e) {{
    return !e.closest(".scroll, pre, svg") && e.getBoundingClientRect().right > view.innerWidth + 0.5;
  }}).map(function (e) {{ return e.tagName + "." + e.className; }});
  out.figures = all(".panel svg, .pairgrid svg").length;
  out.empty = all(".panel svg, .pairgrid svg").filter(function (e) {{
    var box = e.getBoundingClientRect(); return box.width < 200 || box.height < 100;
  }}).length;
  out.cut = all(".panel svg text, .pairgrid svg text").filter(function (e) {{
    var t = e.getBoundingClientRect(), s = e.ownerSVGElement.getBoundingClientRect();
    return t.width && (t.left < s.left - 1 || t.right > s.right + 1 || t.top < s.top - 1 || t.bottom > s.bottom + 1);
  }}).map(function (e) {{ return e.textContent; }});
  out.small = all(".panel svg text").filter(function (e) {{
    return e.textContent.trim() && e.getBoundingClientRect().height < 9;
  }}).map(function (e) {{ return e.textContent; }});
  out.maps = all("svg image").length;
  document.getElementById("out").textContent = JSON.stringify(out);
}});
</script>"""


def run(chromium: str, profile: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [chromium, *FLAGS, f"--user-data-dir={profile}", *arguments],
        capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip


@pytest.fixture(scope="module")
def fit_page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = Path(__file__).resolve().parents[1] / "studies" / "fit_page" / "conftest.py"
    spec = importlib.util.spec_from_file_location("fit_page_making", path)
    assert spec is not None
    assert spec.loader is not None
    make = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(make)
    target = tmp_path_factory.mktemp("fit") / "fit.html"
    model = make.make_model()
    write_fit_page(target, model, make.skewed(make.make_departures(model)))
    return target


@pytest.mark.parametrize(("width", "height"), [(1366, 768), (390, 844)])
def test_layout(chromium: str, fit_page: Path, tmp_path: Path, width: int, height: int) -> None:
    frame = tmp_path / "frame.html"
    frame.write_text(FRAME.format(width=width, height=height, page=html.escape(fit_page.read_text())), encoding="utf-8")
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
    assert out["figures"] == 2 * (4 + 2 + 1 + 1 + 1) + 4
    assert out["empty"] == 0
    assert out["cut"] == []
    assert out["small"] == []
    # two maps of T and d_y with their colour bars, and twelve of pairs, a side
    assert out["maps"] == 2 * (4 + 12)
    assert "CONSOLE" not in done.stderr


def test_prints(chromium: str, fit_page: Path, tmp_path: Path) -> None:
    paper = tmp_path / "fit.pdf"
    run(chromium, tmp_path / "profile", "--no-pdf-header-footer", f"--print-to-pdf={paper}", fit_page.as_uri())
    assert paper.read_bytes().startswith(b"%PDF")
    assert 3 <= len(re.findall(rb"/Type\s*/Page\b", paper.read_bytes())) <= 20
