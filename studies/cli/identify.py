"""``ldc identify``: actuator and vehicle from recordings."""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING

from ldctoolkit.declared import checked_number
from ldctoolkit.errors import InputError

from ..tables import Column, Row, Table
from . import _console
from .extract import SOME_LEFT_OUT, print_problems

if TYPE_CHECKING:
    from ldctoolkit.identification import Identification


def add_parser(commands: _console.Subparsers) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "identify",
        help="identify steering actuator and vehicle from logs",
        description="Identify the steering actuator (lag, delay, rate limit) from commanded and measured steering "
        "angle, and the vehicle (understeer gradient, stiffnesses, yaw inertia) from speed, steering angle and yaw "
        "rate, with 95 % intervals. Reads what ldc extract reads; what is not identifiable is refused, with "
        "the reason. Exit code 3: done, but some of the input could not be used; it is named.",
    )
    add = parser.add_argument
    add("paths", nargs="+", metavar="LOG", help="files or folders of one format")
    add("--format", default="auto", metavar="NAME", help="format, as in ldc extract (default: auto)")
    add("--channels", metavar="MAP.toml", help="channel map of MDF logs: which channel holds what")
    about = (
        "study (name in the catalog or TOML file) whose m, l_f and l_r are taken: needed for stiffnesses and inertia"
    )
    add("--vehicle", metavar="STUDY", help=about)
    ratio = _console.argument(checked_number, above=0.0)
    about = "angles of the log over those of the front wheels; of a steering wheel 15 or so (default: 1)"
    add("--steering-ratio", type=ratio, default=1.0, metavar="X", help=about)
    add("--toml", metavar="FILE.toml", help="also write tables for a study file: [plant.actuator] and [vehicle]")
    add("--json", action="store_true", help="one JSON object on stdout, no table")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Carry the command out."""
    from ldctoolkit.identification import identify
    from ldctoolkit.recordings.recording import Problem, Recording, open_recordings

    from ..storage.folder_files import write_text
    from ..study_file import load_study

    target = None if args.toml is None else _console.output_file(args.toml, ".toml", option="--toml")
    if target is not None and target.exists():
        raise InputError(f"--toml {target}", "exists already", allowed="a new file")
    vehicle = None if args.vehicle is None else load_study(args.vehicle).vehicle
    with _console.progress_bar("identifying"):
        source = open_recordings(args.paths, format=args.format, channels=args.channels, lane=False).source
        items = [*source.problems, *(item for part in source.parts for item in part.read())]
        problems = [item for item in items if isinstance(item, Problem)]
        recordings = [item for item in items if isinstance(item, Recording)]
        if not recordings and problems:
            raise problems[0].error
        result = identify(recordings, vehicle, steering_ratio=args.steering_ratio)
    print_problems(problems, written=False)
    if target is not None:
        write_text(target, toml_text(result))
    if args.json:
        values = [estimate._asdict() for estimate in result.estimates]
        print(json.dumps({"estimates": values, "notes": result.notes, "problems": [str(item) for item in problems]}))
    else:
        columns = [Column("", text=True), Column("value", form=".4g"), Column("95 % interval", form=".4g")]
        columns += [Column("unit", text=True), Column("reason", text=True)]
        rows = [Row([name, value, interval, unit, why]) for name, unit, value, interval, why in result.estimates]
        _console.print_table(Table("", columns, rows))
        print(*result.notes, *([f"written to {target}"] if target else []), sep="\n")
    return SOME_LEFT_OUT if problems else 0


def toml_text(result: Identification) -> str:
    """The tables of a study file; what is not identifiable is commented out."""
    lines = ["# identified from logs, with 95 % intervals"]
    for table, names in {"plant.actuator": ("lag", "delay", "rate_max"), "vehicle": ("C_af", "C_ar", "I_z")}.items():
        lines += ["", f"[{table}]"]
        if result.given is not None and table == "vehicle":
            lines += [f"{name} = {getattr(result.given, name)!r}" for name in ("m", "l_f", "l_r")]
        for name, unit, value, interval, reason in result.estimates:
            if name in names and interval:
                lines.append(f"{name} = {value:.6g}  # [{unit}] {interval[0]:.4g} to {interval[1]:.4g}")
            elif name in names:
                lines.append(f"# {name}: {reason}")
    return "\n".join([*lines, ""])
