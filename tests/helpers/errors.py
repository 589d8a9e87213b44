"""Errors by their fields, not by their wording."""

import contextlib
from collections.abc import Iterator
from typing import Any

import pytest

from ldctoolkit.errors import InputError, LdcError


@contextlib.contextmanager
def refused(path: str, kind: type[LdcError] = InputError, **fields: Any) -> Iterator[None]:
    """The block raises this kind of error, with this path, and with these fields where they are given."""
    with pytest.raises(kind) as caught:
        yield
    assert {"path": caught.value.path} | {name: getattr(caught.value, name) for name in fields} == {
        "path": path,
        **fields,
    }
