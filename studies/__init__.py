"""Studies: many designs on the same scenarios, stored, ranked and reported."""

import importlib
from typing import TYPE_CHECKING, Any

import ldctoolkit  # noqa: F401  # an import of this package by its short name ends there

if TYPE_CHECKING:
    from .assessment import Assessment, assess
    from .comparison.comparison import Comparison, compare
    from .design import Design
    from .export import export_c
    from .extraction import run_extraction
    from .plotting import plot_convergence, plot_distribution, plot_landscape, plot_ranking, plot_trade_off
    from .ranking.ranking import Ranking, rank_study
    from .results import StudyResults
    from .risk import estimate_risk
    from .runner import run_study
    from .storage.manifest import Manifest, read_manifest
    from .storage.store import read_results
    from .study_file import Study, load_study, study

# loaded on first use, so that the command line answers --help without the data libraries
_HOMES = {
    "Assessment": "assessment",
    "Comparison": "comparison.comparison",
    "Design": "design",
    "Manifest": "storage.manifest",
    "Ranking": "ranking.ranking",
    "Study": "study_file",
    "StudyResults": "results",
    "assess": "assessment",
    "compare": "comparison.comparison",
    "estimate_risk": "risk",
    "export_c": "export",
    "load_study": "study_file",
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
    "study": "study_file",
}

__all__ = [
    "Assessment",
    "Comparison",
    "Design",
    "Manifest",
    "Ranking",
    "Study",
    "StudyResults",
    "assess",
    "compare",
    "estimate_risk",
    "export_c",
    "load_study",
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
    "study",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'studies' has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return __all__
