"""The pages that are opened: an ordinary study as `ldc run` leaves it, and studies with something odd about them."""

import contextlib
import csv
import dataclasses
import fcntl
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from helpers.models import checked_model, make_departures, skewed
from helpers.results import grid, invented_scenarios, report_input, run
from ldctoolkit import Controller, EventStatus, RecordedPath, option, register
from ldctoolkit.controllers import LQR, NoControl, NonlinearMPC, PreviewProportional
from ldctoolkit.studies.cli import main
from ldctoolkit.studies.design import Design
from ldctoolkit.studies.pages.fit_page import write_fit_page
from ldctoolkit.studies.pages.report import write_report
from ldctoolkit.studies.ranking.ranking import Ranking
from ldctoolkit.studies.results import per_scenario

ORDINARY = """
name = "ordinary"
title = "Trigger and gains of two laws"
seed = 3

[scenarios]
left = 30
right = 30

[simulation]
window = "departure"

[ranking]
bootstrap = 200
require = ["a_y_peak_p95 <= 14.0"]
finalists = 4

[[design]]
law = "none"

[[design]]
law = "preview_proportional"
y_s = [0.05, 0.2, 0.3]
[design.gains]
K_y = [-0.04, -0.02, -0.005]
K_psi = [-0.5, -0.2]

[[design]]
law = "lqr"
y_s = [0.05, 0.1, 0.3]
[design.gains]
r_delta = [10.0, 100.0, 1000.0]
"""

DRIVER = """
[plant.driver]
straight = 0.5
recorded = 0.25
against = 0.25
"""

EVIL = "<script>alert(1)</script>"  # a name that must stay text
HEBREW = "\u05d0\u05d1\u05d2"  # text that is read from the right to the left

HOSTILE = f"""
name = "hostile"
title = "</script>{EVIL} & \\"quoted\\" 'x' {HEBREW} \u202e K_psi"
seed = 3

[scenarios]
left = 15
right = 15

[ranking]
bootstrap = 100
finalists = 2

[[design]]
law = "none"

[[design]]
law = "preview_proportional"
y_s = [0.05, 0.2]

[[design]]
law = "hostile_words"
y_s = [0.05, 0.2]
[design.gains]
word = ["plain", "{EVIL}", "</script>&amp;\\"'{HEBREW}"]
"""


@register
@dataclasses.dataclass(frozen=True)
class Hostile(Controller):
    """A law with names that nobody should be able to put on a page."""

    name: ClassVar[str] = "hostile_words"
    title: ClassVar[str] = f"{EVIL} & \"q\" 'x' {HEBREW}"

    word: str = option("plain", choices=("plain", EVIL, f"</script>&amp;\"'{HEBREW}"), description="")

    def prepare(self, plant: object) -> RecordedPath:
        return RecordedPath()


@dataclasses.dataclass(frozen=True)
class OnePage:
    """A page and what it was made from."""

    path: Path

    @property
    def folder(self) -> Path:
        """Of the study; only pages that `ldc run` made have one."""
        return self.path.parent

    def rows(self) -> list[dict[str, str]]:
        """Of ranking.csv, as they are ordered there."""
        with (self.folder / "ranking.csv").open(encoding="utf-8", newline="") as stream:
            return list(csv.DictReader(stream))


