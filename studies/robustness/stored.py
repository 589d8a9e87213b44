"""``robustness.json``: the numbers on other plants, so that a report reads them instead of driving again."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Any, Final

import numpy as np

from studies.robustness.robustness import Robustness, RobustnessTask, work_out
from studies.storage.files import write_text

NAME: Final = "robustness.json"

_WORDS: Final = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}
"""Numbers that JSON does not know."""

_KINDS: Final = {
    "rank": np.int64, "failures": np.int64, "diverged": np.int64, "rival": np.int64,
    "contends": np.bool_,
}  # fmt: skip
"""What is no array of float64."""

_NO_ARRAYS: Final = (
    "key", "designs", "slow", "unsafe", "more", "plants", "titles", "differences", "left_out", "left", "right",
    "raised",
)  # fmt: skip
"""Text, numbers, and tuples of them."""


def robustness_of(folder: Path, task: RobustnessTask) -> Robustness:
    """The numbers of a task: those in a study's folder if they are its own, else worked out and stored there."""
    found = stored_of(folder, task)
    if found is not None:
        return found
    made = work_out(task)
    write_text(folder / NAME, text_of(made))
    return made


def stored_of(folder: Path, task: RobustnessTask) -> Robustness | None:
    """The numbers of a task in a study's folder; None where there are none, or those of something else."""
    found = read(folder / NAME)
    return found if found is not None and found.key == task.key else None


def text_of(robustness: Robustness) -> str:
    """The numbers as JSON; every one of them comes back as it was."""
    return (
        json.dumps(_plain(dataclasses.asdict(robustness)), indent=None, separators=(",", ":"), allow_nan=False) + "\n"
    )


def read(path: Path) -> Robustness | None:
    """Read a file that was written from `text_of`; None where there is none, or it is of another kind.

    Parameters
    ----------
    path : Path
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        return Robustness(**_fields(content))
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return None  # it only saves time: what cannot be read is worked out again


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, dict):
        return {name: _plain(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value


def _fields(content: dict[str, Any]) -> dict[str, Any]:
    """Fields of a dataclass from JSON."""
    return {
        name: _tuples(value) if name in _NO_ARRAYS else np.array(_numbers(value), dtype=_KINDS.get(name, np.float64))
        for name, value in content.items()
    }


def _tuples(value: Any) -> Any:
    return tuple(_tuples(one) for one in value) if isinstance(value, list) else value


def _numbers(value: Any) -> Any:
    if isinstance(value, list):
        return [_numbers(one) for one in value]
    return _WORDS[value] if isinstance(value, str) else value
