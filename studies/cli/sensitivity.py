"""``ldc sensitivity``: which gain matters."""

from __future__ import annotations

import argparse
from pathlib import Path

from studies.cli._console import Subparsers, positive_number, progress_bar, warn, whole_number


def add_parser(commands: Subparsers) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "sensitivity",
        help="which gain matters: Sobol indices of S, and a profile around the winner",
        description="Sobol indices of mean S over the designs of a study that was run, and a one-at-a-time profile "
        "around its winner, for which missing designs are driven on the study's scenarios. Prints both and writes "
        "DIR/sensitivity.csv.",
    )
    parser.add_argument("folder", metavar="DIR", help="folder that ldc run wrote")
    for option, kind, default, name, words in (
        ("--design", str, None, "ID", "middle of the profile: a label, an id or its start (default: the winner)"),
        (
            "--points",
            whole_number,
            9,
            "N",
            "values of a number, at least (default: 9); 0: only the study's, none driven",
        ),
        ("--case", positive_number, 1, "N", "which case of the study (default: 1, the primary one)"),
    ):
        parser.add_argument(option, type=kind, default=default, metavar=name, help=words)
    parser.set_defaults(run=run)


def run(chosen: argparse.Namespace) -> None:
    """Carry the command out."""
    from ldctoolkit.errors import InputError
    from studies.cli._results import chosen_designs
    from studies.cli._tables import print_indices, print_profiles
    from studies.ranking.ranking import rank_study
    from studies.sensitivity.sensitivity import sensitivity
    from studies.sensitivity.winner_profile import winner_profile, write_sensitivity
    from studies.storage.store import Store

    store = Store.open(chosen.folder)
    study, results = store.manifest.read_study(), store.results()
    if chosen.case > len(results.cases):
        raise InputError(f"--case {chosen.case}; allowed: 1 to {len(results.cases)}")
    case = chosen.case - 1
    if chosen.design is not None:
        middle, role = chosen_designs(results.designs, [chosen.design])[0], "the chosen design"
    else:
        ranking = rank_study(results, study)[case]
        # without a design that meets the requirements the first one is the one with the smallest mean S
        middle = ranking.designs[ranking.winner or 0]
        role = "smallest mean S, not ranked" if ranking.winner is None else "the winner"
    blocks = sensitivity(results, study, case=case)
    with progress_bar("profile") as advance:
        profiles = winner_profile(results, study, middle, case=case, points=chosen.points, advance=advance)
    path = Path(chosen.folder) / "sensitivity.csv"
    write_sensitivity(blocks, profiles, path)
    which = results.cases[case].case
    if which.window == "control":
        warn("S over the control window starts at the trigger: designs with different y_s are not comparable there")
    print_indices(blocks, which.label, study.ranking.confidence)
    print_profiles(profiles, middle, role, which.label, study.ranking.confidence)
    print(f"sensitivity: {path}")
