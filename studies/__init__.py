"""Studies: many designs on the same scenarios, stored, ranked and reported."""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from studies.assessment import Assessment, assess
    from studies.comparison.comparison import Comparison, compare
    from studies.design import Design
    from studies.extraction import run_extraction
    from studies.plotting import plot_convergence, plot_distribution, plot_landscape, plot_ranking, plot_trade_off
    from studies.ranking.ranking import Ranking, rank_study
    from studies.results import Case, CaseResults, StudyResults
    from studies.runner import run_study
    from studies.storage.manifest import Manifest, read_manifest
    from studies.storage.store import read_results
    from studies.study_file import Study

# loaded on first use, so that the command line answers --help without the data libraries
_HOMES = {
    "Assessment": "assessment",
    "Case": "results",
    "CaseResults": "results",
    "Comparison": "comparison.comparison",
    "Design": "design",
    "Manifest": "storage.manifest",
    "Ranking": "ranking.ranking",
    "Study": "study_file",
    "StudyResults": "results",
    "assess": "assessment",
    "compare": "comparison.comparison",
    "plot_convergence": "plotting",
    "plot_distribution": "plotting",
    "plot_landscape": "plotting",
    "plot_ranking": "plotting",
    "plot_trade_off": "plotting",
    "rank_study": "ranking.ranking",
    "read_manifest": "storage.manifest",
    "read_results": "storage.store",
    "run_extraction": "extraction",
    "run_study": "runner",
}

__all__ = [
    "Assessment",
    "Case",
    "CaseResults",
    "Comparison",
    "Design",
    "Manifest",
    "Ranking",
    "Study",
    "StudyResults",
    "assess",
    "compare",
    "plot_convergence",
    "plot_distribution",
    "plot_landscape",
    "plot_ranking",
    "plot_trade_off",
    "rank_study",
    "read_manifest",
    "read_results",
    "run_extraction",
    "run_study",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'studies' has no attribute {name!r}")
    return getattr(importlib.import_module(f"studies.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return __all__
