"""One finished study a session, which the commands that read a folder are tried on."""

import shutil
from pathlib import Path
from typing import Any

import pytest

from ldctoolkit.studies import Study, run_study


@pytest.fixture(scope="session")
def content() -> dict[str, Any]:
    """The study behind `finished`."""
    return {
        "name": "before",
        "seed": 2,
        "scenarios": {"left": 150, "right": 100},
        "ranking": {"bootstrap": 200, "finalists": 2},
        "design": [{"law": "none"}, {"law": "lqr", "y_s": [0.05, 0.2]}, {"law": "preview_proportional"}],
    }


@pytest.fixture(scope="session")
def finished(content: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of four designs on 250 scenarios, with finalists and without a ranking.csv. To be read only."""
    folder = tmp_path_factory.mktemp("finished") / "plain"
    run_study(Study.from_dict(content), directory=folder, workers=1, progress=False)
    return folder


@pytest.fixture
def folder(finished: Path, tmp_path: Path) -> Path:
    """A folder with a copy of it, called ``plain``."""
    shutil.copytree(finished, tmp_path / "plain")
    return tmp_path
