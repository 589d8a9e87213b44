"""What was found in a part of a source, as bytes: arrays in NumPy's own format, the rest as JSON beside them."""

from __future__ import annotations

import dataclasses
import io
import json
from typing import Any, Final

import numpy as np

from ldctoolkit.departure_columns import ExtraColumn
from ldctoolkit.departures import Departures
from ldctoolkit.errors import StoreError, plain
from ldctoolkit.recordings.account import Account, Origin
from ldctoolkit.recordings.drawn import Drawn, DrawnEvent
from ldctoolkit.recordings.evidence import Evidence
from ldctoolkit.recordings.part_result import PartResult
from ldctoolkit.recordings.recording import Label, Problem

_CLASSES: Final[dict[str, Any]] = {
    kind.__name__: kind
    for kind in (
        PartResult, Departures, ExtraColumn, Account, Origin, Label, Evidence, Drawn, DrawnEvent, Problem,
    )
}  # fmt: skip
"""Everything that a result is made of."""

_TREE: Final = "tree"
"""Entry that holds the JSON."""


def part_bytes(result: PartResult) -> bytes:
    """A result as the content of a file.

    Parameters
    ----------
    result : PartResult
        Of one part.

    Returns
    -------
    bytes
        The same for the same result; `read_part` gives it back bit for bit.

    Examples
    --------
    >>> read_part(part_bytes(PartResult())).departures.n
    0
    """
    arrays: list[np.ndarray[Any, Any]] = []
    text = json.dumps(_packed(result, arrays), ensure_ascii=False)
    content = io.BytesIO()
    entries = {str(i): array for i, array in enumerate(arrays)}
    np.savez(content, allow_pickle=False, **{_TREE: np.frombuffer(text.encode(), dtype=np.uint8)}, **entries)
    return content.getvalue()


def read_part(content: bytes) -> PartResult:
    """The result that `part_bytes` made the content of.

    Raises
    ------
    StoreError
        If it is anything else.
    """
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as entries:
            tree = json.loads(entries[_TREE].tobytes().decode())
            result = _unpacked(tree, entries)
    except Exception as error:  # any byte of it may be another
        raise StoreError(f"broken: {error or type(error).__name__}") from None
    if not isinstance(result, PartResult):
        raise StoreError(f"broken: holds {type(result).__name__}")
    return result


def _packed(value: Any, arrays: list[np.ndarray[Any, Any]]) -> Any:
    """A tree of what JSON knows; arrays are put aside and named by their place."""
    if isinstance(value, np.ndarray):
        arrays.append(value)
        return {"array": len(arrays) - 1}
    if dataclasses.is_dataclass(value) and type(value).__name__ in _CLASSES:
        fields = {field.name: _packed(getattr(value, field.name), arrays) for field in dataclasses.fields(value)}
        return {"class": type(value).__name__, "fields": fields}
    if isinstance(value, tuple):
        return [_packed(item, arrays) for item in value]
    return plain(value)


def _unpacked(value: Any, arrays: Any) -> Any:
    if isinstance(value, list):
        return tuple(_unpacked(item, arrays) for item in value)
    if not isinstance(value, dict):
        return value
    if "array" in value:
        return arrays[str(value["array"])]
    return _CLASSES[value["class"]](**{name: _unpacked(item, arrays) for name, item in value["fields"].items()})
