"""``ldc init``: a commented study file, from a study of the catalog or from a few answers."""

from __future__ import annotations

import argparse
import dataclasses
import inspect
import itertools
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from ldctoolkit.checked_files import read_toml
from ldctoolkit.errors import InputError, UnknownNameError

from ._console import Subparsers, number, output_file, positive_number

if TYPE_CHECKING:
    from ldctoolkit.vehicle import VehicleParameters

_BASE: Final = "trigger-and-gains"  # study whose plant, requirements and counts a file made from answers has


def add_parser(commands: Subparsers) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "init",
        help="write a study file with comments, to change and run",
        description="Write a study file in which every key has a comment: meaning, unit, default, allowed values. It "
        "is a study of the catalog, or one of the laws given; options replace what the study has.",
    )
    add = parser.add_argument
    add("study", nargs="?", metavar="STUDY", help=f"name in the catalog to start from (with --law: {_BASE})")
    add("--law", action="append", metavar="LAW", help="compare this law, with no control beside it; repeatable")
    add("--y-s", nargs="+", type=number, metavar="M", help="trigger thresholds in m (with --law: 0.2)")
    add("--model", metavar="MODEL", help="scenario model: a name or a JSON file")
    add("--departures", metavar="FILE.parquet", help="rank on these; with --model, score the finalists on them too")
    add("-n", type=positive_number, metavar="N", help="number of departures, half of them to each side")
    add("--require", action="append", metavar="TEXT", help="requirement, for example 'a_y_peak_p95 <= 3.0'; repeatable")
    add("--plant", metavar="STUDY", help="study of the catalog whose plant is taken; ideal: the ideal plant")
    about = "take the vehicle from a data sheet: keys as the arguments of VehicleParameters.from_data_sheet"
    add("--data-sheet", metavar="FILE.toml", help=about)
    add("--name", metavar="NAME", help="name of the study (default: that of the file)")
    add("-o", "--output", metavar="FILE.toml", help="study file to write (default: NAME.toml)")
    add("--force", action="store_true", help="replace an existing file")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> None:
    """Carry the command out."""
    from ..runner import study_source
    from ..storage.folder_files import write_text
    from ..study_file import CATALOG, Study, catalog_names
    from ..study_template import study_text

    if not (args.study or args.law or args.data_sheet):
        problem = "give a study of the catalog, --law or --data-sheet"
        raise InputError("init", problem, allowed=", ".join(catalog_names()))
    name = args.name or (Path(args.output).stem if args.output else args.study or "my-study")
    target = output_file(args.output or f"{name}.toml", ".toml", option="-o" if args.output else "--name")
    if target.exists() and not args.force:
        raise InputError(target, "exists already", allowed="another -o, or --force to replace it")
    content = _content(args, target)
    car = content["vehicle"].get("model", "").partition(":")[0]
    if car and not target.with_name(car).exists():  # the catalog's own vehicle, to be edited
        write_text(target.with_name(car), (CATALOG / car).read_text(encoding="utf-8"))
    notes = "\n"
    if args.data_sheet:
        vehicle = read_data_sheet(Path(args.data_sheet))
        content["vehicle"] |= {key: float(f"{value:.6g}") for key, value in dataclasses.asdict(vehicle).items()}
        sheet = f"the vehicle of the data sheet {Path(args.data_sheet).name}"
        sheet += f"; laws are designed with it, but the vehicle that is driven has the values in {car}" if car else ""
        notes = "".join(f"\n# {line}" for line in (sheet, *vehicle.notes)) + "\n"
    study = Study.from_dict(content | {"name": name}, source=str(target), folder=target.parent)
    if args.model or args.departures:
        study_source(study)  # refused now, and not when the file is run
    about = [f"# Run it with: ldc run {target.name}"]
    if not args.study:
        about.append(f"# Scenarios, plant and requirements are those of {_BASE}, where no option chose others.")
    if args.study and content == _of_catalog(args.study):  # else what its head says need not hold
        lines = (CATALOG / f"{args.study}.toml").read_text(encoding="utf-8").splitlines()
        about = [*itertools.takewhile(lambda line: line.startswith("#"), lines), *about]
    write_text(target, study_text(study, about).replace("\n[vehicle]", f"{notes}[vehicle]", 1))
    print(f"study file written to {target}\nrun it with: ldc run {target}")


def _content(args: argparse.Namespace, target: Path) -> dict[str, Any]:
    """The study of the catalog with what the options replace."""
    from ldctoolkit.registry import controller_class
    from ldctoolkit.scenario_model import bundled_models

    content = _of_catalog(args.study or _BASE)
    if args.law:
        laws = [law for law in dict.fromkeys(args.law) if controller_class(law).name != "none"]
        blocks = [{"law": law, "y_s": [0.2], "gains": {}} for law in ("none", *laws)]
        content |= {"title": "", "design": blocks}
    for block in content["design"] if args.y_s else ():
        block["y_s"] = block["y_s"] if block["law"] == "none" else args.y_s
    if args.require:
        content["ranking"]["require"] = args.require
    if args.plant:
        content["plant"] = _of_catalog(args.plant)["plant"]
    # paths in a study file start at its folder
    files = {"departures": args.departures, "model": args.model if args.model not in bundled_models() else None}
    beside = {key: Path(os.path.relpath(path, target.parent)).as_posix() for key, path in files.items() if path}
    alone = {"model": "", "left": None, "right": None} if args.departures and not args.model else {}
    named = {"model": args.model} if args.model else {}
    sides = {"left": (args.n + 1) // 2, "right": args.n // 2} if args.n else {}
    content["scenarios"] |= alone | named | beside | sides
    return content


def read_data_sheet(path: Path) -> VehicleParameters:
    """The vehicle of a data sheet in TOML; raises `InputError` naming the file and the key."""
    from ldctoolkit.vehicle import VehicleParameters

    content = read_toml(path, InputError)
    keys = inspect.signature(VehicleParameters.from_data_sheet).parameters
    try:
        for key in content:
            if key not in keys:
                raise InputError(key, "no such key", allowed=tuple(keys))
        given: Any = {key: content.get(key) for key in keys}  # None is refused where a value is needed
        return VehicleParameters.from_data_sheet(**given)
    except InputError as error:
        raise error.within(path.name, ": ") from None


def _of_catalog(name: str) -> dict[str, Any]:
    from ..study_file import catalog_names, load_study

    if name not in catalog_names():
        raise UnknownNameError("study", "is not in the catalog", value=name, allowed=catalog_names())
    return load_study(name).content()
