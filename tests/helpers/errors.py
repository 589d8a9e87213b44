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
def refused(path: str, kind: type[LdcError] = InputError, **fields: Any) -> Iterator[None]:
    """The block raises this kind of error, with this path, and with these fields where they are given: NaN equals NaN,
    a set is some of the names that are allowed, an empty phrase anything, and `...` stands for no value."""
    with pytest.raises(kind) as caught:
        yield
    for name, expected in {"path": path, **fields}.items():
        actual = getattr(caught.value, name)
        if expected is ...:
            assert actual is NOT_GIVEN
        elif isinstance(expected, set):
            assert expected <= {*actual}
        elif name != "allowed" or expected:
            assert repr(actual) == repr(expected) or (actual == expected and not isinstance(expected, bool))
