"""What an error holds, whatever its sentence."""

import contextlib
from collections.abc import Iterator
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


@contextlib.contextmanager
def refused(path: str, kind: type[LdcError] = InputError, **fields: Any) -> Iterator[None]:
    """The block raises this kind of error, with this path, and with these fields where they are given."""
    with pytest.raises(kind) as caught:
        yield
    found = {"path": caught.value.path} | {name: getattr(caught.value, name) for name in fields}
    assert found == {"path": path} | fields
