"""What a study costs beside the closed loop, and what a second process gains; prints, asserts nothing.

Run with ``python tests/benchmarks/study_overhead.py`` on a machine that does nothing else. Shares and ratios are of one
run: the time inside the compiled loop over the wall time of `run_study`, one process over two. Each study runs once
before it is timed, so that nothing compiles. The named reference of the second part is the same study in one process.
"""

import contextlib
import tempfile
import time
from collections.abc import Iterator

from history import report

from ldctoolkit.simulation.kernel import entry
from ldctoolkit.studies import Study, run_study

LINEAR = {
    "name": "linear",
    "scenarios": {"left": 1000, "right": 1000},
    "ranking": {"finalists": 0},
    "design": [
        {
            "law": "preview_proportional",
            "y_s": 0.1,
            "gains": {
                "K_y": {"from": -0.04, "to": -0.002, "count": 25},
                "K_psi": {"from": -0.35, "to": -0.1, "count": 40},
            },
        }
    ],
}

MPC = {
    "name": "mpc",
    "scenarios": {"left": 1000, "right": 1000},
    "ranking": {"finalists": 0},
    "design": [{"law": "linear_mpc", "y_s": [0.05, 0.1], "gains": {"r_delta": {"from": 50, "to": 5000, "count": 20}}}],
}

compiled = 0.0


@contextlib.contextmanager
def watched() -> Iterator[None]:
    """The time inside the compiled loop of this process is summed up."""
    loop = entry.drive_lanes

    def timed(*words: object) -> object:
        global compiled
        started = time.perf_counter()
        try:
            return loop(*words)
        finally:
            compiled += time.perf_counter() - started

    entry.drive_lanes = timed
    try:
        yield
    finally:
        entry.drive_lanes = loop


def timed_study(study: Study, workers: int) -> float:
    with tempfile.TemporaryDirectory() as folder, watched():
        started = time.perf_counter()
        run_study(study, directory=folder, workers=workers, progress=False)
        return time.perf_counter() - started


def overhead() -> None:
    global compiled
    print("1,000 linear designs x 2,000 scenarios")
    for workers in (1, 2):
        for attempt in range(3):
            compiled = 0.0
            wall = timed_study(Study.from_dict(LINEAR), workers)
            shares = f", compiled loop {compiled / wall:6.1%}" if workers == 1 else ""
            start = ", workers started" if workers > 1 and attempt == 0 else ""
            print(f"  {workers} process(es): {wall:6.2f} s{shares}{start}")


def speedup() -> None:
    print("40 designs of linear_mpc x 2,000 scenarios")
    study = Study.from_dict(MPC)
    walls = {}
    for workers in (1, 2, 1, 2):
        wall = timed_study(study, workers)
        walls.setdefault(workers, []).append(wall)
        print(f"  {workers} process(es): {wall:6.2f} s")
    report("second runs", walls[1][1] / walls[2][1])
    report("first runs, workers started", walls[1][0] / walls[2][0])
    print(f"  two over one, second runs: {walls[1][1] / walls[2][1]:.2f} times faster")
    print(f"  two over one, first runs, workers started: {walls[1][0] / walls[2][0]:.2f} times faster")


if __name__ == "__main__":
    overhead()
    speedup()
