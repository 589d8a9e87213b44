"""Risk benchmark: chunks that are forgotten against one block that is kept, from one run; throughput and memory.

The reference is the plain way: draw all departures at once, `simulate` each design on them, keep all arrays, count.
Both run in one process with one thread. Memory is the peak of a process of its own, less that of one that drove 1,000
departures. The time of 10,000,000 departures on all cores is extrapolated from a shorter run on them; `--full` drives
them. `--peak WAY N` measures one process and is called by the script itself."""

import argparse
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from closed_loop import machine
from history import report

from ldctoolkit import load_model, simulate
from ldctoolkit.studies.risk import DEPTHS, estimate_risk
from ldctoolkit.studies.study_file import load_study
from ldctoolkit.surroundings import usable_cores

N, SHORT, FULL = 100_000, 1_000_000, 10_000_000
STUDY = load_study("trigger-and-gains")
DESIGN = next(one for one in STUDY.designs if one.law == "lqr" and one.y_s == 0.2)


def chunks(n: int) -> list[int]:
    """Departures beyond each depth."""
    risk = estimate_risk([DESIGN], STUDY, n=n, workers=1, progress=False)
    return [risk.event(DESIGN, f"depth > {x:g} m").count for x in DEPTHS]


def one_block(n: int) -> list[int]:
    """The same of other departures, all kept."""
    drawn = load_model("reference").sample(n // 2, n - n // 2, seed=STUDY.seed)
    both, setup = (STUDY.designs[0], DESIGN), STUDY.setup()
    kept = [simulate(one.controller(), drawn, setup=setup, y_s=one.y_s, threads=1) for one in both]
    return [int(np.sum(kept[1].deepest > x)) for x in DEPTHS]


WAYS = {"chunks": chunks, "one block": one_block}


def peak(way: str, n: int) -> float:
    """Peak memory [MiB] of a process that does so many."""
    words = [sys.executable, __file__, "--peak", way, "-n", str(n)]
    return float(subprocess.run(words, capture_output=True, text=True, check=True).stdout)


def all_cores(n: int) -> float:
    """Seconds of n departures on all cores, worker processes ready."""
    started = time.perf_counter()
    estimate_risk([DESIGN], STUDY, n=n, workers=usable_cores(), progress=False)
    return time.perf_counter() - started


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--full", action="store_true")
    asked.add_argument("--peak", choices=list(WAYS))
    asked.add_argument("-n", type=int, default=N)
    chosen = asked.parse_args()
    if chosen.peak:
        WAYS[chosen.peak](chosen.n)
        # not ru_maxrss, which begins with the memory of the process that started this one
        status = Path("/proc/self/status").read_text()
        print(float(re.findall(r"VmHWM:\s*(\d+) kB", status)[0]) / 1024.0)
        return
    print(machine("numpy", "numba"))
    print(f"\n{DESIGN.label}, realistic plant of {STUDY.name}, and no control; {chosen.n:,} departures.\n")
    print("| way | us a departure | departures beyond 0.3 m | memory [MiB] |\n| --- | ---: | ---: | ---: |")
    seconds = {}
    for way, run in WAYS.items():
        run(1000)
        started = time.perf_counter()
        found = run(chosen.n)
        seconds[way] = time.perf_counter() - started
        memory = peak(way, chosen.n) - peak(way, 1000)
        print(f"| {way} | {1e6 * seconds[way] / chosen.n:.1f} | {found[0]:,} | {memory:.0f} |", flush=True)
    print(f"\nTime of one block over that of chunks: {seconds['one block'] / seconds['chunks']:.2f}.")
    report("one block over chunks", seconds["one block"] / seconds["chunks"])
    all_cores(20_000)
    n = FULL if chosen.full else SHORT
    whole = all_cores(n)
    print(f"{n:,} departures on {usable_cores()} cores: {whole:.0f} s, {n / whole:,.0f} a second", end="")
    print("." if chosen.full else f"; {FULL:,} would take {whole * FULL / n:.0f} s.")


if __name__ == "__main__":
    main()
