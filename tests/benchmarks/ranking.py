"""Ranking benchmark: a million rows in three shapes, time and peak memory, against scipy's bootstrap in the same run.

The reference is `scipy.stats.bootstrap` of the paired mean difference of one design to another, percentile interval, as
many resamples; it takes designs one by one, without sides, without anything simultaneous, and is timed on five designs.
Ours is the whole ranking: intervals of means, of differences to the baseline and to the best, set of best, tails,
metrics, a requirement and the Pareto front. Each shape runs in a process of its own, for its peak memory.
Times are processor time."""

import dataclasses
import resource
import subprocess
import sys
import time
from collections.abc import Callable

import numpy as np
import scipy.stats
from closed_loop import machine
from history import report

from ldctoolkit import Scenarios
from ldctoolkit.metrics import MetricValues
from ldctoolkit.studies import Design, Ranking, StudyResults

SHAPES = ((1_000, 1_000), (100, 10_000), (10_000, 100))
SAMPLES, SOME = 2_000, 5
PARETO = ("S", "needless", "a_y_peak_mean", "effort_mean")


def invented(d: int, n: int) -> StudyResults:
    """Close designs: a depth that all share, and a part of their own."""
    generator = np.random.default_rng(0)
    depth = generator.gamma(1.0, 1.0, n)
    S = (0.3 + 0.02 * generator.random(d))[:, None] * depth + 0.05 * generator.gamma(0.5, 2.0, (d, n))
    metrics = {field.name: generator.gamma(2.0, 1.0, (d, n)).astype(np.float32)
                  for field in dataclasses.fields(MetricValues)}  # fmt: skip
    lqr = Design.from_gains("lqr", 0.1, {})
    rest = (dataclasses.replace(lqr, y_s=0.1 + 1e-5 * i) for i in range(1, d))
    designs = (Design.from_gains("none", 0.1, {}), *rest)
    scenarios = Scenarios.from_arrays(
        T=2.0, d_y=generator.gamma(2.0, 0.3, n), v_mean=20.0, side=np.where(np.arange(n) < 0.6 * n, 1, -1)
    )
    return StudyResults(
        designs,
        scenarios,
        "departure",
        "consistent",
        S=S,
        S_uncorrected=np.broadcast_to(depth, S.shape),
        status=np.zeros((d, n), dtype=np.int8),
        metrics=MetricValues(**metrics),
        failed_solves=np.zeros((d, n), dtype=np.int32),
        law_time=np.zeros(d),
    )


def processor_seconds(run: Callable[[], object], repeats: int) -> float:
    """Best of several runs: what others do on the machine counts little."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        run()
        times.append(time.process_time() - start)
    return min(times)


def one_shape(d: int, n: int) -> None:
    results = invented(d, n)
    start = time.process_time()
    ranking = Ranking.of(results, bootstrap=SAMPLES, pareto=PARETO, require=("a_y_peak_p95 <= 30",))
    first = time.process_time() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024  # of the whole process, in MiB on Linux
    again = processor_seconds(lambda: Ranking.of(results, bootstrap=SAMPLES, pareto=PARETO), 3)
    differences = results.S[1 : 1 + SOME] - results.S[0]

    def reference() -> None:
        for row in differences:
            scipy.stats.bootstrap((row,), np.mean, n_resamples=SAMPLES, method="percentile", batch=100)

    theirs = processor_seconds(reference, 2) / SOME
    report(f"{d:,} x {n:,}", theirs * d / again)
    print(
        f"| {d:,} x {n:,} | {first:.2f} | {again:.2f} | {peak:.0f} | {1e3 * again / d:.2f} | {1e3 * theirs:.1f} | "
        f"{theirs * d / again:.0f} | {int(ranking.inference.set_of_best.sum()):,} |",
        flush=True,
    )


def main() -> None:
    print(machine("numpy", "scipy") + " Processor time.\n")
    print("| designs x scenarios | first [s] | best of 3 [s] | peak of the process [MiB] | ours a design [ms] | "
          "scipy a design [ms] | ratio | set of best |")  # fmt: skip
    print("| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |", flush=True)
    for d, n in SHAPES:
        subprocess.run([sys.executable, __file__, str(d), str(n)], check=True)


if __name__ == "__main__":
    if len(sys.argv) == 3:
        one_shape(int(sys.argv[1]), int(sys.argv[2]))
    else:
        main()
