"""``ldc sample``: draw scenarios from a scenario model."""

from __future__ import annotations

import argparse

from ldctoolkit.errors import InputError
from studies.cli._console import Subparsers, condition, each_once, output_file, warn, whole_number

_MOST = 10_000_000
"""Departures to one side that fit in memory; the same bound as in a study file."""


def add_parser(commands: Subparsers) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "sample",
        help="draw scenarios from a scenario model",
        description="Draw departures from a scenario model and write one row each, left ones first. The same model, "
        "numbers and seed give the same file.",
    )
    parser.add_argument("model", metavar="MODEL", help="bundled model or JSON file")
    parser.add_argument("-n", type=whole_number, metavar="N", help="departures in all, half of them to each side")
    parser.add_argument("--left", type=whole_number, metavar="N", help="departures to the left")
    parser.add_argument("--right", type=whole_number, metavar="N", help="departures to the right")
    parser.add_argument(
        "--given",
        type=condition,
        action="append",
        metavar="NAME=LOW:HIGH",
        help="only departures with this parameter between two values in SI units (an empty end is open), or at one: "
        "NAME=VALUE; repeatable",
    )
    parser.add_argument("--seed", type=whole_number, default=0, metavar="N", help="random seed (default: 0)")
    parser.add_argument("-o", "--output", required=True, metavar="FILE", help="table to write, .parquet or .csv")
    parser.set_defaults(run=run)


def run(chosen: argparse.Namespace) -> None:
    """Carry the command out."""
    from ldctoolkit.scenario_model import load_model
    from ldctoolkit.scenario_model.model import outside_fit
    from studies.storage.files import scenario_table, stored_file, write_parquet

    target = output_file(chosen.output, ".parquet", ".csv")
    left, right = _numbers(chosen)
    each_once("--given", chosen.given)
    given = dict(chosen.given or ())
    model = load_model(chosen.model)
    table = scenario_table(model.sample(left, right, seed=chosen.seed, given=given))
    for text in outside_fit(model, given):
        warn(text)
    if target.suffix.lower() == ".parquet":
        write_parquet(target, table)
    else:
        with stored_file(target) as stream:
            table.write_csv(stream)
    print(f"{left} left and {right} right departures written to {target}")


def _numbers(chosen: argparse.Namespace) -> tuple[int, int]:
    if chosen.n is None:
        left, right = chosen.left or 0, chosen.right or 0
    elif chosen.left is None and chosen.right is None:
        left, right = (chosen.n + 1) // 2, chosen.n // 2
    else:
        raise InputError("-n goes with neither --left nor --right")
    if max(left, right) > _MOST:
        raise InputError(f"{max(left, right)} departures to one side; allowed: up to {_MOST}")
    if left + right == 0:
        raise InputError("no departures asked for: give -n, or --left and --right")
    return left, right
