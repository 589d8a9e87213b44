"""Run benchmarks, and print the ratio of each case beside the one that the documentation claims.

``python tests/benchmarks/history.py [NAME]... [--keep FILE]``; all benchmarks without names. Each ratio is against a
named reference of the same run, and `claims.toml` has what is claimed. With ``--keep`` every ratio becomes a line of
JSON in FILE, with date, commit, processor and versions, so that a later run can be held against it. Asserts nothing:
ratios move from run to run, by a third on a machine that does other work.
"""

import argparse
import datetime
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
NAMES = (
    "closed_loop", "against_plain_numba", "extraction", "linear_mpc", "mixture", "nonlinear_mpc", "ranking",
    "report_size", "risk", "study_overhead",
)  # fmt: skip


def report(case: str, ratio: float) -> None:
    """Called by a benchmark for each of its ratios; counts where this file runs the benchmark."""
    if path := os.environ.get("LDC_RATIOS"):
        with Path(path).open("a", encoding="utf-8") as file:
            file.write(json.dumps({"case": case, "ratio": float(ratio)}) + "\n")


def claims() -> dict[str, dict[str, Any]]:
    """Of each benchmark the ratios that are claimed, by case."""
    return tomllib.loads((HERE / "claims.toml").read_text(encoding="utf-8"))


def claimed(claim: Any) -> float | None:
    """A claim is the number that a table of the documentation has, or ``{ratio, text}`` with the words of a page."""
    return claim["ratio"] if isinstance(claim, dict) else claim


def run(name: str) -> list[dict[str, Any]]:
    """The ratios that a benchmark reports; what it prints is shown."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ratios"
        path.touch()
        subprocess.run([sys.executable, HERE / f"{name}.py"], check=True, env=os.environ | {"LDC_RATIOS": str(path)})
        return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def processor() -> str:
    """Its name where the system tells it, and its architecture."""
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        for line in cpuinfo.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return f"{line.partition(':')[2].strip()}, {platform.machine()}"
    return platform.machine()


def surroundings() -> dict[str, Any]:
    """When, on what, and with what."""
    from ldctoolkit.surroundings import usable_cores
    from ldctoolkit.version import versions

    def git(*words: str) -> str:
        return subprocess.run(["git", *words], cwd=HERE, capture_output=True, text=True, check=False).stdout.strip()

    return {
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "commit": git("rev-parse", "HEAD"),
        "changed": bool(git("status", "--porcelain", "--untracked-files=no")),
        "processor": processor(),
        "cores": usable_cores(),
        "versions": {"python": platform.python_version()} | dict(versions()),
    }


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    asked.add_argument("names", nargs="*", metavar="NAME", help=", ".join(NAMES))
    asked.add_argument("--keep", type=Path, metavar="FILE", help="file that the ratios are appended to")
    chosen = asked.parse_args()
    if unknown := set(chosen.names) - set(NAMES):
        asked.error(f"no benchmark {', '.join(sorted(unknown))}")
    about, failed, table = surroundings(), [], []
    for name in chosen.names or NAMES:
        print(f"\n## {name}\n", flush=True)
        started = time.perf_counter()
        try:
            found = run(name)
        except subprocess.CalledProcessError:
            failed.append(name)
            continue
        seconds = round(time.perf_counter() - started, 1)
        for row in found:
            claim = claimed(claims().get(name, {}).get(row["case"]))
            table.append(f"| {name} | {row['case']} | {row['ratio']:.3g} | {'' if claim is None else f'{claim:g}'} |")
            if chosen.keep:
                chosen.keep.parent.mkdir(parents=True, exist_ok=True)
                with chosen.keep.open("a", encoding="utf-8") as file:
                    line = about | {"benchmark": name, "seconds": seconds} | row | {"claim": claim}
                    file.write(json.dumps(line) + "\n")
    print("\n| benchmark | case | ratio | claimed |\n| --- | --- | ---: | ---: |", *table, sep="\n")
    if failed:
        sys.exit(f"failed: {', '.join(failed)}")


if __name__ == "__main__":
    main()
