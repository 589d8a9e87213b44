"""``ldc fit``: a departures table in, a scenario model out."""

from __future__ import annotations

import argparse
import dataclasses
import math
from typing import TYPE_CHECKING, Any

from studies.cli._console import Subparsers, console, output_file, progress_bar, warn, whole_number

if TYPE_CHECKING:
    from ldctoolkit.recordings import Criteria, Provenance
    from ldctoolkit.scenario_model import ScenarioModel, SideSummary


def add_parser(commands: Subparsers) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "fit",
        help="fit a scenario model to departures",
        description="Fit one bounded Gaussian mixture a side to a departures table; the number of components K is the "
        "one with the smallest BIC.",
    )
    parser.add_argument("departures", metavar="DEPARTURES.parquet", help="what ldc extract wrote")
    parser.add_argument("-o", "--output", required=True, metavar="MODEL.json", help="scenario model to write")
    parser.add_argument(
        "--components", type=components, default="1:10", metavar="K", help="K, or a range (default: %(default)s)"
    )
    parser.add_argument("--seed", type=whole_number, default=0, metavar="N", help="random seed (default: 0)")
    parser.set_defaults(run=run)


def components(text: str) -> int | range:
    """``5``, or ``1:10`` with both ends included."""
    first, colon, last = text.partition(":")
    try:
        low, high = whole_number(first), whole_number(last if colon else first)
    except argparse.ArgumentTypeError:
        low, high = 0, 0
    if not 1 <= low <= high <= 100:
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: K or FIRST:LAST, from 1 to 100")
    return range(low, high + 1) if colon else low


def run(chosen: argparse.Namespace) -> None:
    """Carry the command out."""
    from ldctoolkit.recordings import read_departures
    from ldctoolkit.scenario_model import fit_scenario_model

    target = output_file(chosen.output, ".json")
    departures, provenance = read_departures(chosen.departures)
    with progress_bar("fitting") as advance:
        model = fit_scenario_model(
            departures,
            components=chosen.components,
            seed=chosen.seed,
            bounds=_bounds(provenance.criteria),
            source_provenance=_source(provenance),
            progress=None if advance is None else lambda _, done, total: advance(done, total),
        )
    model.save(target)
    for warning in model.provenance.warnings:
        warn(warning)
    _print_fits(model)
    print(f"scenario model written to {target} (content {model.content_hash[:12]})")


def _bounds(criteria: Criteria) -> dict[str, tuple[float, float]]:
    """The box that the extraction left: no event outside it could have been found."""
    return {
        "T": (criteria.min_duration, criteria.max_duration),
        "v_mean": (criteria.min_speed, math.inf),
    }


def _source(provenance: Provenance) -> dict[str, Any]:
    """What a model tells of the recordings behind it; names of files, not where they lay."""
    return {
        "recordings": provenance.recordings,
        "hours": provenance.hours,
        "files": [source.name for source in provenance.sources],
        "curvature": provenance.curvature,
        "criteria": dataclasses.asdict(provenance.criteria),
        "refused": dict(provenance.refused.items()),
        "warnings": list(provenance.warnings),
    }


def _print_fits(model: ScenarioModel) -> None:
    from rich.table import Table

    out = console()
    for label, summary in (("left", model.provenance.left), ("right", model.provenance.right)):
        if summary is None:
            continue
        out.print(f"{label}: {summary.events} departures")
        table = Table()
        for heading in ("K", "BIC", "log-likelihood an event"):
            table.add_column(heading, justify="right")
        for K, bic, mean in _fits(summary):
            chosen = bic == min(summary.bic)
            table.add_row(
                f"{K}", f"{bic:.1f}{' *' if chosen else '  '}", f"{mean:.4f}", style="bold" if chosen else None
            )
        out.print(table)
    print("*: smallest BIC, taken")


def _fits(summary: SideSummary) -> list[tuple[int, float, float]]:
    return list(zip(summary.n_components, summary.bic, summary.log_likelihood, strict=True))
