"""The small tables of a study's folder: designs, failures, times of the laws, and the log of a race."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ldctoolkit.errors import StoreError
from studies.design import Design
from studies.results import Dropped, Race, RunKey
from studies.storage.files import read_parquet, write_parquet, write_text

DESIGNS = "designs.parquet"


def _schema() -> dict[str, Any]:
    import polars as pl

    return {
        "design": pl.String(),
        "law": pl.String(),
        "y_s_m": pl.Float64(),
        "gains": pl.String(),
        "label": pl.String(),
    }


def write_designs(folder: Path, designs: Sequence[Design]) -> None:
    """Write or replace the table: identifier, law, y_s, all gains as JSON, and a label for people."""
    import polars as pl

    rows = [(d.id, d.law, d.y_s, json.dumps(dict(d.gains)), d.label) for d in designs]
    write_parquet(folder / DESIGNS, pl.DataFrame(rows, schema=_schema(), orient="row"))


def read_designs(path: Path) -> tuple[Design, ...]:
    """The designs of a table, in its order."""
    table = read_parquet(path, _schema())
    try:
        designs = tuple(
            Design(law, y_s, tuple(json.loads(gains).items())) for _, law, y_s, gains, _ in table.iter_rows()
        )
        wrong = [d.id for d, told in zip(designs, table["design"], strict=True) if d.id != told]
    except (ValueError, AttributeError) as error:
        raise StoreError(f"{path}: broken: {error}") from None
    if wrong:
        raise StoreError(f"{path}: broken: design {wrong[0]} is not what its row says")
    return designs


FAILURES = "failures.json"


def read_failures(folder: Path) -> dict[RunKey, str]:
    """Why runs failed, of those that did; none where the file is missing."""
    path = folder / FAILURES
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        found = {
            (design, convention): sentence
            for design, sentences in content["designs"].items()
            for convention, sentence in sentences.items()
        }
        if not all(isinstance(sentence, str) for sentence in found.values()):
            raise TypeError(found)
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise StoreError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise StoreError(f"{path}: broken; it holds which designs failed, and why") from None
    return found


def write_failures(folder: Path, failures: Mapping[RunKey, str]) -> None:
    """Write or replace the failures of a folder, sorted by design and convention; no file where there are none."""
    path = folder / FAILURES
    designs: dict[str, dict[str, str]] = {}
    for (design, convention), sentence in sorted(failures.items()):
        designs.setdefault(design, {})[convention] = sentence
    if designs:
        write_text(path, json.dumps({"designs": designs}, indent=1) + "\n")
    else:
        path.unlink(missing_ok=True)


TIMING_FILE = "timing.json"


@dataclasses.dataclass(frozen=True)
class LawTime:
    """Wall time inside a law's own steps."""

    seconds: float  # [s]: of all steps of one run
    commands: int  # scenarios times samples that they gave a command for

    @property
    def per_command(self) -> float:
        """Mean wall time per command [s]; 0 where nobody was steered."""
        return self.seconds / self.commands if self.commands else 0.0

    def __add__(self, other: LawTime) -> LawTime:
        """Of two parts of a run together."""
        return LawTime(self.seconds + other.seconds, self.commands + other.commands)


def read_times(folder: Path) -> dict[RunKey, LawTime]:
    """Times of the laws, of the runs for which they are known; none where the file is missing."""
    path = folder / TIMING_FILE
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        return {
            (design, convention): _law_time(entry)
            for design, entries in content["designs"].items()
            for convention, entry in entries.items()
        }
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise StoreError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise StoreError(
            f"{path}: broken; it holds how long the laws took and nothing else: remove it to go on without"
        ) from None


def _law_time(entry: Any) -> LawTime:
    time = LawTime(float(entry["law_seconds"]), int(entry["commands"]))
    if not (math.isfinite(time.seconds) and time.seconds >= 0 and time.commands >= 0):
        raise ValueError(entry)
    return time


def write_times(folder: Path, times: Mapping[RunKey, LawTime]) -> None:
    """Write or replace the times of a folder, sorted by design and convention."""
    designs: dict[str, dict[str, Any]] = {}
    for (design, convention), time in sorted(times.items()):
        designs.setdefault(design, {})[convention] = {
            "law_seconds": time.seconds,
            "commands": time.commands,
            "law_time_us": 1e6 * time.per_command,
        }
    write_text(folder / TIMING_FILE, json.dumps({"designs": designs}, indent=1) + "\n")


RACE_FILE = "race.json"


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
    write_text(folder / RACE_FILE, json.dumps(content, indent=1) + "\n")


def read_race(folder: Path, designs: Sequence[Design], ranked_as: str) -> Race | None:
    """What a folder knows of its race; None where the file is missing, or that of other designs or settings."""
    path = folder / RACE_FILE
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
