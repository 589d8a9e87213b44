"""The report of a study's folder, as the commands that write one need it."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from ldctoolkit.departures import Departures
    from studies.ranking.ranking import Ranking
    from studies.results import StudyResults
    from studies.robustness import Robustness
    from studies.storage.manifest import Manifest
    from studies.study_file import Study


def add_report_options(parser: argparse.ArgumentParser) -> None:
    """Declare what every command that writes a report takes."""
    parser.add_argument(
        "--source",
        action="append",
        metavar="FILE.parquet",
        help="departures that the scenario model was fitted to, as ldc extract wrote them: the report compares the "
        "generated ones with them; repeatable",
    )
    parser.add_argument(
        "--no-robustness",
        action="store_true",
        help="drive no designs on other plants for the report, which takes some seconds the first time: it shows what "
        "DIR/robustness.json holds of this study, or leaves that section out",
    )
    parser.add_argument("--no-figures", action="store_true", help="write no figures/: the report's charts as SVG files")


@dataclasses.dataclass(frozen=True)
class ReportOptions:
    """What the command line says of the report."""

    source: Departures | None = None  # what the scenario model was fitted to
    robustness: bool = True  # whether to drive designs on other plants where no numbers of them are stored
    figures: bool = True  # whether to write the charts as files
    departures: tuple[int, ...] = ()  # scenario numbers to be put into the explorer
    designs: tuple[str, ...] = ()  # beginnings of ids of designs to be put into the explorer

    @classmethod
    def of(cls, chosen: argparse.Namespace, departures: Sequence[int] = (), designs: Sequence[str] = ()) -> Self:
        """Read what the options name."""
        source = None
        if chosen.source:
            from ldctoolkit.scenario_model import read_all_departures

            source = read_all_departures(chosen.source)[0]
        return cls(source, not chosen.no_robustness, not chosen.no_figures, tuple(departures), tuple(designs))

    def robustness_of(self, folder: Path, study: Study, results: StudyResults, ranking: Ranking) -> Robustness | None:
        """What DIR/robustness.json holds, worked out first where need be and wanted; None where there is nothing."""
        if not self.robustness or not results.designs or not results.drivable().scenarios.n:
            return stored_robustness(folder, study, results, ranking)
        from studies.robustness import RobustnessTask, robustness_of

        return robustness_of(folder, RobustnessTask.of(results, ranking, study.setup()))


def write_study_report(
    folder: Path,
    study: Study,
    manifest: Manifest,
    results: StudyResults,
    rankings: tuple[Ranking, ...],
    options: ReportOptions,
    robustness: Robustness | None,
) -> Path:
    """Write DIR/report.html and DIR/figures/."""
    from ldctoolkit.errors import StoreError
    from studies.pages.report import report_input, write_report

    report = report_input(
        folder, study, manifest, results, rankings, source=options.source, departures=options.departures,
        shown_designs=options.designs, robustness=robustness,
    )  # fmt: skip
    path = folder / "report.html"
    try:
        return write_report(report, path, figures=folder / "figures" if options.figures else None)
    except OSError as error:
        raise StoreError(f"{path}: cannot be written: {error.strerror or error}") from None


def stored_robustness(folder: Path, study: Study, results: StudyResults, ranking: Ranking) -> Robustness | None:
    """What DIR/robustness.json holds of these results; None where there is nothing."""
    if not results.designs or not results.drivable().scenarios.n:
        return None
    from studies.robustness import RobustnessTask, stored_of

    return stored_of(folder, RobustnessTask.of(results, ranking, study.setup()))
