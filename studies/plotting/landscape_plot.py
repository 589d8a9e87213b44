"""Plot of mean S over what a law's designs were swept over."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ldctoolkit import controller_class
from ldctoolkit.errors import InputError, nearest
from studies.plotting.given_axes import axes_of, point_style, styles_of
from studies.report.figures.landscape import swept_axes, values_of
from studies.report.words.text import compact

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from studies.ranking.ranking import Ranking


def plot_landscape(
    ranking: Ranking, law: str | None = None, x: str = "y_s", y: str | None = None, ax: Axes | None = None
) -> Axes:
    """Least mean S over one or two swept quantities of a law, at the best of all the others.

    Parameters
    ----------
    ranking : Ranking
    law : str, optional
        Registry name; by default that of the winner, or of the first design.
    x : str
        ``"y_s"`` or a gain that the designs of the law differ in.
    y : str, optional
        A second one, for a heat map; a line over `x` without it.
    ax : Axes, optional
        To draw on; those of a new figure by default.

    Returns
    -------
    Axes
        S in m s. The law's best design of those drawn has a star; cells without a design are empty.

    Raises
    ------
    InputError
        For a law without designs, or a quantity that is not swept.

    Examples
    --------
    >>> import tempfile
    >>> import matplotlib
    >>> matplotlib.use("agg")
    >>> from studies import Study, rank_study, run_study
    >>> design = {"law": "lqr", "y_s": [0.05, 0.1], "gains": {"r_delta": [30.0, 300.0]}}
    >>> study = Study.from_dict({"name": "a", "scenarios": {"left": 20, "right": 20}, "design": [design]})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     results = run_study(study, directory=folder, workers=1)
    >>> ax = plot_landscape(rank_study(results, study)[0], y="r_delta")
    >>> ax.get_xlabel(), ax.get_ylabel()
    ('y_s [m]', 'r_delta [1/rad²]')
    """
    laws = list(dict.fromkeys(design.law for design in ranking.designs))
    if law is None:
        law = ranking.designs[ranking.winner or 0].law
    if law not in laws:
        raise InputError(f"law: {law!r} has no designs here; {nearest(law, laws)}")
    places = [i for i, design in enumerate(ranking.designs) if design.law == law]
    swept = {axis.name: axis for axis in swept_axes([ranking.designs[i] for i in places])}
    for name, wanted in (("x", x), ("y", y)):
        if wanted is not None and wanted not in swept:
            allowed = nearest(wanted, swept) if swept else "its designs differ in nothing"
            raise InputError(f"{name}: {wanted!r} is not swept in {law}; {allowed}")
    across, up = swept[x], None if y is None else swept[y]
    S = np.full((1 if up is None else len(up.values), len(across.values)), np.nan)
    for i in places:
        values = values_of(ranking.designs[i])
        cell = (0 if up is None else up.values.index(values[up.name]), across.values.index(values[across.name]))
        S[cell] = np.fmin(S[cell], ranking.S[i])
    row, column = np.unravel_index(int(np.nanargmin(S)), S.shape)
    axes = axes_of(ax)
    labels = [compact(value) for value in across.values]
    if up is None:
        style = styles_of(ranking.designs)[law]
        axes.plot(range(len(labels)), S[0], **(point_style(style) | style.line()))
        axes.axhline(float(ranking.S_uncorrected[places[0]]), color="#767676", linewidth=1.0, linestyle="--")
        axes.plot(column, S[0, column], marker="*", markersize=13, color="#ffffff", markeredgecolor="#000000")
        axes.set_ylabel("Mean S [m·s]")
    else:
        mesh = axes.pcolormesh(np.arange(len(labels) + 1) - 0.5, np.arange(len(up.values) + 1) - 0.5, S, cmap="viridis")
        axes.plot(column, row, marker="*", markersize=13, color="#ffffff", markeredgecolor="#000000")
        axes.set_yticks(range(len(up.values)), [compact(value) for value in up.values], parse_math=False)
        axes.set_ylabel(up.label, parse_math=False)
        axes.figure.colorbar(mesh, ax=axes, label="Mean S [m·s]")
    axes.set_xticks(range(len(labels)), labels, parse_math=False)
    axes.set_xlabel(across.label, parse_math=False)
    axes.set_title(controller_class(law).title, parse_math=False)
    return axes
