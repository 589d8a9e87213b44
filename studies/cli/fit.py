"""``ldc fit``: a departures table in, a scenario model out."""

from __future__ import annotations

import argparse

from studies.cli._console import Subparsers, whole_number


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
        "--components", type=components, default=None, metavar="K", help="K, or a range such as 1:10 (default: 1:10)"
    )
    parser.add_argument("--seed", type=whole_number, default=0, metavar="N", help="random seed (default: 0)")
    parser.set_defaults(run=run)


def components(text: str) -> tuple[int, ...]:
    """``5`` or ``1:10`` (both ends included) as numbers of components."""
    first, colon, last = text.partition(":")
    try:
        low, high = whole_number(first), whole_number(last if colon else first)
    except argparse.ArgumentTypeError:
        low, high = 0, 0
    if not 1 <= low <= high <= 100:
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: K or FIRST:LAST, from 1 to 100")
    return tuple(range(low, high + 1))


def run(chosen: argparse.Namespace) -> None:
    """Carry the command out."""
    raise NotImplementedError
