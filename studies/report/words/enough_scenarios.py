"""How many departures it takes to tell two designs apart, in sentences."""

from __future__ import annotations

import math

from markupsafe import Markup

from studies.report.figures.precision import two_digits
from studies.report.tables.rivals import Rival
from studies.report.words.prose import between_differences, design_text, rank_text
from studies.report.words.text import difference_text

_TOO_FEW, _TOO_MANY = 20, 10_000_000
"""Outside these a number would say more than is known: of few departures no spread is known."""


def enough_sentence(rival: Rival, first: str, n: int) -> Markup:
    """Whether a design is told from the first of the ranking, and how many departures that needs.

    Parameters
    ----------
    rival : Rival
    first : str
        What to call the first.
    n : int
        Departures of the study.

    Returns
    -------
    Markup
    """
    what = ", in the set of best" if rival.row.in_set else ""
    what += ", the best of another law" if rival.other_law else ""
    name = Markup("<b>{}</b> ({}{})").format(design_text(rival.row), rank_text(rival.row), what)
    if rival.same:
        return Markup("{} scores the same as {}: no number of departures tells them apart.").format(name, first)
    if not math.isfinite(rival.half_width):
        return Markup("{}: one departure of a side alone shows no spread, so there is no interval to {}.").format(
            name, first
        )
    size = difference_text(abs(rival.difference.value), 3).removeprefix("+")
    where = "above" if rival.difference.value > 0.0 else "below"
    seen = f"mean S is {size} m\u00b7s {where} that of {first}, difference {between_differences(rival.difference)}"
    even, likely = (_about(count) for count in (rival.needed.even, rival.needed.likely))
    if rival.apart:
        return Markup(
            "{}: {}. They are told apart. For a difference of this size {} departures are needed for an even chance of "
            "that, and {} for nine chances in ten."
        ).format(name, seen, even, likely)
    return Markup(
        "{}: {}. The {} departures of this study do not tell them apart. If the true difference is the one seen, {} "
        "would be needed for an even chance, and {} for nine chances in ten; if it is smaller, more, and if it is "
        "zero, no number will do."
    ).format(name, seen, f"{n:,}", even, likely)


def _about(count: float) -> str:
    if count < _TOO_FEW:
        return f"fewer than {_TOO_FEW}"
    return "more than ten million" if count > _TOO_MANY else f"about {two_digits(count):,}"
