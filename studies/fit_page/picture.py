"""One picture that sums a fit up, for slides and for a glance."""

from __future__ import annotations

import io
import warnings
from typing import TYPE_CHECKING

from studies.fit_page.content import Side
from studies.fit_page.figures import draw_marginal, draw_strips
from studies.fit_page.figures_pairs import draw_density
from studies.fit_page.style import COLORS, axis_label
from studies.report.look.style import figure_settings

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_DPI = 110


def picture_figure(sides: tuple[Side, Side]) -> Figure:
    """Margins of both sides, T against d_y, and the mass next to bounds."""
    from matplotlib.figure import Figure

    columns = max(4, *(len(side.found.names) for side in sides)) // 2 + 1
    with figure_settings():
        figure = Figure(figsize=(3.0 * columns, 9.6), layout="constrained")
        halves = figure.subfigures(2, 1, squeeze=False)[:, 0]
        for part, side in zip(halves, sides, strict=True):
            found = side.found
            part.suptitle(
                f"{side.title}: {found.events:,} departures, K = {side.K}", color=COLORS[side.key], fontweight="bold"
            )
            grid = part.subplots(2, columns, squeeze=False)
            free = list(grid[:, :-1].ravel())
            for axes, one in zip(free, found.marginals, strict=False):
                draw_marginal(axes, one, side.key)
                axes.set_ylabel("Share per bin [%]")
            for axes in free[len(found.marginals) :]:
                axes.set_axis_off()
            free[0].legend(loc="upper right")
            top, bottom = grid[:, -1]
            if found.joint is None:
                top.set_axis_off()
            else:
                highest = float(max(found.joint.data.max(), found.joint.model.max()))
                draw_density(top, found.joint, found.joint.data, side.key, highest=highest, contours=True)
                top.set_xlabel(axis_label("T"))
                top.set_ylabel(axis_label("d_y"))
                top.set_title("Events, contours: model")
            if found.strips:
                draw_strips(bottom, found.strips, side.key)
                bottom.set_xlabel("Mass next to the bound, error [%]")
            else:
                bottom.set_axis_off()
        return figure


def picture(sides: tuple[Side, Side]) -> bytes:
    """`picture_figure` as a PNG; the same input gives the same bytes."""
    figure = picture_figure(sides)
    buffer = io.BytesIO()
    with figure_settings(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing", UserWarning)
        figure.savefig(buffer, format="png", dpi=_DPI, metadata={"Software": None})
    return buffer.getvalue()
