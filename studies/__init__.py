"""Studies: many designs on the same scenarios, stored, ranked and reported."""

import importlib
from typing import TYPE_CHECKING, Any

if __name__ == "studies":  # in a checkout, whose root is on Python's path
    raise ImportError("studies: the name of this package is ldctoolkit.studies", name="studies")

if TYPE_CHECKING:
    from .assessment import Assessment, assess
    from .comparison.comparison import Comparison, compare
    from .design import Design
    from .export import export_c
    from .extraction import run_extraction
    from .plotting import (
        plot_convergence,
        plot_departure,
        plot_distribution,
        plot_landscape,
        plot_ranking,
        plot_trade_off,
    )
    from .ranking.ranking import Ranking, rank_study
    from .results import StudyResults
    from .risk import estimate_risk
    from .runner import run_study
    from .storage.manifest import Manifest, read_manifest
    from .storage.store import read_results
    from .study_file import Study, load_study, study

# loaded on first use, so that the command line answers --help without the data libraries
_MODULES = {
    "assessment": ("Assessment", "assess"),
    "comparison.comparison": ("Comparison", "compare"),
    "design": ("Design",),
    "export": ("export_c",),
    "extraction": ("run_extraction",),
    "plotting": (
        "plot_convergence",
        "plot_departure",
        "plot_distribution",
        "plot_landscape",
        "plot_ranking",
        "plot_trade_off",
    ),
    "ranking.ranking": ("Ranking", "rank_study"),
    "results": ("StudyResults",),
    "risk": ("estimate_risk",),
    "runner": ("run_study",),
    "storage.manifest": ("Manifest", "read_manifest"),
    "storage.store": ("read_results",),
    "study_file": ("Study", "load_study", "study"),
}

__all__ = [
    "Assessment", "Comparison", "Design", "Manifest", "Ranking", "Study", "StudyResults",
    "assess", "compare", "estimate_risk", "export_c", "load_study", "plot_convergence", "plot_departure",
    "plot_distribution", "plot_landscape", "plot_ranking", "plot_trade_off", "rank_study", "read_manifest",
    "read_results", "run_extraction", "run_study", "study",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    for module, names in _MODULES.items():
        if name in names:
            return getattr(importlib.import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
