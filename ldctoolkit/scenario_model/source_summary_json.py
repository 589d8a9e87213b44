"""The JSON form of what a file keeps of a side's departures."""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import Any

from ldctoolkit.departures import PARAMETER_NAMES
from ldctoolkit.errors import nearest
from ldctoolkit.scenario_model._reader import Reader, is_number, is_whole, short
from ldctoolkit.scenario_model.source_summary import UNIT, SourceSummary


def source_summary_to_json(summary: SourceSummary | None) -> dict[str, Any] | None:
    """JSON values; the cells of a pair are one string, a tenth of the size of a list."""
    if summary is None:
        return None
    return dataclasses.asdict(summary) | {"cells": [" ".join(map(str, row)) for row in summary.cells]}


def source_summary_from_json(reader: Reader, data: object, path: str) -> SourceSummary | None:
    """Check and build it; None where the file has none."""
    if data is None:
        return None
    if not isinstance(data, dict):
        raise reader.wrong(path, f"{short(data)}; allowed: an object or null")
    reader.only(data, path, [field.name for field in dataclasses.fields(SourceSummary)])
    names = tuple(reader.member(data, "names", path, list, "a list of parameter names"))
    for name in names:
        if name not in PARAMETER_NAMES:
            raise reader.wrong(f"{path}.names", f"{short(name)}; {nearest(str(name), PARAMETER_NAMES)}")
    if not names or len(set(names)) < len(names):
        raise reader.wrong(f"{path}.names", f"{short(list(names))}; allowed: each parameter once, at least one")
    d = len(names)
    rows = reader.member(data, "quantiles", path, list, f"{d} lists of numbers")
    m = len(rows[0]) if rows and isinstance(rows[0], list) else 0
    if m < 2:
        raise reader.wrong(f"{path}.quantiles", f"allowed: {d} lists of two or more numbers")
    quantiles = reader.array(data, "quantiles", path, (d, m)).tolist()
    for j, row in enumerate(quantiles):
        if any(a > b for a, b in itertools.pairwise(row)):
            raise reader.wrong(f"{path}.quantiles[{j}]", "not ascending")
    pairs = d * (d - 1) // 2
    correlations = reader.array(data, "rank_correlations", path, (pairs,)).tolist() if pairs else []
    for i, value in enumerate(correlations):
        if abs(value) > 1.0:
            raise reader.wrong(f"{path}.rank_correlations[{i}]", f"{value:g}; allowed: -1 to 1")
    departures, effective = (data.get(key) for key in ("departures", "effective"))
    if not is_whole(departures):
        raise reader.wrong(f"{path}.departures", f"{short(departures)}; allowed: an integer >= 0")
    if not (is_number(effective) and effective > 0):  # type: ignore[operator]
        raise reader.wrong(f"{path}.effective", f"{short(effective)}; allowed: a number above 0")
    return SourceSummary(
        names,
        departures,  # type: ignore[arg-type]
        float(effective),  # type: ignore[arg-type]
        tuple(map(tuple, quantiles)),
        tuple(correlations),
        _cells(reader, data, path, pairs),
    )


def _cells(reader: Reader, data: dict[str, Any], path: str, pairs: int) -> tuple[tuple[int, ...], ...]:
    allowed = f"a list of {pairs} strings, each of b x b shares in 1/{UNIT} that sum to {UNIT} at most"
    texts = reader.member(data, "cells", path, list, allowed)
    here = f"{path}.cells"
    if len(texts) != pairs:
        raise reader.wrong(here, f"{len(texts)} strings; allowed: {allowed}")
    out: list[tuple[int, ...]] = []
    for i, text in enumerate(texts):
        words = text.split() if isinstance(text, str) else ["?"]
        shares = tuple(int(word) for word in words if word.isascii() and word.isdigit() and len(word) <= len(str(UNIT)))
        b = math.isqrt(len(words))
        if len(shares) != len(words) or not b or b * b != len(words) or sum(shares) > UNIT:
            raise reader.wrong(f"{here}[{i}]", f"{short(text)}; allowed: {allowed}")
        if out and len(out[0]) != len(shares):
            raise reader.wrong(f"{here}[{i}]", f"{len(shares)} cells; allowed: {len(out[0])}, as in the first")
        out.append(shares)
    return tuple(out)
