"""``ldc extract``: driving recordings in, a departures table out."""

from __future__ import annotations

import argparse

from studies.cli._console import Subparsers, console, number, output_file, progress_bar, warn


def add_parser(commands: Subparsers) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "extract",
        help="find lane departures in driving recordings",
        description="Find the lane departures in driving recordings (CSV, CSV.gz, Parquet) and write one row each: "
        "the eight parameters, side, recording, start time. Every refused candidate is counted by reason.",
    )
    parser.add_argument("paths", nargs="+", metavar="PATH", help="recording tables")
    parser.add_argument("-o", "--output", required=True, metavar="FILE.parquet", help="departures table to write")
    parser.add_argument("--vehicle-width", type=number, default=1.9, metavar="M", help="in m (default: %(default)s)")
    parser.add_argument("--min-duration", type=number, default=0.5, metavar="S", help="in s (default: %(default)s)")
    parser.add_argument("--max-duration", type=number, default=10.0, metavar="S", help="in s (default: %(default)s)")
    parser.add_argument("--min-speed", type=number, default=5.0, metavar="V", help="in m/s (default: %(default)s)")
    parser.add_argument(
        "--max-gap", type=number, metavar="S", help="longest time step that is no gap (default: from the recording)"
    )
    parser.add_argument(
        "--max-jump", type=number, default=0.6, metavar="M", help="largest step of the offset (default: %(default)s)"
    )
    parser.set_defaults(run=run)


def run(chosen: argparse.Namespace) -> None:
    """Carry the command out."""
    from rich.table import Table

    from ldctoolkit.departures import LEFT
    from ldctoolkit.recordings import extract_departures, read_recordings, write_departures

    target = output_file(chosen.output, ".parquet")
    with progress_bar("reading") as progress:
        found = extract_departures(
            read_recordings(chosen.paths, progress=progress),
            vehicle_width=chosen.vehicle_width,
            min_duration=chosen.min_duration,
            max_duration=chosen.max_duration,
            min_speed=chosen.min_speed,
            max_gap=chosen.max_gap,
            max_jump=chosen.max_jump,
        )
    write_departures(target, found.departures, found.provenance)

    for warning in found.warnings:
        warn(warning)
    out = console()
    out.print(f"{found.candidates} candidates in {found.recordings} recordings, {found.hours:.1f} h")
    table = Table()
    table.add_column("candidate")
    table.add_column("count", justify="right")
    left = int((found.departures.side == LEFT).sum())
    table.add_row("departure, left", str(left))
    table.add_row("departure, right", str(len(found.departures) - left), end_section=True)
    for reason, count in found.refused.items():
        table.add_row(f"refused: {reason.replace('_', ' ')}", str(count))
    out.print(table)
    if len(found.departures) == 0:
        warn("no departures were found")
    print(f"{len(found.departures)} departures written to {target}")
