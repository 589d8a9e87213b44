"""What a run or a ranking came to, as one JSON object a line, for scripts."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from studies.ranking.ranking import Ranking
from studies.results import StudyResults
from studies.storage.manifest import Manifest


def json_summary(results: StudyResults, ranking: Ranking, manifest: Manifest, ranking_csv: Path, report: Path) -> str:
    """The last line of ``ldc run --json``."""
    content = {"event": "done"} | _found(results, ranking, manifest)
    content |= {
        "wall_time_s": round(manifest.wall_time_s, 3),
        "executor": manifest.executor,
        "workers": manifest.workers,
        "ranking": str(ranking_csv),
        "report": str(report),
    }
    return json.dumps(content)


def rank_summary(results: StudyResults, ranking: Ranking, manifest: Manifest, ranking_csv: Path | None) -> str:
    """The one line of ``ldc rank --json``: what was found, and with which settings."""
    baseline = ranking.baseline
    content = {"event": "ranked"} | _found(results, ranking, manifest)
    content |= {
        "baseline": None if baseline is None else ranking.designs[baseline].id,
        "baseline_difference_m_s": None if ranking.winner is None else _number(
            ranking.baseline_difference[ranking.winner]
        ),
        "require": list(ranking.require),
        "not_ranked": [design.id for design, missed in zip(ranking.designs, ranking.unmet, strict=True) if missed],
        "pareto": list(ranking.pareto_figures),
        "pareto_front": [ranking.designs[i].id for i in range(len(ranking)) if ranking.pareto[i]],
        "confidence": ranking.confidence,
        "warnings": list(ranking.warnings),
        "ranking": None if ranking_csv is None else str(ranking_csv),
    }  # fmt: skip
    return json.dumps(content)


def _found(results: StudyResults, ranking: Ranking, manifest: Manifest) -> dict[str, Any]:
    race = results.race
    return {
        "study": manifest.study.get("name", ""),
        "study_hash": manifest.study_hash,
        "designs": len(results.designs),
        "scenarios": len(results.scenarios),
        "failed_designs": len(results.failed),
        "winner": None if ranking.winner is None else _design(ranking, ranking.winner),
        "set_of_best": [ranking.designs[i].id for i in range(len(ranking)) if ranking.set_of_best[i]],
        "race": race and {"dropped": len(race.dropped), "runs": race.runs, "full_runs": race.full_runs},
    }


def _design(ranking: Ranking, i: int) -> dict[str, Any]:
    design = ranking.designs[i]
    figures = {
        "S_m_s": ranking.S[i],
        "S_low_m_s": ranking.S_low[i],
        "S_high_m_s": ranking.S_high[i],
        "S_fresh_m_s": ranking.fresh_S[i],
    }
    return {
        "design": design.id,
        "law": design.law,
        "y_s_m": design.y_s,
        "gains": dict(design.gains),
        **{name: _number(value) for name, value in figures.items()},
    }


def _number(value: float) -> float | None:
    """JSON has no word for what is not a number."""
    return float(value) if math.isfinite(value) else None
