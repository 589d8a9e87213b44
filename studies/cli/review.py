"""``ldc review``: check a design before a study."""

from __future__ import annotations

import argparse
import math
from typing import TYPE_CHECKING

from studies.cli._console import (
    Subparsers,
    add_row,
    console,
    interval,
    named,
    new_table,
    number,
    output_file,
    progress_bar,
)

if TYPE_CHECKING:
    import numpy as np

    from ldctoolkit.review import Review

FAULT = 3
"""Exit code where a fault was found."""

Reviewed = list[tuple[str, tuple[str, ...], "Review"]]


def add_parser(commands: Subparsers) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "review",
        help="check a design before a study",
        description="Check a law with its gains, or the designs of a study, before anything is run: closed-loop poles, "
        "gain, phase, delay and disk margins, sampling, limits, conditioning, offset in a bend. Exit code 3 where a "
        "fault was found.",
    )
    parser.add_argument(
        "design",
        metavar="DESIGN",
        help="name of a law, a study (name in the catalog or TOML file), or a folder that ldc run wrote",
    )
    parser.add_argument(
        "--gain", type=named, action="append", metavar="NAME=VALUE", help="a gain of the law; repeatable"
    )
    parser.add_argument("--design", dest="only", metavar="LABEL", help="only this design of the study: its label or id")
    parser.add_argument("--dt", type=_positive, metavar="S", help="sample time in s (default: 0.05, or the study's)")
    parser.add_argument(
        "--speed",
        type=_range,
        metavar="LOW:HIGH",
        help="speeds in m/s (default: 10:40, or those at the study's triggers)",
    )
    parser.add_argument("--points", type=_points, default=13, metavar="N", help="number of speeds (default: 13)")
    for name, meaning in (
        ("delay", "pure delay of the actuator in s"),
        ("lag", "time constant of the actuator in s"),
        ("rate-max", "limit of its rate in rad/s"),
        ("delta-max", "limit of its angle in rad"),
    ):
        parser.add_argument(f"--{name}", type=number, metavar="X", help=f"{meaning} (default: none, or the study's)")
    parser.add_argument("--json", metavar="FILE.json", help="write numbers and findings for machines")
    parser.set_defaults(run=run)


def _positive(text: str) -> float:
    value = number(text)
    if not value > 0:
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: a number > 0")
    return value


def _points(text: str) -> int:
    if not text.isascii() or not text.isdigit() or not 2 <= int(text) <= 1000:
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: a whole number from 2 to 1000")
    return int(text)


def _range(text: str) -> tuple[float, float]:
    """``LOW:HIGH`` or one speed."""
    low, high = interval(text, text) if ":" in text else (number(text),) * 2
    if low is None or high is None or not 0 < low <= high < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: LOW:HIGH, or one speed, 0 < LOW <= HIGH [m/s]")
    return low, high


def run(chosen: argparse.Namespace) -> int:
    """Carry the command out; the exit code says whether there is a fault."""
    from studies.cli._review_designs import reviewed_design, subjects, to_json
    from studies.storage.files import write_text

    target = None if chosen.json is None else output_file(chosen.json, ".json", option="--json")
    wanted = subjects(chosen)
    reviewed: Reviewed = []
    with progress_bar("reviewing") as advance:
        for done, subject in enumerate(wanted):
            if advance is not None:
                advance(done, len(wanted))
            reviewed.append((subject.label, subject.ids, reviewed_design(subject)))
    if len(reviewed) == 1:
        _print_loop(reviewed[0][0], reviewed[0][2])
    else:
        _print_overview(reviewed)
    for label, _, found in reviewed:
        if len(reviewed) > 1:
            print(f"\n{label}")
        for finding in found.findings:
            print(f"{finding.severity}: {finding.sentence}")
        if not found.findings:
            print("nothing to object to")
    if target is not None:
        write_text(target, to_json(reviewed))
        print(f"written to {target}")
    return FAULT if any(found.faults for _, _, found in reviewed) else 0


_COLUMNS = (
    ("v [m/s]", "v", 1.0, ".3g"),
    ("slowest pole [s]", "slowest", 1.0, ".3g"),
    ("damping", "damping", 1.0, ".2f"),
    ("gain margin [dB]", "gain_margin", 1.0, ".1f"),
    ("phase margin [deg]", "phase_margin", 180.0 / math.pi, ".1f"),
    ("delay margin [ms]", "delay_margin", 1000.0, ".0f"),
    ("disk margin", "disk_margin", 1.0, ".2f"),
    ("crossover [rad/s]", "crossover", 1.0, ".3g"),
    ("e_y in a bend [m]", "e_y_bend", 1.0, ".3f"),
    ("other tyres [m]", "e_y_bend_mismatched", 1.0, ".3f"),
)
"""Heading, number of the loop, factor and format."""


def _shown(value: float, factor: float, form: str) -> str:
    if math.isnan(value):
        return "-"
    if math.isinf(value):
        return "inf"
    text = format(value * factor, form)
    return text if float(text) else text.lstrip("-")


def _print_loop(label: str, review: Review) -> None:
    """Every speed of one design."""
    if review.loop is None:
        print(label)
        return
    columns = list(_COLUMNS)
    if not all(map(math.isnan, review.loop.hessian_condition)):
        columns.append(("condition", "hessian_condition", 1.0, ".2g"))
    table = new_table(
        f"{label}, dt = {review.dt:g} s", [heading.replace(" [", "\n[") for heading, *_ in columns], left=()
    )
    for i in range(review.loop.v.size):
        cells = [_shown(float(getattr(review.loop, name)[i]), factor, form) for _, name, factor, form in columns]
        add_row(table, cells, None if review.loop.stable[i] else "red")
    console().print(table)


_WORST = ("gain_margin", "phase_margin", "disk_margin", "e_y_bend", "e_y_bend_mismatched")
"""What is told of a design among others, at its worst speed."""


def _print_overview(reviewed: Reviewed) -> None:
    """One row a design, the worst of all speeds."""
    shown = [column for column in _COLUMNS if column[1] in _WORST]
    headings = ("design", *(column[0] for column in shown), "faults", "warnings")
    table = new_table("worst of all speeds", headings)
    for label, _, review in reviewed:
        cells = ["-"] * len(shown)
        if review.loop is not None and not review.loop.stable.all():
            cells = ["unstable", *cells[1:]]
        elif review.loop is not None:
            loop = review.loop
            cells = [_shown(_worst(getattr(loop, name), name), factor, form) for _, name, factor, form in shown]
        warnings = sum(finding.severity == "warning" for finding in review.findings)
        add_row(table, [label, *cells, str(len(review.faults)), str(warnings)])
    console().print(table)


def _worst(values: np.ndarray, name: str) -> float:
    import numpy as np

    known = values[~np.isnan(values)]
    if not known.size:
        return math.nan
    return float(known.min() if name.endswith("margin") else abs(known).max())
