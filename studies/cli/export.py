"""``ldc export``: a design as C code, checked in the loop; ``ldc scenarios``: departures for other simulators."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from ._console import Subparsers, console, positive_number, progress_bar, say, warn

if TYPE_CHECKING:
    from ldctoolkit.scenarios import Scenarios

    from ._results import Judged

FAILED = 3  # exit code where the check failed, or a folder was changed or is stale
NOT_RUN = 4  # where there is no compiler


def add_parser(commands: Subparsers) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "export",
        help="write a design as C code and check it in the closed loop",
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
    _add_scenarios(commands)


def run(args: argparse.Namespace) -> int:
    """Carry the command out; the exit code reports whether the code is proved."""
    from ldctoolkit.errors import InputError

    from ..export import Code, Origin, changed_files, export_c, is_stale, parameters
    from ..storage.folder_files import output_folder, write_text
    from ._results import Judged

    judged = Judged.read(args.folder)
    (design,) = judged.named(None if args.design is None else [args.design])
    missed = tuple(miss.text for miss in judged.ranking.missed[judged.ranking.designs.index(design)])
    if missed and not (args.anyway or args.verify):
        raise InputError(
            design.label,
            f"does not meet the requirements of study {judged.study.name}: {'; '.join(missed)}",
            allowed="another --design, or --anyway, which the header states",
        )
    setup, folder = judged.study.setup(), Path(args.output)
    origin = Origin(
        judged.study.name, judged.manifest.study_hash, judged.manifest.model_hash, judged.verdict.title, missed
    )
    controller, out = design.controller(setup.convention), console()
    if args.verify:
        if not (folder / "ldc_controller.h").is_file():
            raise InputError(folder, "is not the folder of an export", allowed="a folder that ldc export wrote")
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
            controller, setup, design.y_s, folder, scenarios=_scenarios(judged), origin=origin,
            run_check=not args.no_check, fmu=args.fmu,
        )  # fmt: skip
    say(out, design.label, *(f"  {path}" for path in export.files))
    if export.check is None:
        say(out, f"in the loop: not run ({export.not_run})")
        return 0 if args.no_check else NOT_RUN
    say(out, *export.check.lines)
    return 0 if export.check.passed else FAILED


def _scenarios(judged: Judged) -> Scenarios:
    """The scenarios of the study, or more of the same model where they are few."""
    from ..export import DEPARTURES
    from ..storage.scenario_source import read_model

    scenarios = judged.results.scenarios
    model = (
        read_model(judged.folder, judged.manifest)
        if scenarios.n < DEPARTURES and judged.study.scenarios.model
        else None
    )
    if model is None:
        return scenarios
    left, right = (math.ceil(count * DEPARTURES / scenarios.n) for count in judged.study.scenarios.counts)
    return model.sample(left, right, seed=judged.study.seed, given=judged.study.scenarios.given)


def _add_scenarios(commands: Subparsers) -> None:
    about = "write departures for esmini, CARLA, CarMaker and other simulators"
    more = "; each is an OpenDRIVE road and an OpenSCENARIO file, or a table of the path"
    parser = commands.add_parser("scenarios", help=about, description=f"W{about[1:]}{more}.")
    add = parser.add_argument
    add("folder", metavar="DIR", help="folder that ldc run wrote")
    about = "the departures with the largest S of the design (default: %(default)s)"
    add("--worst", type=positive_number, default=20, metavar="N", help=about)
    add("--departure", action="append", type=int, metavar="N", help="this scenario number instead; repeatable")
    add("--design", metavar="LABEL", help="label or id of a design (default: the one that the verdict names)")
    add("--recorded", action="store_true", help="the recorded paths, without control")
    add("--format", choices=("openscenario", "csv"), default="openscenario", help="(default: openscenario)")
    about = "the vehicle's point that positions are of (default: %(default)s)"
    add("--reference", choices=("centre_of_gravity", "rear_axle"), default="centre_of_gravity", help=about)
    add("-o", "--output", metavar="FOLDER", help="where the files go (default: DIR/scenarios)")
    parser.set_defaults(run=_run_scenarios)


def _run_scenarios(args: argparse.Namespace) -> None:
    """Carry the command out."""
    import numpy as np

    from ldctoolkit.control import EventStatus
    from ldctoolkit.other_simulators import export_scenarios
    from ldctoolkit.simulation import Takeover, drive

    from ..pages.replay import rows_of_numbers
    from ._results import Judged

    judged = Judged.read(args.folder)
    (design,), results, setup = judged.named(args.design and [args.design]), judged.results, judged.study.setup()
    status, stored, S = (part[results.designs.index(design)] for part in (results.status, results.S, results.counted))
    rows, outcome = np.flatnonzero(results.drivable), None
    if args.departure:
        rows = rows[list(rows_of_numbers(results.scenarios.take(rows), args.departure))]
    else:
        rows = rows[np.argsort(-S[rows], kind="stable")][: args.worst]
    lost = np.isin(status[rows], (EventStatus.TIMED_OUT, EventStatus.CRASHED)) & (not args.recorded)
    if lost.any():
        warn(f"left out, the law timed out or crashed: {', '.join(map(str, results.scenarios.index[rows[lost]]))}")
    scenarios = results.scenarios.take(rows[~lost])
    with progress_bar("driving and writing"):
        if not args.recorded:
            over = Takeover.build(scenarios, setup, y_s=design.y_s)
            outcome = drive(design.controller(setup.convention), over, trajectories=True).outcome(results.window)
            if not np.allclose(outcome.S, stored[rows[~lost]], rtol=1e-3):
                warn("the paths do not have the stored S: the results are of another version or machine")
        paths = outcome if outcome and outcome.trajectories else None  # none of a law that never intervenes
        folder = Path(args.output or f"{args.folder}/scenarios")
        written = export_scenarios(scenarios, folder, True, paths, setup, args.reference, args.format, design.label)
    say(console(), "recorded paths" if args.recorded else design.label, *(f"  {f}: {written[f]}" for f in written))
