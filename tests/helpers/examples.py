"""How many examples a property test tries: a quarter of them by default, all in the longer tier."""

import os
from typing import Any

from hypothesis import settings

LONG = os.environ.get("LDC_TESTS") == "long"


def load_profile() -> None:
    """Without a deadline, since an example's time depends on what else the machine does; the same examples each run."""
    settings.register_profile("ldc", deadline=None, derandomize=True, database=None, max_examples=100 if LONG else 25)
    settings.load_profile("ldc")


def examples(count: int, **more: Any) -> settings:
    """Settings of one test: `count` examples in the longer tier, a quarter of them otherwise."""
    return settings(max_examples=count if LONG else max(1, count // 4), **more)
