"""``race.json``: which designs a race gave up, and when."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path

from ldctoolkit.errors import StoreError
from studies.design import Design
from studies.results import Dropped, Race
from studies.storage.files import write_text

FILE_NAME = "race.json"


def write_race(folder: Path, race: Race, ranked_as: str) -> None:
    """Write or replace the file; `ranked_as` tells which designs and settings it is the race of."""
    content = dataclasses.asdict(race) | {
        "ranked_as": ranked_as,
        "dropped": [
            {
                "design": one.design.id,
                "round": one.round,
                "scenarios": one.scenarios,
                "S_m_s": one.S,
                "difference_m_s": one.difference,
                "low_m_s": one.low,
            }
            for one in race.dropped
        ],
    }
    write_text(folder / FILE_NAME, json.dumps(content, indent=1) + "\n")


def read_race(folder: Path, designs: Sequence[Design], ranked_as: str) -> Race | None:
    """What a folder knows of its race; None where the file is missing, or that of other designs or settings.

    Raises
    ------
    StoreError
        If the file is broken.
    """
    path = folder / FILE_NAME
    by_id = {design.id: design for design in designs}
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["ranked_as"] != ranked_as:
            return None
        dropped = tuple(
            Dropped(
                design=by_id[one["design"]],
                round=int(one["round"]),
                scenarios=int(one["scenarios"]),
                S=float(one["S_m_s"]),
                difference=float(one["difference_m_s"]),
                low=float(one["low_m_s"]),
            )
            for one in content["dropped"]
            if one["design"] in by_id
        )
        return Race(
            rounds=tuple(map(int, content["rounds"])),
            alive=tuple(map(int, content["alive"])),
            dropped=dropped,
            runs=int(content["runs"]),
            full_runs=int(content["full_runs"]),
        )
    except FileNotFoundError:
        return None
    except OSError as error:
        raise StoreError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise StoreError(f"{path}: broken; run the study into this folder again to make it anew") from None
