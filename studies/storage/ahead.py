"""Work that other threads do while its results are taken in, one after the other and in order."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def ahead(
    function: Callable[[Item], Result], items: Iterable[Item], *, threads: int = 1
) -> Iterator[tuple[Item, Future[Result]]]:
    """Call a function on each item in threads; at most one result more than there are threads waits.

    Parameters
    ----------
    function : callable
        What it raises is raised by the future.
    items : iterable
    threads : int

    Yields
    ------
    item
    future

    Examples
    --------
    >>> [(item, future.result()) for item, future in ahead(abs, [-1, 2])]
    [(-1, 1), (2, 2)]
    """
    with ThreadPoolExecutor(threads) as pool:
        waiting: deque[tuple[Item, Future[Result]]] = deque()
        for item in items:
            waiting.append((item, pool.submit(function, item)))
            if len(waiting) > threads:
                yield waiting.popleft()
        yield from waiting
