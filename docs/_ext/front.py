"""Pictures of the first page and of the README, from a small version of the study `trigger-and-gains`.

The site makes them in every build. ``make pictures`` writes those that the README shows, into docs/_pictures.
"""

import contextlib
import io
import shutil
import sys
import tempfile
import tomllib
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import tomli_w
from pictures import STYLE, darkened
from PIL import Image

import ldctoolkit as ldc
from ldctoolkit.studies.cli import main

_ROOT = Path(__file__).parents[2]
_SCREEN = {"width": 1100, "height": 566}


def small_study() -> dict[str, Any]:
    """The study of the catalog without its MPC, on fewer departures: seconds, not minutes."""
    table = tomllib.loads((_ROOT / "studies/catalog/trigger-and-gains.toml").read_text(encoding="utf-8"))
    table["design"] = [one for one in table["design"] if one["law"] != "linear_mpc"]
    table["scenarios"] |= {"left": 150, "right": 150}
    del table["ranking"]["extend"]
    return table | {"title": "Trigger threshold and gains of three laws"}


def draw(folder: Path, results: Any, study: Any) -> None:
    """The trade-off of all designs, and one departure with the best one and without control."""
    import matplotlib.pyplot as plt

    ranking = ldc.rank_study(results, study)
    with mpl.rc_context(STYLE | {"font.size": 8.5}):
        _, axes = plt.subplots(figsize=(4.8, 1.95), layout="constrained")
        axes = ldc.plot_trade_off(ranking, x="jerk_added_peak_p95", y="S", ax=axes)
        axes.set(xlabel="Added jerk, 95 % quantile [m/s³]", ylabel="Mean S [m·s]")
        axes.figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False)
        axes.get_legend().remove()
        _save(folder / "trade-off.svg", axes)

        best = ranking.designs[ranking.winner]
        scenarios = ldc.load_model("reference").sample(50, 50, seed=1)
        i = int(np.argsort(scenarios.d_y)[-5])
        law = best.controller()
        outcome = ldc.simulate(law, scenarios, best.y_s, setup=study.setup(), trajectories=True)
        _, axes = plt.subplots(figsize=(4.8, 1.95), layout="constrained")
        axes = ldc.plot_departure(outcome, i, axes, scenarios=scenarios, label=law.title)
        axes.set(title="", xlabel="Time since the crossing [s]", ylabel="Edge beyond the line [m]")
        _save(folder / "departure.svg", axes)


def _save(path: Path, axes: Any) -> None:
    axes.figure.savefig(path, metadata={"Date": None, "Creator": None})
    path.with_stem(path.stem + "-dark").write_text(darkened(path.read_text(encoding="utf-8")), encoding="utf-8")


def photograph(report: Path, folder: Path) -> str:
    """The first screen of a report, light and dark; what is missing for it, or nothing."""
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if chromium is None:
        return "no Chromium on PATH"
    try:
        from playwright.sync_api import Error, sync_playwright
    except ImportError:
        return "playwright is not installed"
    try:
        with sync_playwright() as session:
            browser = session.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu"])
            for name, scheme in (("report.png", "light"), ("report-dark.png", "dark")):
                page = browser.new_page(viewport=_SCREEN, color_scheme=scheme)
                page.goto(report.resolve().as_uri())
                picture = Image.open(io.BytesIO(page.screenshot()))
                picture.quantize(128, dither=Image.Dither.NONE).save(folder / name, optimize=True)
            browser.close()
    except Error as error:
        return f"the browser does not run: {error.message.splitlines()[0]}"
    return ""


def write(folder: Path) -> str:
    """All pictures; returns why the report has none, or nothing."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    with tempfile.TemporaryDirectory() as work:
        file, results = Path(work, "trigger-and-gains.toml"), Path(work, "results")
        file.write_text(tomli_w.dumps(small_study()), encoding="utf-8")
        options = ["-o", str(results), "--workers", "1", "--quiet", "--no-figures", "--refits", "0"]
        with contextlib.redirect_stdout(io.StringIO()):
            status = main(["run", str(file), *options])
        if status != 0:
            raise RuntimeError("the study of the first page has failed")
        draw(folder, ldc.read_results(results), ldc.load_study(file))
        return photograph(results / "report.html", folder)


if __name__ == "__main__":
    missing = write(made := _ROOT / "out" / "pictures")
    if missing:
        sys.exit(f"the report is not photographed: {missing}")
    for picture in made.iterdir():
        shutil.copy(picture, sys.argv[1])
