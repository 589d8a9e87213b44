"""The page: figures and context for the template, rendered and written whole."""

from __future__ import annotations

import dataclasses
import io
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy.typing as npt
from markupsafe import Markup

from ldctoolkit.departures import PARAMETER_NAMES, Departures
from ldctoolkit.diagnostics import ModelDiagnostics, diagnose_model
from ldctoolkit.diagnostics.parts import strip_is_off
from ldctoolkit.scenario_model import ScenarioModel
from ldctoolkit.version import __version__
from studies.fit_page import content, figures
from studies.fit_page.content import Side
from studies.fit_page.figures import draw_density, draw_marginal, draw_strips
from studies.fit_page.style import COLORS, DASHES, MEANINGS, MODEL, UNITS, axis_label
from studies.report.look.style import figure_settings
from studies.report.look.svg import inline_svg, line_sample
from studies.report.rendering import asset, render
from studies.report.words import text
from studies.storage.files import stored_file, write_text
from studies.storage.stored_model import WARNING, model_notes

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


Progress = Callable[[str, int, int], None]

_PACKAGE = "studies.fit_page"

SECTIONS = (
    ("warnings", "Warnings"),
    ("margins", "Margins"),
    ("joint", "T and d_y"),
    ("calibration", "Calibration"),
    ("bounds", "Bounds"),
    ("transform", "Alternative"),
    ("components", "Components"),
    ("selection", "Choice of K"),
    ("pairs", "Pairs"),
    ("settings", "Settings"),
)
"""Identifiers of the sections, which stay the same from version to version, and their titles."""


@dataclasses.dataclass(frozen=True)
class Panel:
    """One figure and the sentence under it."""

    svg: Markup
    note: str = ""


class _Panels:
    """Makes panels with identifiers of their own."""

    def __init__(self) -> None:
        self._count = 0

    def __call__(self, figure: Figure, alt: str, note: str = "") -> Panel:
        self._count += 1
        return Panel(inline_svg(figure, f"f{self._count}", alt), note)


def _margins(panel: _Panels, side: content.Side) -> list[Panel]:
    out = []
    for one, calibration in zip(side.found.marginals, side.found.calibrations, strict=True):
        note = ""
        if max(one.data_beyond, one.model_beyond) > 0.01:
            note = (
                f"not shown: {text.percent(one.data_beyond)} of the events, {text.percent(one.model_beyond)} of the "
                "model"
            )
        alt = (
            f"{side.title}: histogram of {one.name}, {MEANINGS.get(one.name, '')}, events as bars and model as a line. "
            f"Kolmogorov distance {text.percent(calibration.distance, 2)}."
        )
        out.append(panel(figures.marginal_figure(one, side.key), alt, note))
    return out


def _joint(panel: _Panels, side: content.Side) -> list[Panel]:
    pair = side.found.joint
    if pair is None:
        return []
    alt = f"{side.title}: joint density of T and d_y, {{}}, with the model's contours of 50 % and 90 %."
    return [
        panel(figures.joint_figure(pair, side.key, of_model=of_model), alt.format("model" if of_model else "events"))
        for of_model in (False, True)
    ]


def _calibration(panel: _Panels, sides: tuple[content.Side, ...]) -> list[Panel]:
    out = []
    for name in PARAMETER_NAMES:
        found = {s.key: c for s in sides for c in s.found.calibrations if c.name == name}
        if found:
            said = ", ".join(f"{key} {text.percent(c.distance, 2)}" for key, c in found.items())
            alt = f"Probability integral transform of {name}: events below u minus u. Greatest distance: {said}."
            out.append(panel(figures.calibration_figure(found), alt, f"{name}: greatest distance {said}"))
    return out


def _strips(panel: _Panels, sides: tuple[content.Side, ...]) -> list[Panel]:
    out = []
    for side in (s for s in sides if s.found.strips):
        said = ", ".join(f"{s.name} {s.end} {text.percent(s.error, 0)}" for s in side.found.strips)
        out.append(
            panel(figures.strips_figure(side.found.strips, side.key), f"{side.title}: error next to bounds: {said}.")
        )
    return out


def _selection(panel: _Panels, sides: tuple[content.Side, ...]) -> list[Panel]:
    out = []
    for side in sides:
        if side.summary is not None and len(side.summary.bic) > 1:
            alt = f"{side.title}: BIC over the number of components K, the chosen K is {side.K}."
            out.append(panel(figures.bic_figure(side.summary, side.K, side.key), alt))
    return out


def _style() -> Markup:
    return Markup("\n").join((asset("report.css"), asset("fit.css", _PACKAGE)))


def render_page(model: ScenarioModel, found: ModelDiagnostics, *, seed: int, drawn: bool = False) -> str:
    """The page as one HTML document; the same input gives the same text."""
    sides = content.sides_of(model, found)
    panel = _Panels()
    html = render(
        "fit.html",
        _PACKAGE,
        verdict=content.verdict,
        bounds_of=content.parameters_text,
        is_off=strip_is_off,
        sections=SECTIONS,
        style=_style(),
        colors=COLORS,
        lines={side.key: line_sample(COLORS[side.key], DASHES[side.key]) for side in sides},
        model_line=line_sample(MODEL, ()),
        units=UNITS,
        meanings=MEANINGS,
        model=model,
        sides=sides,
        seed=seed,
        version=__version__,
        warnings=content.all_warnings(model, sides, drawn=drawn),
        tiles=content.tiles(sides),
        source=content.source_line(model),
        notes=[note for note in model_notes(model) if not note.startswith(WARNING)],
        facts=content.facts(model),
        margins={side.key: _margins(panel, side) for side in sides},
        joint={side.key: _joint(panel, side) for side in sides},
        calibration=_calibration(panel, sides),
        strips=_strips(panel, sides),
        selection=_selection(panel, sides),
        pairs={
            side.key: panel(
                figures.pairs_figure(side.found, side.key),
                f"{side.title}: joint densities of all pairs of parameters, events below the diagonal, model above it.",
            )
            for side in sides
            if len(side.found.names) > 1
        },
    )  # fmt: skip
    return str(html)


def write_page(
    target: Path,
    model: ScenarioModel,
    departures: Departures,
    *,
    seed: int,
    weights: npt.ArrayLike | None,
    png: Path | None,
    drawn: bool,
    progress: Progress | None,
) -> None:
    """Check, render and write; see `studies.fit_page.write_fit_page`."""
    found = diagnose_model(model, departures, seed=seed, weights=weights, progress=progress)
    page = render_page(model, found, seed=seed, drawn=drawn)
    image = None if png is None else picture(content.sides_of(model, found))
    write_text(target, page)
    if png is not None and image is not None:
        with stored_file(Path(png)) as stream:
            stream.write(image)
