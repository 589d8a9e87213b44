"""``timing.json``: how long the laws took, apart from the results, because no second run gives the same times."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ldctoolkit.errors import StoreError
from studies.results import RunKey
from studies.storage.files import write_text

FILE_NAME = "timing.json"


@dataclasses.dataclass(frozen=True)
class LawTime:
    """Wall time inside a law's own steps.

    Attributes
    ----------
    seconds : float [s]
        Of all steps of one run.
    commands : int
        Scenarios times samples that they gave a command for.
    """

    seconds: float
    commands: int

    @property
    def per_command(self) -> float:
        """Mean wall time per command [s]; 0 where nobody was steered."""
        return self.seconds / self.commands if self.commands else 0.0

    def __add__(self, other: LawTime) -> LawTime:
        """Of two parts of a run together."""
        return LawTime(self.seconds + other.seconds, self.commands + other.commands)


def read_times(folder: Path) -> dict[RunKey, LawTime]:
    """Times of the laws, of the runs for which they are known; none where the file is missing.

    Raises
    ------
    StoreError
        If the file is broken.
    """
    path = folder / FILE_NAME
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
    write_text(folder / FILE_NAME, json.dumps({"designs": designs}, indent=1) + "\n")
