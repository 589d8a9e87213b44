"""What the winner's score is paid for with, in sentences: steering, comfort, needless interventions."""

from __future__ import annotations

import math
from typing import Final

from markupsafe import Markup

from ldctoolkit.vehicle.parameters import GRAVITY
from studies.report.context import Context
from studies.report.words.text import compact, number, percent, symbols

_GRIP: Final = 0.9
"""Of the acceleration of gravity: what tyres give on a good road."""


def cost(context: Context) -> Markup:
    """One sentence; empty for a design that never took over.

    Parameters
    ----------
    context : Context
    """
    figures, best, table = context.ranking.release, context.primary.best, context.primary
    comfortable = float(figures.comfortable[best.place])
    if math.isnan(comfortable):
        return Markup("")
    said = symbols(
        f"What it costs{' where designs were chosen' if best.fresh else ''}: peak a_y up to "
        f"{number(float(figures.a_y_peak_max[best.place]), 1)}\u00a0m/s\u00b2, steering rate up to "
        f"{number(math.degrees(float(figures.delta_rate_peak_max[best.place])), 1)}\u00a0\u00b0/s, "
        f"{percent(comfortable)} of interventions within the comfort limits of ISO 11270, and needless interventions "
        f"in {percent(float(figures.needless[best.place]))} of all departures (not deeper than "
        f"{compact(table.D_y)}\u00a0m without control)."
    )
    return said + Markup(" <a href='#limits'>What a release asks for</a>.")


def beyond_grip(context: Context) -> Markup:
    """A warning where tyres that never saturate gave more than tyres can; else empty.

    Parameters
    ----------
    context : Context
    """
    largest = float(context.ranking.release.a_y_peak_max[context.primary.best.place])
    if not (context.report.setup.options.tyres.ideal and largest > _GRIP * GRAVITY):
        return Markup("")
    shown = number(largest, 1)
    return symbols(
        f"A peak a_y of {shown}\u00a0m/s\u00b2 is not to be had on a road: the plant\u2019s tyres do not saturate."
    )
