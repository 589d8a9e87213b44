"""What an error holds, whatever its sentence."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from ldctoolkit.errors import NOT_GIVEN, InputError, LdcError


def assert_fields(error: LdcError, path: str, value: Any = ..., allowed: str | set[str] = "") -> None:
    """The place, the value (`...` for none) and what is allowed: a phrase, or some of the names; empty for anything."""
    assert error.path == path
    if value is ...:
        assert error.value is NOT_GIVEN
    else:
        assert repr(error.value) == repr(value)  # NaN too, and True is not 1
    if isinstance(allowed, set):
        assert not isinstance(error.allowed, str)
        assert allowed <= {*error.allowed}
    elif allowed:
        assert error.allowed == allowed


@contextmanager
def refused(
    path: str, value: Any = ..., allowed: str | set[str] = "", kind: type[LdcError] = InputError
) -> Iterator[None]:
    """What is done within raises an error with these fields."""
    with pytest.raises(kind) as caught:
        yield
    assert_fields(caught.value, path, value, allowed)
