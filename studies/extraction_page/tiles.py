"""What stands at the top of the page: one line, and large numbers."""

from __future__ import annotations

import numpy as np

from ldctoolkit.departures import LEFT
from ldctoolkit.recordings import Extraction
from studies.extraction_page.amounts import hours, rate
from studies.extraction_page.counts import SIDES, Row, reason_title
from studies.report.section import Tile
from studies.report.words.text import percent, plural


def side_counts(extraction: Extraction) -> tuple[int, int]:
    """Departures left and right."""
    left = int(np.sum(extraction.departures.side == LEFT))
    return left, extraction.departures.n - left


def summary(extraction: Extraction, whole: Row | None, sources: int) -> list[str]:
    """Parts of the line under the heading."""
    left, right = side_counts(extraction)
    return [
        f"{plural(left + right, 'departure')}: {left:,} left, {right:,} right",
        f"{plural(extraction.recordings, 'recording')} of {plural(sources, 'source')}",
        f"{hours(whole.account.hours_valid if whole else 0.0)} h valid",
        f"format {extraction.provenance.reader}",
    ]


def tiles(extraction: Extraction, whole: Row | None) -> list[Tile]:
    """Departures, how often, hours, refusals, faults."""
    left, right = side_counts(extraction)
    out = [Tile(f"{left + right:,}", "", "departures", f"{left:,} left, {right:,} right")]
    if whole is not None:
        rates = whole.rates
        said = ", ".join(f"{rate(one)} {side}" for one, side in zip(rates, SIDES, strict=True))
        out.append(Tile(rate(sum(rates)), "1/h", "departures in a valid hour", said))
        account = whole.account
        share = f"{percent(whole.valid_share, 0)} of {hours(account.hours_read)} h read"
        out.append(Tile(hours(account.hours_valid), "h", "valid", share))
        out.append(_refused(whole))
    faults = len(extraction.problems)
    said = plural(len(extraction.warnings), "warning")
    out.append(Tile(f"{faults:,}", "", "problem with the files" if faults == 1 else "problems with the files", said))
    return out


def _refused(whole: Row) -> Tile:
    refused, candidates = sum(whole.refused), int(whole.account.candidates.sum())
    reasons = {reason: count + whole.refusals(1)[reason] for reason, count in whole.refusals(0).items()}
    most = max(reasons, key=lambda reason: reasons[reason])
    share = percent(refused / candidates, 0) if candidates else ""
    detail = f"{share}; most often: {reason_title(most)}" if refused else f"of {plural(candidates, 'candidate')}"
    return Tile(f"{refused:,}", "", "candidates refused", detail)
