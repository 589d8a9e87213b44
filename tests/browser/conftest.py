"""A browser that must stay silent, the rules of axe-core, and the pages to open."""

import os
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NoReturn

import pytest

from helpers.browser_pages import Made
from helpers.cli import ROOT

LONG = 600_000  # milliseconds that a step may take which is sure to end, on a machine that does other things as well


def missing(what: str) -> NoReturn:
    """Skip on a desk, fail where everything must be tested."""
    if os.environ.get("CI") == "true":
        pytest.fail(what)
    pytest.skip(what)


@pytest.fixture(scope="session")
def chromium() -> str:
    """Path of a Chromium."""
    for name in ("chromium", "chromium-browser", "google-chrome"):
        if found := shutil.which(name):
            return found
    missing("no Chromium on PATH (chromium, chromium-browser, google-chrome)")


@pytest.fixture(scope="session")
def axe() -> str:
    """The script of axe-core."""
    path = Path(sys.prefix) / "node_modules" / "axe-core" / "axe.min.js"
    if not path.is_file():
        missing(f"no axe-core in {path.parent}; `make test` installs it where npm is on PATH")
    return path.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def browser(chromium: str) -> Iterator[Any]:
    """One Chromium a module: its event loop must be gone when tests with loops of their own run."""
    playwright = pytest.importorskip("playwright.sync_api") if os.environ.get("CI") != "true" else None
    if playwright is None:
        import playwright.sync_api as playwright
    with playwright.sync_playwright() as session:
        arguments = ["--no-sandbox", "--disable-gpu"]
        started = session.chromium.launch(executable_path=chromium, args=arguments, timeout=LONG)
        yield started
        started.close()


@pytest.fixture
def open_page(browser: Any) -> Iterator[Callable[..., Any]]:
    """Open a file: ``open_page(path, width=1366, height=768, dark=False, script=True)``.

    The test fails on any word of the console, on any error or dialog, and on any request but the one for the file.
    """
    contexts, heard = [], []

    def opened(
        path: Path, *, width: int = 1366, height: int = 768, dark: bool = False, script: bool = True, at: str = ""
    ) -> Any:
        context = browser.new_context(
            viewport={"width": width, "height": height},
            color_scheme="dark" if dark else "light",
            java_script_enabled=script,
            reduced_motion="reduce",
        )
        context.set_default_timeout(LONG)
        contexts.append(context)
        address = path.resolve().as_uri()

        def asked(request: Any) -> None:
            if request.url.split("#")[0] != address:
                heard.append(f"request: {request.url[:200]}")

        def dialog(opened: Any) -> None:
            heard.append(f"dialog: {opened.message}")
            opened.dismiss()

        page = context.new_page()
        context.on("request", asked)
        context.on("page", lambda other: heard.append(f"another page: {other.url}") if other != page else None)
        page.on("console", lambda message: heard.append(f"console: {message.type}: {message.text}"))
        page.on("pageerror", lambda error: heard.append(f"error: {error}"))
        page.on("dialog", dialog)
        page.goto(address + at)
        return page

    yield opened
    for context in contexts:
        context.close()
    assert heard == []


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """Pages by name, each built when it is first asked for."""
    base = tmp_path_factory.getbasetemp()
    root = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "pages"
    root.mkdir(exist_ok=True)
    return Made(root)


@pytest.fixture(scope="module")
def site_pages() -> list[Path]:
    """All pages of the site that `make docs` built."""
    site = ROOT / "out/docs"
    found = sorted(site.rglob("*.html"))
    sources = [path for folder in ("docs/_static", "docs/_ext") for path in (ROOT / folder).glob("*.*")]
    sources += [path for path in (ROOT / "docs").rglob("*.md") if "generated" not in path.parent.name]
    newest = max(path.stat().st_mtime for path in sources)
    if not found or (site / "searchindex.js").stat().st_mtime < newest:
        missing("the site in out/docs is missing or older than its sources; `make docs` builds it")
    return found
