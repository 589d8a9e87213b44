"""Hands results on in the order of a design's pieces, so that what is stored of a design that fails is no accident."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Iterable, Iterator

from studies.results import RunKey, TaskResult


class InOrder:
    """Holds results back until those of all earlier pieces of the same design are there.

    Of a design that fails on a piece, exactly the pieces before it are handed on, whatever ran at the same time.
    """

    def __init__(self) -> None:
        self._wanted: dict[RunKey, deque[int]] = defaultdict(deque)
        self._early: dict[RunKey, dict[int, TaskResult]] = {}

    def expect(self, keys: Iterable[RunKey], piece: int) -> None:
        """A piece of some designs will come, after those that were announced before."""
        for key in keys:
            self._wanted[key].append(piece)

    def take(self, piece: int, result: TaskResult) -> Iterator[TaskResult]:
        """Results that can be handed on, now that these are there."""
        now = [i for i, key in enumerate(result.keys) if self._wanted[key] and self._wanted[key][0] == piece]
        ready = set(now)
        for i, key in enumerate(result.keys):
            if i not in ready:
                self._early.setdefault(key, {})[piece] = result.take([i])
        if not now:
            return
        yield result if len(now) == len(result.keys) else result.take(now)
        for i in now:
            key = result.keys[i]
            wanted, early = self._wanted[key], self._early.get(key, {})
            wanted.popleft()
            while wanted and wanted[0] in early:
                yield early.pop(wanted.popleft())
