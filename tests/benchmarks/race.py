"""Racing benchmark: the catalog's sweep as a race against the same study in full, from one run.

For each seed every design is driven on all scenarios: that is the reference. The race then drives anew, round by round,
what it asks for, and has to get the reference's scores within 1e-6 m s: how many scenarios stand beside each other may
show in the last digits, and in an iterative solver's. Printed are the share of scenario runs, the share of time
including the decisions, and whether the full study's winner is kept. Then races among designs next to each other in
rank, on the same tables: the harder case. `--seeds 20` by default, half a minute each."""

import argparse
import itertools
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from closed_loop import machine

sys.path.insert(0, str(Path(__file__).parents[1]))
from helpers import results as helpers_results
from ldctoolkit import Scenarios, load_model
from ldctoolkit.simulation import Takeover, drive_many
from ldctoolkit.studies import Study
from ldctoolkit.studies.design import Design
from ldctoolkit.studies.racing import race_round
from ldctoolkit.studies.results import FAILED_STATUSES
from ldctoolkit.studies.running.tasks import prefix_rows, schedule
from ldctoolkit.studies.study_file import load_study

NEIGHBOURS, CONTESTED = 60, 20


def scores(study: Study, designs: Sequence[Design], scenarios: Scenarios) -> np.ndarray:
    """S as it counts, (d, n): a failed scenario at least as bad as without control."""
    S = np.full((len(designs), len(scenarios)), np.nan)
    order = sorted(range(len(designs)), key=lambda i: designs[i].y_s)
    for y_s, group in itertools.groupby(order, key=lambda i: designs[i].y_s):
        rows = list(group)
        over = Takeover.build(scenarios, study.setup(), y_s=y_s)
        for i, run in zip(rows, drive_many([designs[i].controller() for i in rows], over, threads=1), strict=True):
            outcome = run.outcome("departure")
            failed = np.isin(outcome.status, FAILED_STATUSES)
            S[i] = np.where(failed, np.maximum(outcome.S, outcome.S_uncorrected), outcome.S)
    return S


def race(study: Study, scenarios: Scenarios, seed: int, full: np.ndarray) -> tuple[list[int], np.ndarray, int]:
    """Designs left after each round, those that reach the end, and scenario runs."""
    rounds = schedule(len(scenarios))
    left, runs, alive = np.arange(len(study.designs)), 0, []
    S, before = np.full(full.shape, np.nan), np.zeros(0, dtype=np.int64)
    for number, m in enumerate(rounds, 1):
        rows = prefix_rows(scenarios.side, m)
        new = np.setdiff1d(rows, before)
        S[np.ix_(left, new)] = scores(study, [study.designs[i] for i in left], scenarios.take(new))
        runs += left.size * new.size
        decision = race_round(
            S[np.ix_(left, rows)], scenarios.side[rows], round=number, rounds=len(rounds), seed=seed,
            confidence=study.ranking.confidence, samples=study.ranking.bootstrap, started=len(study.designs),
        )  # fmt: skip
        left, before = left[decision.keep], rows
        alive.append(int(left.size))
    difference = np.nanmax(np.abs(S - full))
    if not difference < 1e-6:
        raise SystemExit(f"the race's scores differ from the reference's by {difference:.2g} m s")
    return alive, left, runs


def contested(full: np.ndarray, side: np.ndarray, seed: int) -> tuple[int, list[float]]:
    """Races among designs next to each other in rank: how many lose the winner, and their shares of runs."""
    rng, order = np.random.default_rng(seed), np.argsort(full.mean(axis=1))
    lost, shares = 0, []
    for number in range(CONTESTED):
        first = int(rng.integers(len(full) - NEIGHBOURS))
        table = full[rng.permutation(order[first : first + NEIGHBOURS])]
        kept, share = helpers_results.race(table, side, seed=number)
        lost += not kept[table.mean(axis=1).argmin()]
        shares.append(share)
    return lost, shares


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    seeds = range(1, parser.parse_args().seeds + 1)
    study = load_study("zoo-sweep")
    wanted = study.scenarios
    model = load_model(wanted.model)
    print(f"{machine('numpy', 'scipy')}\n\n{len(study.designs)} designs, {wanted.left} + {wanted.right} scenarios\n")
    print(
        "| seed | designs after each round | share of runs | share of time | winner kept |",
        "| --- | --- | --- | --- | --- |",
        sep="\n",
    )
    scores(study, study.designs, model.sample(20, 20, seed=0))  # compiles what is compiled
    lost, shares, hard_lost, hard_shares = 0, [], 0, []
    for seed in seeds:
        scenarios = model.sample(wanted.left, wanted.right, seed=seed)
        start = time.perf_counter()
        full = scores(study, study.designs, scenarios)
        between = time.perf_counter()
        alive, kept, runs = race(study, scenarios, seed, full)
        end = time.perf_counter()
        winner = int(full.mean(axis=1).argmin())
        lost += winner not in kept
        shares.append(runs / full.size)
        part = (end - between) / (between - start)
        text = ", ".join(map(str, alive))
        print(f"| {seed} | {text} | {shares[-1]:.2%} | {part:.1%} | {'yes' if winner in kept else 'NO'} |", flush=True)
        more_lost, more = contested(full, scenarios.side, seed)
        hard_lost += more_lost
        hard_shares += more
    print(f"\nwinner lost in {lost} of {len(shares)} races; largest share of runs {max(shares):.2%}, allowed 20 %")
    print(
        f"{NEIGHBOURS} designs next to each other in rank: winner lost in {hard_lost} of {len(hard_shares)} races; "
        f"share of runs {np.mean(hard_shares):.0%} on average"
    )


if __name__ == "__main__":
    main()
