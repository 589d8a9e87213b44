"""Whether the present tree computes the numbers of a base commit, bit for bit.

    python tools/same_numbers.py BASE [--scenarios N] [--studies NAME ...]

Both trees make, with the same files and on this machine, a departures table, a scenario model, and all studies of the
base commit's catalog; then everything that holds numbers is compared by content: columns by their names, rows by their
keys, NaN equal to NaN. Measured times and the texts around the numbers do not count. Exit code 1 if anything differs.
A base study with several windows and conventions is compared with one study here for each of their combinations.

There are no stored results to compare with, since processors differ in the last bit. What the base commit made is kept
in out/same-numbers/, so that one base can be used many times.
"""

from __future__ import annotations

import argparse
import csv
import dataclasses
import itertools
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

ROOT = Path(__file__).resolve().parent.parent
KEPT = ROOT / "out" / "same-numbers"

MEASURED = {"law_time_us"}
"""Columns of ranking.csv that are measured times."""

ABOUT_THE_RUN = {
    "checksum", "created", "versions", "version", "toolkit", "seconds", "duration_s", "path", "paths", "file", "files",
}  # fmt: skip
"""Keys of a model file that tell when, where and with what it was made."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("base", metavar="BASE", help="commit to compare with")
    parser.add_argument("--scenarios", type=int, default=6, metavar="N", help="of each side in a study (default: 6)")
    parser.add_argument("--studies", nargs="*", metavar="NAME", help="of the base's catalog (default: all)")
    chosen = parser.parse_args()

    commit = git("rev-parse", "--verify", f"{chosen.base}^{{commit}}")
    place = KEPT / f"{commit[:12]}-{chosen.scenarios}"
    tree = worktree(commit)
    catalog = {path.stem: path for path in sorted((tree / "studies" / "catalog").glob("*.toml"))}
    names = chosen.studies or list(catalog)
    inputs = place / "inputs"
    studies = list(write_inputs(inputs, {name: catalog[name] for name in names}, chosen.scenarios))

    base, here = place / "base", place / "here"
    shutil.rmtree(here, ignore_errors=True)
    make(base, tree, inputs, names)
    make(here, ROOT, inputs / "here", [study.name for study in studies])
    differences = list(compare(base / "model", here / "model", Compared("model")))
    differences += [text for study in studies for text in compare(base / study.base, here / study.name, study)]
    print(*differences, sep="\n", end="\n" if differences else "")
    print(f"{len(differences)} differences from {commit[:12]}" if differences else f"the numbers of {commit[:12]}")
    return 1 if differences else 0


def git(*words: str) -> str:
    return subprocess.run(["git", "-C", ROOT, *words], check=True, capture_output=True, text=True).stdout.strip()


def worktree(commit: str) -> Path:
    place = KEPT / "trees" / commit[:12]
    if not place.exists():
        git("worktree", "prune")
        git("worktree", "add", "--detach", str(place), commit)
    return place


@dataclasses.dataclass(frozen=True)
class Compared:
    """A study here, and what it is compared with."""

    name: str
    base: str = ""  # Name in the base
    window: str = "departure"
    convention: str = "consistent"
    whole: bool = True  # Whether it is the first combination, whose finalists the base drove


def write_inputs(folder: Path, studies: dict[str, Path], scenarios: int) -> Iterator[Compared]:
    (folder / "here").mkdir(parents=True, exist_ok=True)
    for where in (folder, folder / "here"):
        (where / "recordings.csv").write_text("".join(recordings()), encoding="utf-8")
    for name, path in studies.items():
        # a base may race; here all designs run
        text = re.sub(r"(?m)^race = .*\n", "", path.read_text(encoding="utf-8"))
        for key in ("left", "right"):
            text = re.sub(rf"(?m)^{key} = \d+", f"{key} = {scenarios}", text)
        (folder / f"{name}.toml").write_text(text, encoding="utf-8")
        simulation = tomllib.loads(text).get("simulation", {})
        windows, conventions = (
            [values] if isinstance(values := simulation.get(key, default), str) else values
            for key, default in (("window", "departure"), ("convention", "consistent"))
        )
        for i, (window, convention) in enumerate(itertools.product(windows, conventions)):
            study = Compared(f"{name}-{window}-{convention}" if i else name, name, window, convention, not i)
            for key, value in (("window", window), ("convention", convention)):
                text = re.sub(rf"(?m)^{key} = .*", f'{key} = "{value}"', text)
            (folder / "here" / f"{study.name}.toml").write_text(text, encoding="utf-8")
            yield study


def recordings(count: int = 160) -> Iterator[str]:
    """Drives of one departure each, alternating sides, in bends, the speed changing."""
    random = np.random.default_rng(7)
    yield "recording,t,lane_offset,lane_width,speed,curvature\n"
    for i in range(count):
        T, peak, v, c = random.uniform(1, 4), random.uniform(0.1, 0.6), random.uniform(15, 35), random.normal(0, 1e-3)
        t = np.arange(0.0, 8.0, 0.1)
        y = np.maximum(peak * (1 - (2 * (t - 4) / T) ** 2), -0.6) + 0.9 + 0.01 * random.normal(size=t.size)
        speed = v + 0.1 * random.normal(size=t.size) + 0.1 * random.normal() * t
        bend = c + 1e-4 * random.normal() * t
        for row in zip(t, (-1) ** i * y, speed, bend, strict=True):
            yield "r{},{:.2f},{:.4f},3.6,{:.4f},{:.7f}\n".format(i, *row)


def make(folder: Path, code: Path, inputs: Path, names: list[str]) -> None:
    model = folder / "model"
    model.mkdir(parents=True, exist_ok=True)
    if not (model / "model.json").exists():
        ldc(code, "extract", inputs / "recordings.csv", "-o", model / "departures.parquet", "--workers", 1)
        ldc(code, "fit", model / "departures.parquet", "-o", model / "model.json", "--components", "1:3", "--no-page")
    for name in names:
        if not (folder / name / "ranking.csv").exists():
            given = ("--quiet", "--no-figures", "--no-robustness")
            ldc(code, "run", inputs / f"{name}.toml", "-o", folder / name, *given)


def ldc(code: Path, *words: object) -> None:
    print(f"{code.name}: ldc {' '.join(str(word) for word in words[:2])}", file=sys.stderr)
    environment = os.environ | {"PYTHONPATH": str(code), "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "ldctoolkit", *map(str, words)]
    done = subprocess.run(command, cwd=code, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"ldc {' '.join(map(str, words))}: exit code {done.returncode}\n{done.stderr}")


def compare(base: Path, here: Path, study: Compared) -> Iterator[str]:
    name = study.name
    for folder in sorted({path.parent.relative_to(base) for path in base.rglob("*.parquet")}):
        for kind in sorted({path.stem.partition("-")[0] for path in (base / folder).glob("*.parquet")}):
            if study.whole or folder in (Path(), Path("results")):
                one, other = (table(root / folder, kind, study) for root in (base, here))
                yield from (f"{name}: {folder / kind}: {text}" for text in columns(one, other))
    for path in sorted(base.rglob("ranking.csv")) if study.whole else ():
        one, other = (ranking(root / path.relative_to(base), study) for root in (base, here))
        yield from (f"{name}: {path.relative_to(base)}: {text}" for text in columns(one, other))
    if name == "model":
        one, other = (json.loads((root / "model.json").read_text(encoding="utf-8")) for root in (base, here))
        yield from (f"{name}: model.json{text}" for text in values(one, other))


def table(folder: Path, kind: str, study: Compared) -> dict[str, list[Any]]:
    found = pl.concat([pl.read_parquet(path) for path in sorted(folder.glob(f"{kind}*.parquet"))], how="diagonal")
    if "convention" in found.columns:
        found = found.filter(convention=study.convention).drop("convention")
    other = "control" if study.window == "departure" else "departure"
    found = found.drop(f"S_{other}_m_s", f"S_uncorrected_{other}_m_s", strict=False)
    keys = [key for key in ("design", "scenario") if key in found.columns]
    return dict(found.sort(keys).to_dict(as_series=False)) if keys else dict(found.to_dict(as_series=False))


def ranking(path: Path, study: Compared) -> dict[str, list[Any]]:
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    rows = [row for row in rows if (row["window"], row["convention"]) == (study.window, study.convention)]
    return {key: [row[key] for row in rows] for key in rows[0] if key not in MEASURED}


def columns(one: dict[str, list[Any]], other: dict[str, list[Any]]) -> Iterator[str]:
    for key in [*one, *(key for key in other if key not in one)]:
        if key not in one or key not in other:
            yield f"column {key} only {'here' if key in other else 'in the base'}"
        elif len(one[key]) != len(other[key]):
            yield f"{len(other[key])} rows, base {len(one[key])}"
            return
        else:
            unlike = [i for i, pair in enumerate(zip(one[key], other[key], strict=True)) if not same(*pair)]
            if unlike:
                i = unlike[0]
                yield f"{key}: {len(unlike)} rows differ; row {i}: {other[key][i]!r}, base {one[key][i]!r}"


def values(one: Any, other: Any) -> Iterator[str]:
    if isinstance(one, dict) and isinstance(other, dict):
        for key in sorted((one.keys() | other.keys()) - ABOUT_THE_RUN):
            if key in one and key in other:
                yield from (f".{key}{text}" for text in values(one[key], other[key]))
            else:
                yield f".{key}: only {'here' if key in other else 'in the base'}"
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for i, pair in enumerate(zip(one, other, strict=True)):
            yield from (f"[{i}]{text}" for text in values(*pair))
    elif not same(one, other):
        yield f": {other!r}, base {one!r}"


def same(one: Any, other: Any) -> bool:
    if isinstance(one, float) and isinstance(other, float):
        return np.float64(one).tobytes() == np.float64(other).tobytes() or (one != one and other != other)
    return type(one) is type(other) and bool(one == other)


if __name__ == "__main__":
    sys.exit(main())
