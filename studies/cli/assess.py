"""``ldc assess``: designs in the tests of regulations and Euro NCAP."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from ._console import Subparsers, console, law_with_gains, named, number, print_table, progress_bar, say

if TYPE_CHECKING:
    from ldctoolkit.control import Controller
    from ldctoolkit.setup import Setup

    from ..assessment import Assessment

FAILS = 3  # exit code where a cell fails as stated

Subject = tuple[str, "Controller", float, "Setup"]  # Name, law, y_s, and how it is driven


def add_parser(commands: Subparsers) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "assess",
        help="run designs through the tests of regulations and Euro NCAP",
        description="Run designs through the cells of standards: departures that do not return, as stated and at the "
        "corners of their tolerances, on several vehicles. Prints a score each, and writes what is predicted of every "
        "cell. Exit code 3 where a cell fails as stated.",
    )
    add = parser.add_argument
    add(
        "designs", nargs="+", metavar="DESIGN",
        help="a study (name in the catalog or TOML file: all its designs), a folder that ldc run wrote (the design "
        "that its verdict names), or the name of a law",
    )  # fmt: skip
    add(
        "--standard", action="append", metavar="NAME",
        help="name of a test, or a TOML file with one (default: all of the catalog); repeatable",
    )  # fmt: skip
    add("--design", dest="only", action="append", metavar="LABEL", help="only this design of a study: label or id")
    add("--gain", type=named, action="append", metavar="NAME=VALUE", help="a gain of a law that is named; repeatable")
    add("--y-s", type=number, metavar="M", help="trigger threshold of a law that is named in m (default: -0.4)")
    add(
        "--plant", default="road-edge", metavar="STUDY",
        help="study whose plant and vehicle a law that is named is driven with (default: %(default)s)",
    )  # fmt: skip
    add("--no-tolerances", action="store_true", help="cells as stated only")
    add("-o", "--output", metavar="DIR", help="write DIR/assessment.html and DIR/predictions.csv")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Carry the command out; the exit code says whether a cell fails."""
    from ldctoolkit.errors import InputError

    from ..assessment import assess, write_predictions
    from ..pages.assessment_section import condition_sentences, score_text, scores, write_assessment_page
    from ..standards import load_standard, standard_names
    from ..storage.folder_files import output_folder

    tests = [load_standard(name) for name in dict.fromkeys(args.standard or standard_names())]
    subjects = [assessment for text in args.designs for assessment in _subjects(text, args)]
    if not subjects:
        raise InputError(" ".join(args.designs), "holds no design that intervenes", allowed="one or more")
    if args.output is not None:
        output_folder(Path(args.output))
    assessments: list[tuple[str, Assessment]] = []
    with progress_bar("assessing") as advance:
        for name, controller, y_s, setup in subjects:
            for test in tests:
                if advance is not None:
                    advance(len(assessments), len(subjects) * len(tests))
                assessments.append((name, assess(controller, test, setup, y_s=y_s, tolerances=not args.no_tolerances)))
    out = console()
    print_table(scores(assessments), out, narrow=True)
    for _, assessment in assessments if len(assessments) <= len(tests) else []:
        say(out, f"{assessment.standard.name}: {score_text(assessment)}")
        say(out, *(f"  {sentence}" for sentence in condition_sentences(assessment)))
        missed = [i for light in ("red", "amber") for i in range(assessment.cells.n) if assessment.lights[i] == light]
        say(out, *(f"  {assessment.cells.name(i)}: {assessment.lights[i]}: {assessment.reason(i)}" for i in missed[:4]))
        say(out, *(f"  not assessable: {what.what}: {what.why}" for what in assessment.standard.not_assessable))
    if args.output is not None:
        folder = Path(args.output)
        write_predictions(assessments, folder / "predictions.csv")
        page = write_assessment_page(assessments, folder / "assessment.html")
        say(out, f"predictions: {folder / 'predictions.csv'}", f"page: {page}")
    return 0 if all(assessment.passed.all() for _, assessment in assessments) else FAILS


def _subjects(text: str, args: argparse.Namespace) -> Iterator[Subject]:
    """What a name on the command line stands for."""
    from ldctoolkit.errors import InputError, UnknownNameError
    from ldctoolkit.registry import controller_names

    from ..design import Design
    from ..study_file import catalog_names, load_study

    if text in controller_names():
        controller, y_s = law_with_gains(text, args.gain), -0.4 if args.y_s is None else args.y_s
        yield Design.of(controller, y_s).label, controller, y_s, load_study(args.plant).setup()
        return
    if args.gain or args.y_s is not None:
        raise InputError("--gain, --y-s", "need the name of a law", hint=f"{text} has its own designs")
    from ._results import is_folder, study_of

    if not (is_folder(text) or text in catalog_names() or text.endswith(".toml")):
        names = (*controller_names(), *catalog_names())
        raise UnknownNameError("design", "is neither a law, a study nor a folder", value=text, allowed=names)
    study, designs, _ = study_of(text, args.only)
    for design in designs:
        if not design.is_baseline:
            yield design.label, design.controller(study.setup().convention), design.y_s, study.setup()
