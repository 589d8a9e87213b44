"""The best designs again, on scenarios that no design was chosen on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from studies.design import FOLLOWS_CASE, Design
from studies.ranking.ranking import Ranking
from studies.study_file.spec import Study

_STREAM: Final = 0x66696E61
"""Keeps the finalists' scenarios apart from those that they were chosen on."""

_LEAST: Final = 3
"""Finalists, where there are so many designs: a single one would show its own optimism, and nothing of its rivals."""


def finalists(ranking: Ranking, most: int) -> tuple[Design, ...]:
    """The designs in the set of best, best first; at least three and at most `most`; none where nothing is ranked."""
    best = [i for i in range(len(ranking)) if ranking.set_of_best[i]]
    others = [i for i in range(len(ranking)) if not ranking.set_of_best[i] and ranking.rank[i] > 0]
    chosen = (best + others[: max(0, _LEAST - len(best))])[:most]
    return tuple(ranking.designs[i] for i in chosen)


def fresh_study(study: Study, designs: Sequence[Design]) -> Study:
    """The study of some designs on as many fresh scenarios."""
    content = study.content()
    seed = int(np.random.SeedSequence([study.seed, _STREAM]).generate_state(1, np.uint64)[0] >> 1)
    content |= {
        "name": "finalists",
        "title": f"Finalists of {study.title or study.name}",
        "seed": seed,
        "race": False,
        "search": None,
        "design": [_block(design) for design in designs],
    }
    content["ranking"] |= {"finalists": 0, "require": [], "baseline": ""}
    return Study.from_dict(content, folder=study.model_path.parent)


def _block(design: Design) -> dict[str, Any]:
    gains = {name: value for name, value in design.gains if value != FOLLOWS_CASE}
    return {"law": design.law, "y_s": design.y_s, "gains": gains}
