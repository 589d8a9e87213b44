"""What a run came to, as one JSON object a line, for scripts."""

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
    content: dict[str, Any] = {
        "event": "done",
        "study": manifest.study.get("name", ""),
        "study_hash": manifest.study_hash,
        "designs": len(results.designs),
        "scenarios": len(results.scenarios),
        "failed_designs": len(results.failed),
        "winner": None if ranking.winner is None else _design(ranking, ranking.winner),
        "set_of_best": [ranking.designs[i].id for i in range(len(ranking)) if ranking.set_of_best[i]],
        "race": None,
        "wall_time_s": round(manifest.wall_time_s, 3),
        "executor": manifest.executor,
        "workers": manifest.workers,
        "ranking": str(ranking_csv),
        "report": str(report),
    }
    if results.race is not None:
        race = results.race
        content["race"] = {"dropped": len(race.dropped), "runs": race.runs, "full_runs": race.full_runs}
    return json.dumps(content)


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
        # JSON has no word for what is not a number
        **{name: None if math.isnan(value) else float(value) for name, value in figures.items()},
    }
