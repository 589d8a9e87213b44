"""What an error holds, whatever its sentence."""

from typing import Any

from ldctoolkit.errors import NOT_GIVEN, LdcError


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
