"""Puts the parts of a piece together that was cut to find a fault."""

from __future__ import annotations

import dataclasses

import numpy as np

from studies.results import RunKey, TaskResult
from studies.running.tasks import Task


class Merge:
    """Keeps results of parts of pieces until the rest is there."""

    def __init__(self) -> None:
        self._parts: dict[tuple[RunKey, int], list[TaskResult]] = {}

    def add(self, task: Task, result: TaskResult) -> TaskResult | None:
        """Take in results of one design on a part of a piece; the whole piece, once it is complete."""
        key = (result.keys[0], task.piece)
        parts = self._parts.setdefault(key, [])
        parts.append(result)
        if sum(part.rows.size for part in parts) < task.piece_size:
            return None
        del self._parts[key]
        return dataclasses.replace(
            parts[0],
            rows=np.concatenate([part.rows for part in parts]),
            values=np.concatenate([part.values for part in parts], axis=2),
            status=np.concatenate([part.status for part in parts], axis=1),
            failed_solves=np.concatenate([part.failed_solves for part in parts], axis=1),
            law_seconds=np.sum([part.law_seconds for part in parts], axis=0),
            commands=np.sum([part.commands for part in parts], axis=0),
        ).sorted_by_row()
