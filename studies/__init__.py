"""Studies: many designs on the same scenarios, stored, ranked and reported."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from studies.compare_studies import compare
    from studies.comparison import Comparison
    from studies.design import Design
    from studies.manifest import Manifest, read_manifest
    from studies.ranking import Ranking, rank_study
    from studies.results import Case, CaseResults, StudyResults
    from studies.runner import run_study
    from studies.spec import Study
    from studies.store import read_results

# loaded on first use, so that the command line answers --help without the data libraries
_HOMES = {
    "Case": "results",
    "CaseResults": "results",
    "Comparison": "comparison",
    "Design": "design",
    "Manifest": "manifest",
    "Ranking": "ranking",
    "Study": "spec",
    "StudyResults": "results",
    "compare": "compare_studies",
    "rank_study": "ranking",
    "read_manifest": "manifest",
    "read_results": "store",
    "run_study": "runner",
}

__all__ = [
    "Case",
    "CaseResults",
    "Comparison",
    "Design",
    "Manifest",
    "Ranking",
    "Study",
    "StudyResults",
    "compare",
    "rank_study",
    "read_manifest",
    "read_results",
    "run_study",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'studies' has no attribute {name!r}")
    return getattr(importlib.import_module(f"studies.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return __all__
