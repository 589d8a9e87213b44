"""The same bits, and numbers of examples."""

import dataclasses
import os
from collections.abc import Mapping
from typing import Any

import numpy as np
from hypothesis import settings


def assert_same_bits(one: Any, other: Any, where: str = "value") -> None:
    """Fail, naming the place, unless both have the same types, shapes and bits: NaN equals NaN, 0.0 is not -0.0."""
    assert type(one) is type(other), f"{where}: {type(one).__name__} and {type(other).__name__}"
    if dataclasses.is_dataclass(one):
        for field in dataclasses.fields(one):
            assert_same_bits(getattr(one, field.name), getattr(other, field.name), f"{where}.{field.name}")
    elif isinstance(one, np.ndarray):
        assert (one.dtype, one.shape) == (other.dtype, other.shape), where
        if one.dtype == object:
            assert_same_bits(one.tolist(), other.tolist(), where)
        else:
            assert one.tobytes() == other.tobytes(), f"{where}: other bits"
    elif isinstance(one, float):
        assert np.float64(one).tobytes() == np.float64(other).tobytes(), f"{where}: {one!r} and {other!r}"
    elif isinstance(one, Mapping):
        assert list(one) == list(other), where
        for key in one:
            assert_same_bits(one[key], other[key], f"{where}[{key!r}]")
    elif isinstance(one, list | tuple):
        assert len(one) == len(other), where
        for i, (a, b) in enumerate(zip(one, other, strict=True)):
            assert_same_bits(a, b, f"{where}[{i}]")
    else:
        assert one == other, f"{where}: {one!r} and {other!r}"


LONG = os.environ.get("LDC_TESTS") == "long"


def load_profile() -> None:
    """Without a deadline, since an example's time depends on what else the machine does; the same examples each run."""
    settings.register_profile("ldc", deadline=None, derandomize=True, database=None, max_examples=100 if LONG else 25)
    settings.load_profile("ldc")


def examples(count: int, **more: Any) -> settings:
    """Settings of one test: `count` examples in the longer tier, a quarter of them otherwise."""
    return settings(max_examples=count if LONG else max(1, count // 4), **more)
