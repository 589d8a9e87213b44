"""Figures of robustness: ranks over plants, and margins over speed. Plain functions of arrays that return a figure."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray
from studies.report.figures.scores import new_panel, wrap
from studies.report.look.style import PANEL, LineStyle, figure_settings

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_WARNING, _FAULT = "#8a5a00", "#a11212"


@dataclasses.dataclass(frozen=True)
class Line:
    """One design in a figure.

    Attributes
    ----------
    label : str
    style : LineStyle
    values : (k,)
        NaN where there is none.
    """

    label: str
    style: LineStyle
    values: FloatArray


def bump_figure(lines: Sequence[Line], plants: Sequence[str]) -> Figure:
    """Rank of every design on every plant, the best at the top.

    Parameters
    ----------
    lines : sequence of Line
        Ranks, one a plant; NaN where a design has none.
    plants : sequence of str
        The study's own first.

    Returns
    -------
    Figure
        Each line is named at its first and at its last rank.
    """
    with figure_settings():
        width, height = 3.9 + 0.5 * len(plants), 1.75 + 0.33 * max(len(lines), 3)
        figure, axes = new_panel(width, height)
        x = np.arange(len(plants))
        named: dict[tuple[float, float, str], list[str]] = {}  # designs of one rank share a place
        for line in lines:
            known = np.flatnonzero(np.isfinite(line.values))
            if not known.size:
                continue
            axes.plot(x, line.values, marker=line.style.marker, markersize=6, markeredgecolor="#ffffff",
                      markeredgewidth=0.7, **line.style.line())  # fmt: skip
            for at, shift, side in ((known[0], -0.25, "right"), (known[-1], 0.25, "left")):
                text = wrap(line.label, 30).replace("\n", " ") if side == "left" else _short(line.label)
                named.setdefault((at + shift, float(line.values[at]), side), []).append(text)
        for (at, rank, side), texts in named.items():
            axes.text(at, rank, "\n".join(texts), ha=side, va="center", fontsize=8.5, color="#222222", linespacing=1.0)
        most = max([1, *(int(np.nanmax(line.values)) for line in lines if np.isfinite(line.values).any())])
        axes.axvline(0.5, color="#767676", linewidth=0.8)
        axes.set_ylim(most + 0.6, 0.4)
        axes.set_xlim(-0.35, len(plants) - 0.65)
        axes.set_yticks([])
        axes.set_xticks(x, plants, rotation=40, ha="right", rotation_mode="anchor")
        axes.tick_params(axis="x", length=0, labelcolor="#222222")
        axes.spines["left"].set_visible(False)
        axes.grid(visible=False, axis="y")
        axes.set_title("Rank by mean S, first at the top")
        return figure


def _short(label: str) -> str:
    return wrap(label, 22).partition("\n")[0]


@dataclasses.dataclass(frozen=True)
class Scale:
    """The axis of a margin.

    Attributes
    ----------
    title, ylabel : str
    warning, fault : float
        Where findings of the review start.
    top : float
        End of the axis; larger margins run along it.
    """

    title: str
    ylabel: str
    warning: float
    fault: float
    top: float


def margin_figure(lines: Sequence[Line], v: FloatArray, stable: npt.NDArray[np.bool_], scale: Scale) -> Figure:
    """One margin over speed, with the review's thresholds.

    Parameters
    ----------
    lines : sequence of Line
        d of them; NaN where the loop is unstable.
    v : (k,) [m/s]
    stable : (d, k) bool
        A cross on the axis marks what is not.
    scale : Scale

    Returns
    -------
    Figure
    """
    with figure_settings():
        rows = (len(lines) + 1) // 2
        figure, axes = new_panel(PANEL[0], PANEL[1] + 0.2 * rows)
        for value, word, color, dash, above in (
            (scale.warning, "warning", _WARNING, (5.0, 2.0), True),
            (scale.fault, "fault", _FAULT, (1.2, 1.2), False),
        ):
            axes.axhline(value, color=color, linewidth=1.0, linestyle=(0, dash), zorder=1)
            axes.annotate(word, (1.0, value), xycoords=("axes fraction", "data"), ha="right", fontsize=8, color=color,
                          xytext=(-2, 1.5 if above else -2), va="bottom" if above else "top",
                          textcoords="offset points")  # fmt: skip
        for line, holds in zip(lines, stable, strict=True):
            axes.plot(v, np.minimum(line.values, scale.top), label=wrap(line.label, 30), marker=line.style.marker,
                      markersize=4.5, clip_on=False, **line.style.line())  # fmt: skip
            if not holds.all():
                axes.plot(v[~holds], np.zeros(int((~holds).sum())), linestyle="none", marker="x", markersize=6,
                          markeredgewidth=1.6, color=line.style.color, clip_on=False, zorder=4)  # fmt: skip
        axes.set_ylim(0.0, scale.top)
        axes.set_xlabel("Speed [m/s]")
        axes.set_ylabel(scale.ylabel)
        axes.set_title(scale.title)
        figure.legend(loc="outside lower center", ncols=2)
        return figure