class Made:
    """Pages by name, each made once."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._pages: dict[str, OnePage] = {}
        self._makers: dict[str, Callable[[Path], Path]] = {
            "ordinary": lambda folder: self._study(folder, ORDINARY),
            "hostile": lambda folder: self._study(folder, HOSTILE),
            "driver": lambda folder: self._study(folder, ORDINARY + DRIVER),
            "thousand": self._thousand,
            "zero-triggered": lambda folder: self._designs(
                folder,
                Design.of(PreviewProportional(), 5.0),
                Design.of(LQR(r_delta=100.0), 6.0),
                Design.of(NoControl(), 5.0),
            ),
            "one-design": lambda folder: self._designs(folder, Design.of(PreviewProportional(), 0.2)),
            "planning": lambda folder: self._designs(
                folder, Design.of(NonlinearMPC(horizon=8, mu=0.3), 0.1), Design.of(LQR(), 0.1)
            ),
            "only-no-control": lambda folder: self._designs(folder, Design.of(NoControl(), 0.2)),
            "left-only": lambda folder: self._designs(folder, *grid()[:6], sides=(14, 0)),
            "right-only": lambda folder: self._designs(folder, *grid()[:6], sides=(0, 14)),
            "one-scenario": lambda folder: self._designs(folder, *grid()[:4], sides=(1, 0)),
            "all-failures": self._all_failures,
            "nothing-ranked": self._nothing_ranked,
            "compare": self._compare,
            "fit": self._fit,
            "paper": self._paper,
        }

    def __call__(self, name: str) -> OnePage:
        """The page of that name."""
        if name not in self._pages:
            done = self._root / f"{name}.done"
            with (self._root / f"{name}.lock").open("w") as lock:
                fcntl.flock(lock, fcntl.LOCK_EX)  # several test processes share the folder
                if not done.exists():
                    done.write_text(str(self._makers[name](self._root / name)), encoding="utf-8")
            self._pages[name] = OnePage(Path(done.read_text(encoding="utf-8")))
        return self._pages[name]

    def _study(self, folder: Path, text: str) -> Path:
        folder.mkdir()
        file = folder.with_suffix(".toml")
        file.write_text(text, encoding="utf-8")
        with contextlib.redirect_stdout(io.StringIO()):
            assert main(["run", str(file), "-o", str(folder), "--workers", "1", "--quiet", "--no-figures"]) == 0
        return folder / "report.html"

    def _written(self, folder: Path, results: Any, **changes: Any) -> Path:
        folder.mkdir()
        return write_report(report_input(results, **changes), folder / "report.html")

    def _designs(self, folder: Path, *designs: Design, sides: tuple[int, int] = (12, 9)) -> Path:
        return self._written(folder, run(designs, invented_scenarios(*sides)))

    def _all_failures(self, folder: Path) -> Path:
        results = run(grid()[:6], invented_scenarios(12, 9))
        status = np.full(results.status.shape, EventStatus.DIVERGED, dtype=np.int8)
        status[:, ::2] = EventStatus.SOLVER_FAILED
        changes: dict[str, Any] = {"S": results.S + 20.0, "failed_solves": results.failed_solves + 3}
        return self._written(folder, dataclasses.replace(results, status=status, **changes))

    def _nothing_ranked(self, folder: Path) -> Path:
        results = run(grid()[:6], invented_scenarios(12, 9))
        folder.mkdir()
        ranking = Ranking.of(results, bootstrap=100, require=["S <= 0"])
        report = dataclasses.replace(report_input(results), ranking=ranking)
        return write_report(report, folder / "report.html")

    def _thousand(self, folder: Path) -> Path:
        """1,000 designs: a few, at thresholds less than a millimetre apart, with scores that differ a little."""
        few, rng = run(grid(), invented_scenarios(60, 60)), np.random.default_rng(0)
        rows = np.concatenate([[0], np.resize(np.arange(1, len(few.designs)), 999)])  # without control once
        designs = [
            dataclasses.replace(few.designs[row], y_s=few.designs[row].y_s + 1e-8 * i) for i, row in enumerate(rows)
        ]
        factors = np.concatenate([np.ones((1, few.scenarios.n)), rng.uniform(1.0, 1.1, (999, few.scenarios.n))])
        arrays = {name: getattr(few, name)[rows] for name in ("S_uncorrected", "status", "failed_solves", "law_time")}
        results = dataclasses.replace(
            few,
            designs=tuple(designs),
            S=few.S[rows] * factors,
            metrics=per_scenario(few.metrics, lambda values: values[rows]),
            **arrays,
        )
        return self._written(folder, results)

    def _compare(self, folder: Path) -> Path:
        """The ordinary study against the same one with a slow actuator and without one of its designs."""
        other = ORDINARY.replace("y_s = [0.05, 0.2, 0.3]", "y_s = [0.05, 0.2]").replace('"ordinary"', '"slow"')
        self._study(folder, other + "\n[plant.actuator]\nlag = 0.2\n")
        page = folder / "compare.html"
        with contextlib.redirect_stdout(io.StringIO()):
            assert main(["compare", str(self("ordinary").folder), str(folder), "-o", str(page)]) == 0
        return page

    def _paper(self, folder: Path) -> Path:
        with contextlib.redirect_stdout(io.StringIO()):
            assert main(["run", "paper", "-o", str(folder), "--workers", "1", "--quiet", "--no-figures"]) == 0
        return folder / "paper.html"

    def _fit(self, folder: Path) -> Path:
        folder.mkdir()
        model, page = checked_model(), folder / "fit.html"
        write_fit_page(page, model, skewed(make_departures(model)))
        return page
