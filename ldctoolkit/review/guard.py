"""Calls of a law's own code: whatever it raises ends in one message that names the law, the call and its line."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from ldctoolkit.errors import LdcError
from ldctoolkit.law_errors import raised


@contextlib.contextmanager
def guarded(name: str, call: str) -> Iterator[None]:
    """Turn what a law raises into an `LdcError`; errors of the toolkit pass as they are.

    Parameters
    ----------
    name : str
        The controller.
    call : str
        What is called of it.

    Raises
    ------
    LdcError
        Also where the law would end the process.

    Examples
    --------
    >>> with guarded("my_law", "step"):  # doctest: +ELLIPSIS
    ...     [][0]
    Traceback (most recent call last):
    ...
    ldctoolkit.errors.LdcError: controller 'my_law': step raised IndexError: list index out of range...
    """
    try:
        yield
    except (LdcError, KeyboardInterrupt, GeneratorExit):
        raise
    except BaseException as error:  # a controller may be anybody's code, and may call sys.exit
        raise LdcError(f"controller {name!r}: {call} raised {raised(error)}") from error
