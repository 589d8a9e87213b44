"""``ldc run``: run a study, print its ranking, write its report."""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import time
from pathlib import Path
from typing import Any, Final, TextIO

from ldctoolkit.errors import InputError

from ..running.dispatch import Progress
from ._console import Subparsers, add_report_options, number, positive_number, progress_bar, warn, whole_number


def add_parser(commands: Subparsers) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "run",
        help="run a study: rank designs, write the report",
        description="Run every design of a study on the same scenarios. Writes report.html, figures/, ranking.csv, "
        "ranking.md and, where the study asks for it, paper.html into DIR; running again into the same DIR computes "
        "only what is missing. Exit code 3: done, but the law of some design failed; the ranking and the report name "
        "it.",
    )
    names = "driver, ideal, paper, reality, road-edge, trigger-and-gains, zoo, zoo-sweep"
    about = f"name in the catalog ({names}) or a TOML file"
    parser.add_argument("study", nargs="?", metavar="STUDY", help=about)
    parser.add_argument("-o", "--output", metavar="DIR", help="folder of the results (default: out/<study name>)")
    parser.add_argument("--model", metavar="MODEL", help="scenario model instead of the study's: a name or a JSON file")
    about = "rank designs on these recorded departures themselves; with --model, score the finalists on them too"
    parser.add_argument("--departures", metavar="DEPARTURES.parquet", help=about)
    about = "drive a vehicle this wide in m (default: that of the recordings behind the model, else the study's)"
    parser.add_argument("--vehicle-width", type=number, metavar="W", help=about)
    parser.add_argument("--workers", type=positive_number, metavar="N", help="processes (default: all cores)")
    about = "run on the Dask scheduler at tcp://host:8786, or on a cluster of this machine: local"
    parser.add_argument("--dask", metavar="ADDRESS", help=about)
    about = "seconds after which a task is given up and the scenario at fault is found (default: 600; 0: none)"
    parser.add_argument("--time-limit", type=number, metavar="S", help=about)
    about = "models refitted to resampled recordings, for what these leave open (default: %(default)s; 0: none)"
    parser.add_argument("--refits", type=whole_number, default=20, metavar="N", help=about)
    parser.add_argument("--top", type=positive_number, default=10, metavar="N", help="rows to print (default: 10)")
    about = "add designs beyond the end of a sweep while the winner lies there (default: as the study says)"
    parser.add_argument("--extend", action=argparse.BooleanOptionalAction, help=about)
    add_report_options(parser)
    parser.add_argument("--quiet", action="store_true", help="no progress bar and no table")
    about = "one JSON object a line on stdout: progress, then the result; no bar and no table"
    parser.add_argument("--json", action="store_true", help=about)
    parser.set_defaults(run=run)


_NEXT: Final = """STUDY is missing: a name in the catalog, or a TOML file
  in the catalog: {}
  ldc run trigger-and-gains                runs one of them
  ldc init trigger-and-gains -o my.toml    writes it to a file, with a comment at every key
  ldc run my.toml                          runs that file"""

SOME_FAILED = 3  # exit code where the study has results, but not of every design


def run(args: argparse.Namespace) -> int:
    """Carry the command out."""
    import ldctoolkit.compiling as compiling

    if args.study is None:
        from ..study_file import catalog_names

        raise InputError(_NEXT.format(", ".join(catalog_names())))
    with progress_bar("loading the toolkit", show=not (args.quiet or args.json)):
        from .. import runner  # noqa: F401 - this takes its time

        progress = Lines(sys.stdout) if args.json else Progress() if args.quiet else None
    with contextlib.nullcontext() if progress is None else compiling.shown_by(progress.compiling):
        return _run(args, progress)


_LINE_EVERY: Final = 1.0  # seconds between lines


class Lines(Progress):
    """One JSON object a line: stage, scenario runs done and in all, rate and seconds left; or the name of a phase."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._name, self._total, self._done = "", 0, 0
        self._phases: set[str] = set()
        self._started = self._reported = time.monotonic()

    def phase(self, name: str) -> None:
        """Write its name, the first time."""
        if name not in self._phases:
            self._phases.add(name)
            self._write({"event": "phase", "phase": name})

    def stage(self, name: str, total: int) -> None:
        """Write the first line of a stage."""
        self._name, self._total, self._done = name, total, 0
        self._started = time.monotonic()
        self._report()

    def advance(self, runs: int) -> None:
        """Write a line if the last one is old, or this is the stage's last."""
        self._done += runs
        if self._done >= self._total or time.monotonic() - self._reported > _LINE_EVERY:
            self._report()

    def _report(self) -> None:
        self._reported = time.monotonic()
        seconds = self._reported - self._started
        rate = self._done / seconds if self._done and seconds > 0 else None
        self._write({
            "event": "progress",
            "stage": self._name,
            "done": self._done,
            "total": self._total,
            "runs_per_s": None if rate is None else round(rate, 1),
            "seconds_left": None if rate is None else round((self._total - self._done) / rate, 1),
        })  # fmt: skip

    def _write(self, line: dict[str, Any]) -> None:
        self._stream.write(json.dumps(line) + "\n")
        self._stream.flush()


def _run(args: argparse.Namespace, progress: Progress | None) -> int:
    from ldctoolkit.scenario_model.model import ScenarioModel, misleading, outside_fit

    from ..runner import TIME_LIMIT, run_study, study_source
    from ..storage.manifest import read_manifest
    from ..storage.scenario_source import with_counts, with_recorded_widths
    from ..study_file import load_study
    from ._results import Judged, json_summary, print_ranking, source_departures, write_files

    study = load_study(args.study)
    if args.departures is not None:
        table = {"departures": str(Path(args.departures).absolute()), "table": ""}
        alone = {} if args.model is not None else {"model": "", "left": None, "right": None}
        study = study.changed(scenarios=table | alone)
    source = study_source(study, args.model)
    study = with_counts(with_recorded_widths(study, source, args.vehicle_width), source)
    model = source if isinstance(source, ScenarioModel) else None
    if model is not None:
        for text in (*outside_fit(model, study.scenarios.given), *misleading(model)):
            warn(text)
    report_source = source_departures(args.source)
    folder = Path(args.output or Path("out") / study.name)
    results = run_study(
        study,
        directory=folder,
        model=args.model if model is not None else source,
        workers=args.workers,
        dask=args.dask,
        progress=progress,
        time_limit=TIME_LIMIT if args.time_limit is None else args.time_limit,
        refits=args.refits,
        extend=args.extend,
    )
    manifest, silent = read_manifest(folder), args.quiet or args.json
    study = study.with_content(study.content() | {key: manifest.study[key] for key in ("design", "ranking")})
    judged = Judged.of(
        folder, manifest, study, results, model=model, drive_plants=not args.no_robustness, show=not silent
    )
    if not silent:
        print_ranking(judged, args.top)
        print(
            f"{study.name}: {len(results.designs)} designs x {len(results.scenarios):,} scenarios, "
            f"{manifest.wall_time_s:.1f} s, {study.scenarios.source.lower()} {manifest.model} "
            f"({manifest.model_hash[:12]})"
        )
    # files last: what they are called is the last thing on the screen
    with progress_bar("writing ranking and report", show=not silent):
        files = write_files(judged, source=report_source, figures=not args.no_figures)
    if args.json:
        print(json_summary(judged, files))
    else:
        print("\n".join(f"{name + ':':8} {path}" for name, path in files.items()))
    fresh_failed = results.fresh is not None and results.fresh.failed
    return SOME_FAILED if results.failed or fresh_failed else 0
