"""The page: context for the template, rendered and written whole."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ldctoolkit.departures import Departures
from ldctoolkit.scenario_model import ScenarioModel
from studies.files import write_text

Progress = Callable[[str, int, int], None]


def write_page(
    target: Path,
    model: ScenarioModel,
    departures: Departures,
    *,
    seed: int,
    png: Path | None,
    progress: Progress | None,
) -> None:
    """Check, render and write; see `studies.fit_page.write_fit_page`."""
    del seed, png
    if progress is not None:
        progress("page", 0, 1)
    write_text(
        target,
        f"<!DOCTYPE html><html lang=en><title>Fit</title><p>{len(departures)} departures, "
        f"model {model.content_hash[:12]}</html>",
    )
    if progress is not None:
        progress("done", 1, 1)
