"""Report of a large study: time and peak memory of reading, ranking and ``ldc report``, each a process of its own.

The reference is polars, which reads every column of the same parts and keeps them. A study of linear laws is run first,
1,001 designs on 2,000 scenarios; ``--full`` takes 5,000 on 10,000, which needs 3 GB of disk, 8 GB of memory and some
minutes; ``report_size.py DIR`` measures a study that is there. Memory is also told as a share of what all numbers of
the parts take. A machine that does something else gives other times."""

import dataclasses
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from closed_loop import machine
from history import report

from ldctoolkit.studies import Study, run_study
from ldctoolkit.studies.storage.manifest import read_manifest

COLUMNS = 12  # numbers a run of a study with one window

POLARS = "import sys, polars; polars.read_parquet(sys.argv[1] + '/results/part-*.parquet')"
READ = "import sys; from ldctoolkit.studies import read_results; read_results(sys.argv[1])"
RANK = (
    "import sys; from ldctoolkit.studies.ranking.ranking import rank_study; "
    "from ldctoolkit.studies.storage.store import Store; "
    "store = Store.open(sys.argv[1]); rank_study(store.results(), store.manifest.read_study())"
)


def large(full: bool) -> Study:
    """A grid of three laws: 5,000 designs, or 1,001."""
    y_s, r_delta = {"from": 0.05, "to": 0.3}, {"from": 10.0, "to": 1000.0, "scale": "log"}
    sizes = {"left": 6_000, "right": 4_000} if full else {"left": 1_200, "right": 800}

    def of(law: str, count: int, **gains: object) -> dict[str, object]:
        return {"law": law, "y_s": {**y_s, "count": count}, "gains": gains}

    K_y, K_psi = {"from": -0.08, "to": -0.005, "count": 15}, {"from": -0.7, "to": -0.1, "count": 16}
    q_psi = {"from": 0.1, "to": 10.0, "count": 10, "scale": "log"}
    designs = [
        {"law": "none"},
        of("preview_proportional", 10 if full else 2, K_y=K_y, K_psi=K_psi),
        of("lqr", 10 if full else 2, r_delta={**r_delta, "count": 25}, q_psi=q_psi),
        of("lqi", 9 if full else 2, r_delta={**r_delta, "count": 11 if full else 10}),
    ]
    return Study.from_dict({"name": "large", "seed": 1, "scenarios": sizes, "design": designs})


@dataclasses.dataclass(frozen=True)
class Cost:
    """Of one process: wall and processor time [s], peak of its memory [MiB]."""

    wall: float
    processor: float
    peak: float


def cost(*command: str) -> Cost:
    """Run a command to its end."""
    started = time.perf_counter()
    process = subprocess.Popen([sys.executable, *command], stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        sys.exit(f"{' '.join(command)}: ended with {process.returncode}")
    return Cost(time.perf_counter() - started, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024)


def measure(folder: Path) -> None:
    """Print the table of one study."""
    study = read_manifest(folder).read_study()
    runs = len(study.designs) * (study.scenarios.left + study.scenarios.right)
    room = runs * COLUMNS * 8 / 2**20
    print(machine("numpy", "polars"))
    print(f"\n{len(study.designs):,} designs, {runs:,} runs, {room:,.0f} MiB of numbers.\n")
    print("| | wall [s] | processor [s] | peak [MiB] | share of the numbers | processor time over polars |")
    print("| --- | ---: | ---: | ---: | ---: | ---: |")
    stages = {
        "polars reads every column": ("-c", POLARS, str(folder)), "`read_results`": ("-c", READ, str(folder)),
        "and `rank_study`": ("-c", RANK, str(folder)), "`ldc report`": ("-m", "ldctoolkit", "report", str(folder)),
    }  # fmt: skip
    reference = None
    for name, command in stages.items():
        used = cost(*command)
        reference = reference or used
        report(f"processor time over polars: {name}", used.processor / reference.processor)
        print(
            f"| {name} | {used.wall:.1f} | {used.processor:.1f} | {used.peak:,.0f} | {100 * used.peak / room:.0f} % | "
            f"{used.processor / reference.processor:.1f} |",
            flush=True,
        )
    print(f"\nreport.html: {(folder / 'report.html').stat().st_size / 1e6:.2f} MB")


def main() -> None:
    """Measure a study that is there, or make one."""
    full = ["--full"] if "--full" in sys.argv else []
    words = [word for word in sys.argv[1:] if word != "--full"]
    if words[:1] == ["--make"]:
        run_study(large(bool(full)), directory=words[1])
    elif words:
        measure(Path(words[0]))
    else:
        with tempfile.TemporaryDirectory() as scratch:
            # not here: the peak of a process counts what its parent needed
            cost(__file__, "--make", scratch, *full)
            measure(Path(scratch))


if __name__ == "__main__":
    main()
