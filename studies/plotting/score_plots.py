"""Plots of scores: empirical distributions, and means against the number of scenarios."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ldctoolkit.departures import LEFT, RIGHT
from ldctoolkit.errors import InputError, nearest
from studies.design import Design
from studies.plotting.given_axes import axes_of, chosen_case, chosen_designs, curve_styles, plain_legend
from studies.report.figures.scores import interleaved, plain_log, running_mean
from studies.report.look.style import RECORDED
from studies.report.words.text import shorten

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from studies.results import StudyResults

_SIDES = {"both": (LEFT, RIGHT), "left": (LEFT,), "right": (RIGHT,)}


def plot_distribution(
    results: StudyResults,
    designs: Iterable[Design | int] = (0,),
    ax: Axes | None = None,
    *,
    case: str | int = 0,
    side: str = "both",
) -> Axes:
    """Empirical distribution of S with and without control.

    Parameters
    ----------
    results : StudyResults
    designs : iterable of Design or int
        Designs of the study, or their positions in ``results.designs``.
    ax : Axes, optional
        To draw on; those of a new figure by default.
    case : str or int
        Label or position of the case.
    side : {"both", "left", "right"}

    Returns
    -------
    Axes
        S in m s, as it counts: a failed scenario at least as bad as without control.

    Raises
    ------
    InputError
        For a case, side or design that is not there.

    Examples
    --------
    >>> import tempfile
    >>> import matplotlib
    >>> matplotlib.use("agg")
    >>> from studies import Study, run_study
    >>> content = {"name": "a", "scenarios": {"left": 20, "right": 20}, "design": [{"law": "lqr", "y_s": [0.05, 0.1]}]}
    >>> study = Study.from_dict(content)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     results = run_study(study, directory=folder, workers=1)
    >>> len(plot_distribution(results, results.designs, side="left").lines)
    3
    """
    if side not in _SIDES:
        raise InputError(f"side: {side!r}; {nearest(side, _SIDES)}")
    results = results.drivable()
    found, chosen = chosen_case(results, case), chosen_designs(results, designs)
    rows = np.isin(results.scenarios.side, _SIDES[side])
    if not rows.any():
        raise InputError(f"side: {side!r}; the study has no such scenarios")
    axes = axes_of(ax)
    recorded = found.S_uncorrected[chosen[0]][rows]
    axes.ecdf(recorded, label="without control", **RECORDED.line())
    for i, style in zip(chosen, curve_styles(results, found, chosen), strict=True):
        label = shorten(results.designs[i].label, 60)
        axes.ecdf(found.counted[i][rows], label=label, **style.line())
    axes.set_xlim(0.0, max(float(np.quantile(recorded, 0.995)), 1e-3))
    axes.set_xlabel("Score S [m·s]")
    axes.set_ylabel("Share of departures with less")
    plain_legend(axes)
    return axes


def plot_convergence(
    results: StudyResults,
    designs: Sequence[Design | int] = (0,),
    ax: Axes | None = None,
    *,
    case: str | int = 0,
    to: Design | int | None = None,
) -> Axes:
    """Mean S over the first k scenarios with a band of 1.96 standard errors, left and right ones interleaved.

    Parameters
    ----------
    results : StudyResults
    designs : sequence of Design or int
        Designs of the study, or their positions in ``results.designs``.
    ax : Axes, optional
        To draw on; those of a new figure by default.
    case : str or int
        Label or position of the case.
    to : Design or int, optional
        Draw paired differences to this design.

    Returns
    -------
    Axes
        Bands are those of one curve by itself.

    Raises
    ------
    InputError
        For a case or design that is not there.

    Examples
    --------
    >>> import tempfile
    >>> import matplotlib
    >>> matplotlib.use("agg")
    >>> from studies import Study, run_study
    >>> content = {"name": "a", "scenarios": {"left": 20, "right": 20}, "design": [{"law": "lqr", "y_s": [0.05, 0.1]}]}
    >>> study = Study.from_dict(content)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     results = run_study(study, directory=folder, workers=1)
    >>> ax = plot_convergence(results, [1], to=0)
    >>> ax.get_ylabel()
    'Mean paired difference of S [m·s]'
    """
    results = results.drivable()
    found, chosen = chosen_case(results, case), chosen_designs(results, designs)
    reference: npt.NDArray[np.float64] | float = 0.0
    if to is not None:
        reference = found.counted[chosen_designs(results, [to])[0]]
    order = interleaved(results.scenarios.side)
    axes = axes_of(ax)
    for i, style in zip(chosen, curve_styles(results, found, chosen), strict=True):
        count, mean, error = running_mean((found.counted[i] - reference)[order])
        axes.fill_between(count, mean - error, mean + error, color=style.color, alpha=0.16, linewidth=0)
        axes.plot(count, mean, label=shorten(results.designs[i].label, 60), **style.line())
    plain_log(axes, order.size)
    axes.set_xlabel("Number of scenarios")
    axes.set_ylabel("Mean S [m·s]" if to is None else "Mean paired difference of S [m·s]")
    plain_legend(axes)
    return axes
