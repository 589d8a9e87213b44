"""Numbers for the page's script: text that holds arrays as they lie in memory, and nothing that ends a script."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.errors import InputError

TYPES: Final = ("f4", "i4", "i2", "u2", "i1", "u1")
"""What `packed` may make; little-endian. The script knows the same ones."""


def packed(values: npt.ArrayLike, kind: str = "f4") -> dict[str, str]:
    """An array as the script reads it with ``LDC.numbers``: flattened, row by row.

    Parameters
    ----------
    values : array_like
    kind : {"f4", "i4", "i2", "u2", "i1", "u1"}
        Float of 32 bits (7 digits; NaN and infinity stay what they are) or whole numbers of 8 to 32 bits.

    Returns
    -------
    dict
        ``{"type": kind, "data": base64}``.

    Raises
    ------
    InputError
        If a whole number does not fit, or the kind is unknown.

    Examples
    --------
    >>> packed([1, 2, 3], "u1")
    {'type': 'u1', 'data': 'AQID'}
    """
    if kind not in TYPES:
        raise InputError(f"packed: kind {kind!r}; allowed: {', '.join(TYPES)}")
    array = np.asarray(values)
    with np.errstate(over="ignore"):  # a float beyond 32 bits is shown as infinite
        small = array.astype(f"<{kind}")
    if kind != "f4" and not np.array_equal(small.astype(np.int64), array.astype(np.int64)):
        raise InputError(f"packed: values from {array.min()} to {array.max()} do not fit {kind}")
    return {"type": kind, "data": base64.b64encode(small.tobytes()).decode("ascii")}


def script_json(data: Mapping[str, Any]) -> str:
    r"""JSON that may stand inside a ``<script>`` element: no ``<`` in it, so nothing can end the element.

    Raises
    ------
    InputError
        For a float that is not finite: JSON has none.

    Examples
    --------
    >>> print(script_json({"title": "</script>"}))
    {"title":"\u003c/script>"}
    """
    try:
        text = json.dumps(data, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    except ValueError as error:
        raise InputError(f"report data: {error}") from None
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")
