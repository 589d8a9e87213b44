"""Controller classes that other processes cannot find by their names, as bytes."""

from __future__ import annotations

import sys

import cloudpickle

from ldctoolkit import registry
from ldctoolkit.errors import LdcError


def laws_of_this_process() -> bytes:
    """The classes that `register` made known here, to be sent along with tasks; empty for none.

    Raises
    ------
    LdcError
        If they cannot be sent.
    """
    classes = registry.registered()
    if not classes:
        return b""
    modules = [sys.modules[module] for module in dict.fromkeys(kind.__module__ for kind in classes)]
    by_value = [module for module in modules if module.__name__ not in cloudpickle.list_registry_pickle_by_value()]
    for module in by_value:
        cloudpickle.register_pickle_by_value(module)
    try:
        return bytes(cloudpickle.dumps(classes))
    except Exception as error:  # a class may hold anything
        names = ", ".join(kind.__name__ for kind in classes)
        raise LdcError(
            f"registered controllers ({names}) cannot be sent to worker processes ({error}); use one worker"
        ) from None
    finally:
        for module in by_value:
            cloudpickle.unregister_pickle_by_value(module)
