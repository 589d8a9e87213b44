"""Scenario model: generated departures against source departures, choice of K, acceptance, origin, warnings."""

from __future__ import annotations

from collections.abc import Iterator

from ldctoolkit.scenario_model import ScenarioModel, SideSummary, conditions
from studies.fit_page import content
from studies.fit_page.figures import bic_figure
from studies.fit_page.style import COLORS, MEANINGS, MODEL, TITLES, UNITS
from studies.report.context import Context
from studies.report.figures.generated import MODEL_DASH, margins_figure, pairs_figure
from studies.report.look.svg import line_sample
from studies.report.model_match.match import match
from studies.report.model_match.parts import SideMatch
from studies.report.rendering import render
from studies.report.section import Drawing, Section
from studies.report.words import text
from studies.storage.stored_model import WARNING


def section(context: Context) -> Section:
    """The section."""
    report = context.report
    model, known = report.model, report.source_departures
    sides = match(context.scenarios, model, source=known, given=report.given)
    margins = tuple(_margins(side) for side in sides if side.margins)
    pairs = tuple(_pairs(side) for side in sides if side.pairs)
    bic = () if model is None else tuple(_bic(model, sides))
    body = render(
        "sections/model.html",
        report=report,
        model=model,
        sides=sides,
        titles=TITLES,
        units=UNITS,
        meanings=MEANINGS,
        margins=margins,
        pairs=pairs,
        bic=bic,
        chosen=() if model is None else tuple(_chosen(model, sides)),
        verdicts=tuple(sentence for side in sides for sentence in _verdicts(side)),
        conditions="; ".join(map(str, conditions(report.given))),
        reasons=tuple(dict.fromkeys(side.reason for side in sides if side.reason)),
        colors=COLORS,
        source_line=line_sample(MODEL, ()),
        model_line=line_sample(MODEL, MODEL_DASH),
        facts=() if model is None else (("Name", report.model_name), *content.facts(model)),
        origin="" if model is None else content.source_line(model),
        notes=tuple(note for note in report.model_notes if not note.startswith(WARNING)) if model is None else (),
        warnings=_warnings(context),
    )
    return Section("model", "Scenario model", body, (*margins, *pairs, *bic), styles=("model.css",))


def _warnings(context: Context) -> tuple[str, ...]:
    """What the fit warned of; by the model itself or, without it, by what the study's folder says of it."""
    noted = tuple(note.removeprefix(WARNING) for note in context.report.model_notes if note.startswith(WARNING))
    own = () if context.report.model is None else context.report.model.provenance.warnings
    return tuple(dict.fromkeys((*own, *noted)))


def _margins(side: SideMatch) -> Drawing:
    said = ", ".join(side.names)
    others = [word for word, there in (("source departures as a line", side.origin != "none"),
                                       ("the model as a dashed line", side.drawing is not None)) if there]  # fmt: skip
    beside = f", {' and '.join(others)}" if others else ""
    title = f"{TITLES[side.key]}: histograms of {said}; generated departures as bars{beside}"
    return Drawing(f"model-margins-{side.key}", title, margins_figure(side))


def _pairs(side: SideMatch) -> Drawing:
    known = side.pairs[0].reference is not None
    whose = ", contours of the source departures" if side.origin != "none" else ", contours of the model"
    title = f"{TITLES[side.key]}: all pairs of parameters; generated departures shaded{whose if known else ''}"
    return Drawing(f"model-pairs-{side.key}", title, pairs_figure(side))


def _fitted(model: ScenarioModel, key: str) -> SideSummary | None:
    return model.provenance.left if key == "left" else model.provenance.right


def _bic(model: ScenarioModel, sides: tuple[SideMatch, ...]) -> Iterator[Drawing]:
    for side in sides:
        fitted = _fitted(model, side.key)
        if fitted is not None and side.drawing is not None and len(fitted.bic) > 1:
            K = side.drawing.K
            title = f"{TITLES[side.key]}: BIC over the number of components K; the chosen K is {K}"
            yield Drawing(f"model-bic-{side.key}", title, bic_figure(fitted, K, side.key))


def _chosen(model: ScenarioModel, sides: tuple[SideMatch, ...]) -> Iterator[tuple[str, str, str, str, str, str]]:
    """A row of the table of draws for each side."""
    for side in sides:
        if side.drawing is None:
            continue
        fitted, drawing = _fitted(model, side.key), side.drawing
        yield (
            TITLES[side.key],
            "–" if fitted is None else f"{fitted.events:,}",  # noqa: RUF001
            f"{drawing.K}{f' ({fitted.reason})' if fitted is not None and fitted.reason else ''}",
            text.percent(drawing.within_bounds),
            text.percent(drawing.redrawn, 2),
            "" if drawing.met is None else text.percent(drawing.met),
        )


def _verdicts(side: SideMatch) -> Iterator[str]:
    """How far the generated departures are from the source, and from the model, in words."""
    for whose, found in (
        ("the source departures", [(m.name, m.to_source) for m in side.margins]),
        ("the model", [(m.name, m.to_model) for m in side.margins]),
    ):
        known = [(name, gap) for name, gap in found if gap is not None]
        if not known:
            continue
        beyond = [name for name, gap in known if gap.beyond]
        name, gap = max(known, key=lambda one: one[1].value / one[1].limit)
        worst = f"{name} with a distance of {text.percent(gap.value)}, chance reaches {text.percent(gap.limit)}"
        if beyond:
            said = f"differ from {whose} by more than chance in {', '.join(beyond)}; the furthest is {worst}"
        else:
            said = f"differ from {whose} by no more than chance in any parameter; the furthest is {worst}"
        yield f"{TITLES[side.key]}: the generated departures {said}."
    pair = side.widest_pair
    if pair is not None and pair.reference_rank is not None:
        whose = "source departures" if side.origin != "none" else "model"
        low, high = (text.signed(end, 2) for end in pair.limits or (-1.0, 1.0))
        count = sum(one.beyond for one in side.pairs)
        if count:
            said = (
                f"{count} of {len(side.pairs)} rank correlations differ from those of the {whose} by more than chance"
            )
        else:
            said = f"rank correlations differ from those of the {whose} by no more than chance makes"
        yield (
            f"{TITLES[side.key]}: {said}; the furthest off is that of {pair.first} and {pair.second}: "
            f"{text.signed(pair.generated_rank, 2)} generated, {text.signed(pair.reference_rank, 2)} in the {whose}, "
            f"chance reaches from {low} to {high}."
        )
