"""What the page says in words and tables."""

from __future__ import annotations

import dataclasses

from ldctoolkit.diagnostics import Calibration, Comparison, Component, ModelDiagnostics, SideDiagnostics
from ldctoolkit.diagnostics.parts import COMPARISON_STANDARD_ERRORS
from ldctoolkit.scenario_model import ScenarioModel, SideModel, SideSummary
from studies.fit_page.style import TITLES
from studies.report.section import Tile
from studies.report.words import text


@dataclasses.dataclass(frozen=True)
class Side:
    """One side with all that the page shows of it."""

    key: str
    title: str
    model: SideModel
    summary: SideSummary | None
    found: SideDiagnostics

    @property
    def K(self) -> int:
        """Components."""
        return len(self.found.components)

    def calibration(self, name: str) -> Calibration | None:
        """Of one parameter; None where it does not vary."""
        return next((one for one in self.found.calibrations if one.name == name), None)

    @property
    def criteria(self) -> list[tuple[str, list[str]]]:
        """Criteria that were computed beside BIC: title and a text for each K."""
        one = self.summary
        if one is None:
            return []
        columns = (("AIC", one.aic, 1), ("ICL", one.icl, 1), ("Held out [nats an event]", one.held_out, 4))
        length = len(one.n_components)
        return [
            (title, [f"{value:,.{digits}f}".replace("-", text.MINUS) for value in values])
            for title, values, digits in columns
            if len(values) == length
        ]

    @property
    def ordered(self) -> list[tuple[int, Component]]:
        """Number and values of each component, the heaviest first."""
        return sorted(enumerate(self.found.components), key=lambda pair: -pair[1].weight)


def sides_of(model: ScenarioModel, found: ModelDiagnostics) -> tuple[Side, Side]:
    """Left and right, together with their fits."""
    origin = model.provenance
    return (
        Side("left", TITLES["left"], model.left_side, origin.left, found.left),
        Side("right", TITLES["right"], model.right_side, origin.right, found.right),
    )


def all_warnings(model: ScenarioModel, sides: tuple[Side, Side], *, drawn: bool = False) -> list[str]:
    """Warnings of the diagnosis, of the data, and those that the model carries; nothing twice.

    With `drawn` the model was fitted to more departures, of which those that it is checked against were drawn.
    """
    origin = model.provenance
    lines: list[str] = []
    if origin.synthetic:
        lines.append("the model is synthetic: it was fitted to drawn, not to recorded departures")
    for side in sides:
        if side.summary is not None and side.summary.events != side.found.events + _left_out(side.found):
            others = "of them, drawn at random" if drawn else "others"
            lines.append(
                f"{side.key}: the model was fitted to {side.summary.events:,} departures and is checked here against "
                f"{side.found.events:,} {others}"
            )
        lines += side.found.warnings
    # of components and of the fit's end the diagnosis has spoken
    told = tuple(f"{side.key}: {word}" for side in sides for word in ("Component", "Not converged"))
    return list(dict.fromkeys((*lines, *(one for one in origin.warnings if not one.startswith(told)))))


def _left_out(found: SideDiagnostics) -> int:
    return sum(count for _, count in found.outside)


def tiles(sides: tuple[Side, Side]) -> list[Tile]:
    """Counts, K, and the worst of each kind of misfit."""
    shown = text.number
    left, right = sides
    events = Tile(
        f"{left.found.events + right.found.events:,}",
        "",
        "departures",
        f"{left.found.events:,} left, {right.found.events:,} right",
    )
    components = Tile(f"{left.K} / {right.K}", "", "components K", "left / right")
    out = [events, components]
    worst = max(
        ((c, s) for s in sides for c in s.found.calibrations), key=lambda pair: pair[0].distance / pair[0].limit
    )
    calibration, side = worst
    out.append(
        Tile(
            shown(100.0 * calibration.distance, 2),
            "%",
            f"Kolmogorov distance of {calibration.name}, {side.key}",
            f"the worst against its limit, {text.percent(calibration.limit, 2)}",
        )
    )
    strips = [(strip, s) for s in sides for strip in s.found.strips]
    if strips:
        strip, side = max(strips, key=lambda pair: abs(pair[0].error))
        out.append(
            Tile(
                text.signed(100.0 * strip.error, 0),
                "%",
                f"mass next to the {strip.end} bound of {strip.name}, {side.key}",
                f"the largest error at a bound, standard error {text.percent(strip.standard_error, 0)}",
            )
        )
    comparisons = [(s.found.comparison, s) for s in sides if s.found.comparison is not None]
    if comparisons:
        comparison, side = max(comparisons, key=lambda pair: pair[0].difference)
        value = f"{text.signed(comparison.difference)}"
        detail = f"transformed minus bounded, {side.key}, standard error {text.number(comparison.standard_error)}"
        out.append(Tile(value, "nats", "held-out likelihood an event, the alternative", detail))
    return out


def source_line(model: ScenarioModel) -> str:
    """Where the departures come from, in one line; empty where the model does not say."""
    source = model.provenance.source
    if source.get("description"):
        return str(source["description"])
    parts = []
    recordings, hours, files = (source.get(key) for key in ("recordings", "hours", "files"))
    if isinstance(recordings, int):
        parts.append(text.plural(recordings, "recording"))
    if isinstance(hours, int | float):
        parts.append(f"{hours:.3g} hours")
    if isinstance(files, list | tuple) and files:
        parts.append(", ".join(map(str, files[:3])) + (f" and {len(files) - 3} more" if len(files) > 3 else ""))
    return f"from {'; '.join(parts)}" if parts else ""


def verdict(comparison: Comparison) -> str:
    """What the comparison says, in words."""
    if abs(comparison.difference) <= COMPARISON_STANDARD_ERRORS * comparison.standard_error:
        return "no clear difference"
    return f"the {'transformed' if comparison.difference > 0 else 'bounded'} mixture describes them better"


def facts(model: ScenarioModel) -> tuple[tuple[str, str], ...]:
    """Name and value of what the model is and where it comes from."""
    origin = model.provenance
    return tuple(
        (name, value)
        for name, value in (
            ("Model content", model.content_hash),
            ("Fitted with", origin.software),
            ("Created", origin.created),
            ("Seed of the fit", str(origin.seed)),
        )
        if value
    )


def parameters_text(side: Side) -> str:
    """Bounds of each parameter and the constants of a side."""
    low, high = side.model.bounds()
    parts = []
    for j, name in enumerate(side.model.names):
        ends = [text.compact(float(low[j])) if low[j] > -float("inf") else "", ""]
        ends[1] = text.compact(float(high[j])) if high[j] < float("inf") else ""
        if ends[0] and ends[1]:
            parts.append(f"{name} {ends[0]} to {ends[1]}")
        elif ends[0] or ends[1]:
            parts.append(f"{name} above {ends[0]}" if ends[0] else f"{name} below {ends[1]}")
        else:
            parts.append(f"{name} open")
    parts += [f"{name} = {text.compact(value)} (constant)" for name, value in side.model.constants]
    return ", ".join(parts)
