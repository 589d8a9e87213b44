"""``ldc extract``: driving recordings in, a departures table out."""

from __future__ import annotations

import argparse
import functools
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from ldctoolkit.errors import InputError

from ..tables import Column, Row, Table
from . import _console

if TYPE_CHECKING:
    from ldctoolkit.recordings.departures_table import Extraction
    from ldctoolkit.recordings.recording import Problem, SourceFile


SOME_LEFT_OUT = 3  # exit code where departures were written, but not all of the input could be used


def add_parser(commands: _console.Subparsers) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "extract",
        help="find lane departures in driving recordings",
        description="Find the lane departures in driving recordings (plain tables, MDF logs, SPMD, UAH-DriveSet, or "
        "what an installed reader knows) and write one row each: the eight parameters, side, recording, start time. "
        "Every refused candidate is counted by reason. After an interruption, the same command continues with what is "
        "missing. Exit code 3: done, but some of the input, which is named, could not be used.",
    )
    parser.add_argument("paths", nargs="+", metavar="PATH", help="files or folders of one format")
    parser.add_argument(
        "--format", default="auto", metavar="NAME",
        help="table, mdf, spmd-das1, spmd-das2, uah-driveset, or another installed reader (default: auto, which "
        "looks at columns and folders)",
    )  # fmt: skip
    parser.add_argument("-o", "--output", metavar="FILE.parquet", help="departures table to write")
    parser.add_argument("--channels", metavar="MAP.toml", help="channel map of MDF logs: which channel holds what")
    about = "only print the channels of an MDF log, and a guess of its map"
    parser.add_argument("--list-channels", action="store_true", help=about)
    parser.add_argument("--report", metavar="FILE.html", help="also write a page about the quality of what was found")
    options: tuple[tuple[str, str, float | None, str], ...] = (
        ("vehicle-width", "M", None, "width in m (default: the format's; table: 1.9)"),
        ("step", "S", None, "common time step in s (default: the format's; table: as recorded)"),
        ("nominal-lane-width", "M", None, "scale each recording to this median lane width, in m"),
        ("yaw-rate-factor", "X", 1.0, "multiply the recorded yaw rate (default: 1; -1: positive to the right)"),
        ("min-duration", "S", 0.5, "shortest, in s (default: %(default)s)"),
        ("max-duration", "S", 10.0, "longest, in s (default: %(default)s)"),
        ("min-speed", "V", 5.0, "least mean speed in m/s (default: %(default)s)"),
        ("max-gap", "S", None, "longest time step that is no gap (default: from the recording)"),
        ("max-jump", "M", 0.6, "largest movement of the offset in 0.1 s, in m (default: %(default)s); over longer "
         "times 1.5 m/s more"),
        ("min-lane-width", "M", 2.0, "narrowest lane of a valid sample, in m (default: %(default)s)"),
        ("max-lane-width", "M", 7.0, "widest lane of a valid sample, in m (default: %(default)s)"),
    )  # fmt: skip
    for name, unit, default, text in options:
        parser.add_argument(f"--{name}", type=_console.number, metavar=unit, default=default, help=text)
    about = "also count departures and hours while an assistance system steers"
    parser.add_argument("--keep-engaged", action="store_true", help=about)
    about = "continue although a unit, a sign or a reference cannot be right"
    parser.add_argument("--force", action="store_true", help=about)
    _console.add_limit(parser)
    about = "keep y, v and curvature over time in a second table, NAME.signals.parquet, to replay the recorded path"
    parser.add_argument("--signals", action="store_true", help=about)
    about = "processes (default: all cores, or 1 for small inputs)"
    parser.add_argument("--workers", type=_console.positive_number, metavar="N", help=about)
    about = "run on the Dask scheduler at tcp://host:8786, or on a cluster of this machine: local"
    parser.add_argument("--dask", metavar="ADDRESS", help=about)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Carry the command out."""
    if args.list_channels:
        from ldctoolkit.recordings.mdf_logs import list_channels

        print("\n".join(map(list_channels, map(Path, args.paths))))
        return 0
    if args.output is None:
        raise InputError("-o", "is missing", allowed="-o FILE.parquet, the departures table to write")
    from ldctoolkit.recordings.find_departures import Criteria
    from ldctoolkit.recordings.preparation import Preparation
    from ldctoolkit.recordings.recording import open_recordings

    from ..extraction import MOST_NAMED, NothingReadError, parts_folder, run_extraction

    target = _console.output_file(args.output, ".parquet")
    page = None if args.report is None else _console.output_file(args.report, ".html", option="--report")
    # workers of a cluster start in folders of their own
    paths = [Path(path).absolute() if args.dask else Path(path) for path in args.paths]
    channels = None if args.channels is None else Path(args.channels).absolute()
    with _console.progress_bar("looking at the recordings"):
        recordings = open_recordings(paths, format=args.format, channels=channels)
    refuse_input("-o", target, paths, recordings.source.files)
    if page is not None:
        refuse_input("--report", page, paths, recordings.source.files)
    try:
        with _console.progress_bar(f"reading {recordings.reader.name}") as progress:
            width = recordings.reader.vehicle_width if args.vehicle_width is None else args.vehicle_width
            extraction = run_extraction(
                recordings,
                Criteria(
                    width,
                    args.min_duration,
                    args.max_duration,
                    args.min_speed,
                    args.max_gap,
                    args.max_jump,
                    _console.plausibility(args.limit),
                    args.min_lane_width,
                    args.max_lane_width,
                    args.keep_engaged,
                ),
                Preparation(
                    step=recordings.reader.step if args.step is None else args.step,
                    nominal_lane_width=args.nominal_lane_width,
                    yaw_rate_factor=args.yaw_rate_factor,
                ),
                keep_signals=args.signals,
                force=args.force,
                output=target,
                workers=args.workers,
                dask=args.dask,
                progress=progress,
                before_removal=None if page is None else functools.partial(_write_page, page, target),
            )
    except NothingReadError as error:
        if len(error.problems) > MOST_NAMED:
            print_problems(error.problems, written=False)
        raise
    except KeyboardInterrupt:
        folder = parts_folder(target)
        if folder.is_dir():
            _console.warn(f"what was finished is kept in {folder}; the same command goes on with the rest")
        raise

    print(f"format: {recordings.reader.name} ({recordings.found})")
    print_problems(extraction.problems, written=True)
    for warning in extraction.warnings:
        _console.warn(warning)
    print_extraction(extraction)
    if len(extraction.departures) == 0:
        _console.warn("no departures were found")
    print(f"{len(extraction.departures)} departures written to {target}")
    if page is not None:
        print(f"page about the extraction written to {page}")
    return SOME_LEFT_OUT if extraction.problems else 0


def _write_page(page: Path, target: Path, extraction: Extraction) -> None:
    """Write the page while the finished parts are still there: the same command then goes on with it."""
    from ldctoolkit.errors import StoreError

    from ..pages.extraction_page import write_extraction_page

    try:
        with _console.progress_bar("writing the page"):
            write_extraction_page(page, extraction)
    except StoreError as error:
        raise StoreError(f"{error}; the departures are written to {target}") from None


MOST_PROBLEMS: Final = 20


def print_problems(problems: Sequence[Problem], *, written: bool) -> None:
    """What could not be used: the first twenty, one line each, and how many more there are.

    `written`: whether there is a departures table, which holds them.
    """
    for problem in problems[:MOST_PROBLEMS]:
        _console.warn(str(problem))
    if len(problems) > MOST_PROBLEMS:
        more = len(problems) - MOST_PROBLEMS
        where = "; the departures table holds them all" if written else ""
        _console.warn(f"and {more:,} more problems, {len(problems):,} in all{where}")


def print_extraction(extraction: Extraction) -> None:
    """Candidates, departures by side, refused candidates by reason."""
    from ldctoolkit.departures import LEFT

    driven = f"{extraction.hours:.1f} h, {extraction.distance / 1000.0:,.0f} km"
    _console.console().print(f"{extraction.candidates} candidates in {extraction.recordings} recordings, {driven}")
    left = int((extraction.departures.side == LEFT).sum())
    rows = [Row(["departure, left", left]), Row(["departure, right", len(extraction.departures) - left])]
    for k, (reason, count) in enumerate(extraction.refused.items()):
        rows.append(Row([f"refused: {reason.replace('_', ' ')}", count], apart=k == 0))
    _console.print_table(Table("", [Column("candidate", text=True), Column("count")], rows))


def refuse_input(option: str, target: Path, paths: Sequence[Path], files: Sequence[SourceFile]) -> None:
    """Refuse to write over what is read."""
    from ldctoolkit.recordings.recording import source_file

    if not target.exists():
        return
    for path in paths:
        if target.samefile(path):
            raise InputError(f"{option} {target}", f"is the input {path}", allowed="a file that is not read")
        if path.is_dir() and target.resolve().is_relative_to(path.resolve()):
            written = source_file(target)
            if any((written.bytes, written.sha256) == (file.bytes, file.sha256) for file in files):
                raise InputError(f"{option} {target}", f"is an input, in {path}", allowed="a file that is not read")
