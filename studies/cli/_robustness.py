"""The numbers on other plants, as the commands that write a report need them."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from studies.ranking.ranking import Ranking
    from studies.results import StudyResults
    from studies.robustness.robustness import Robustness
    from studies.study_file.spec import Study


def add_option(parser: argparse.ArgumentParser) -> None:
    """Declare ``--no-robustness``."""
    parser.add_argument(
        "--no-robustness",
        action="store_true",
        help="leave out the report's section on other plants: a few designs are driven again on each of them, which "
        "takes some seconds the first time",
    )


def robustness_of_study(
    chosen: argparse.Namespace, folder: Path, study: Study, results: StudyResults, ranking: Ranking
) -> Robustness | None:
    """What DIR/robustness.json holds, worked out first where need be; None where it is not wanted.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    if chosen.no_robustness or not results.designs or not results.drivable().scenarios.n:
        return None
    from studies.robustness.robustness import RobustnessTask
    from studies.robustness.setting import Setting
    from studies.robustness.stored import robustness_of

    return robustness_of(folder, RobustnessTask.of(results, ranking, Setting.of(study, ranking.case)))
