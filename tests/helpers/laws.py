"""What most laws of tests have in common: they look at no lane ahead and keep no state."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from ldctoolkit import Controller, SteeringLaw, register, registry


class Unsighted(SteeringLaw):
    """A law that is stepped without a preview; its state is None unless it is made otherwise."""

    @property
    def preview_times(self) -> Any:
        return np.zeros(0)

    def init(self, n: int) -> Any:
        return None


@contextmanager
def known(*laws: type[Controller]) -> Iterator[None]:
    """Laws that have a name for a while."""
    for law in laws:
        register(law)
    try:
        yield
    finally:
        for law in laws:
            registry.forget(law.name)
