"""Axes to draw on: those that were given, or new ones."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ldctoolkit.errors import InputError, nearest
from studies.report.look.style import LineStyle, law_styles

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from studies.design import Design
    from studies.results import CaseResults, StudyResults


def axes_of(ax: Axes | None) -> Axes:
    """The given axes, or those of a new figure of pyplot, which a notebook shows by itself."""
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt

    new: Axes = plt.subplots(layout="constrained")[1]
    return new


def plain_legend(axes: Axes) -> None:
    """A legend whose words are no formulas: a user's title may hold a dollar sign."""
    for text in axes.legend().get_texts():
        text.set_parse_math(False)


def point_style(style: LineStyle) -> dict[str, Any]:
    """Keyword arguments of ``Axes.plot`` for points of a law."""
    return {"color": style.color, "marker": "X" if style.marker == "|" else style.marker, "linestyle": "none"}


def styles_of(designs: Iterable[Design]) -> dict[str, LineStyle]:
    """One style a law, the law of the first design first: with those of a ranking as the report has them."""
    return law_styles(design.law for design in designs)


def curve_styles(results: StudyResults, case: CaseResults, chosen: Sequence[int]) -> list[LineStyle]:
    """A style for each curve: that of the law, or, where two are of one law, one of its own.

    Laws stand in the order of their least mean S, as in a ranking without requirements.
    """
    laws = [results.designs[i].law for i in chosen]
    if len(set(laws)) < len(laws):
        return list(law_styles(map(str, range(len(laws)))).values())
    mean = np.array([np.mean(S) for S in case.counted])
    styles = styles_of(results.designs[i] for i in np.argsort(mean, kind="stable").tolist())
    return [styles[law] for law in laws]


def chosen_case(results: StudyResults, case: str | int) -> CaseResults:
    """A case by its position or its label.

    Raises
    ------
    InputError
        If there is none.
    """
    labels = [one.case.label for one in results.cases]
    if isinstance(case, str):
        if case not in labels:
            raise InputError(f"case: {case!r}; {nearest(case, labels)}")
        return results.cases[labels.index(case)]
    if not 0 <= case < len(labels):
        raise InputError(f"case: {case}; allowed: 0 to {len(labels) - 1}")
    return results.cases[case]


def chosen_designs(results: StudyResults, designs: Iterable[Design | int]) -> list[int]:
    """Positions of designs in the results.

    Raises
    ------
    InputError
        For a design that has no results, or a position that does not exist.
    """
    place = {design.id: i for i, design in enumerate(results.designs)}
    found = []
    for one in designs:
        if isinstance(one, int):
            if not 0 <= one < len(place):
                raise InputError(f"designs: {one}; allowed: 0 to {len(place) - 1}")
            found.append(one)
        elif one.id in place:
            found.append(place[one.id])
        else:
            raise InputError(
                f"designs: {one.label} has no results here; allowed: the {len(place)} designs of the study"
            )
    if not found:
        raise InputError("designs: none; allowed: at least one")
    return found
