"""``ldc export``: a design as C code, checked in the closed loop."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from ._console import Subparsers, console, progress_bar, say

if TYPE_CHECKING:
    from ldctoolkit.scenarios import Scenarios

    from ._results import Judged

FAILED = 3  # exit code where the check failed, or a folder was changed or is stale
NOT_RUN = 4  # where there is no compiler


def add_parser(commands: Subparsers) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "export",
        help="write a design as C code and prove it in the closed loop",
        description="Write a design as C99 code with a test bench, compile it, and drive at least 1,000 scenarios of "
        "its study with it: commands and S must be the toolkit's. Exit code 3 where they are not, 4 where there is no "
        "C compiler.",
    )
    add = parser.add_argument
    add("folder", metavar="DIR", help="folder that ldc run wrote")
    add("--design", metavar="LABEL", help="label or id of a design (default: the one that the verdict names)")
    add("-o", "--output", metavar="FOLDER", required=True, help="where the files go")
    add("--format", choices=("c", "json", "m"), default="c", help="C code, or gains over speed alone (default: c)")
    add("--fmu", action="store_true", help="pack the C code as an FMU too (FMI 2.0, co-simulation)")
    add("--no-check", action="store_true", help="do not compile and drive the code")
    add("--anyway", action="store_true", help="export a design that does not meet the requirements of its study")
    add("--verify", action="store_true", help="write nothing: report whether FOLDER is unchanged and up to date")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Carry the command out; the exit code reports whether the code is proved."""
    from ldctoolkit.errors import InputError

    from ..design import named_designs
    from ..export import Code, Origin, changed_files, export_c, is_stale, parameters
    from ..storage.files import output_folder, write_text
    from ._results import judged

    study = judged(args.folder)
    design = study.design if args.design is None else named_designs(study.ranking.designs, [args.design])[0]
    missed = tuple(miss.text for miss in study.ranking.missed[study.ranking.designs.index(design)])
    if missed and not (args.anyway or args.verify):
        raise InputError(
            design.label,
            f"does not meet the requirements of study {study.study.name}: {'; '.join(missed)}",
            allowed="another --design, or --anyway, which the header states",
        )
    setup, folder = study.study.setup(), Path(args.output)
    origin = Origin(study.study.name, study.manifest.study_hash, study.manifest.model_hash, study.verdict.title, missed)
    controller, out = design.controller(setup.convention), console()
    if args.verify:
        if not (folder / "ldc_controller.h").is_file():
            raise InputError(folder, "holds no export", allowed="a folder that ldc export wrote")
        changed = changed_files(folder)
        stale = not changed and is_stale(Code.of(controller, setup, design.y_s, origin), folder)
        text = "stale: not what this study and this version give" if stale else "up to date"
        say(out, f"{folder}: {'changed by hand: ' + ', '.join(changed) if changed else text}")
        return FAILED if changed or stale else 0
    if args.format != "c":
        target = output_folder(folder) / f"ldc_controller.{args.format}"
        write_text(target, parameters(Code.of(controller, setup, design.y_s, origin), args.format))
        say(out, f"gains over speed: {target}")
        return 0
    with progress_bar("writing, compiling and driving the code"):
        export = export_c(
            controller, setup, design.y_s, folder, scenarios=_scenarios(study, args.folder), origin=origin,
            run_check=not args.no_check, fmu=args.fmu,
        )  # fmt: skip
    say(out, design.label, *(f"  {path}" for path in export.files))
    if export.check is None:
        say(out, f"in the loop: not run ({export.not_run})")
        return 0 if args.no_check else NOT_RUN
    say(out, *export.check.lines)
    return 0 if export.check.passed else FAILED


def _scenarios(study: Judged, folder: str) -> Scenarios:
    """Those of the study; more of the same model where they are few."""
    from ..export import DEPARTURES
    from ..storage.stored_model import read_model

    scenarios = study.results.scenarios
    model = read_model(folder, study.manifest) if scenarios.n < DEPARTURES and study.study.scenarios.model else None
    if model is None:
        return scenarios
    left, right = (math.ceil(count * DEPARTURES / scenarios.n) for count in study.study.scenarios.counts)
    return model.sample(left, right, seed=study.study.seed, given=study.study.scenarios.given)
