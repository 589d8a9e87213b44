"""The job by every peer, S compared, the tables of `docs/explanation/comparison.md` written: run it by itself.

A peer whose packages this interpreter does not have gets an environment of its own below `out/peers`, made once by pip.
Each script runs three times, one process at a time with one thread, and the best times count. `results.json` and the
page are written; with the argument `--table` only the page is, from the results that are there. The exit status is 1
where the mean S of a peer is further from ours than `AGREE` says.
"""

import argparse
import datetime
import importlib.metadata
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
import venv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
ROOT = HERE.parents[2]
RESULTS, PAGE = HERE / "results.json", ROOT / "docs/explanation/comparison.md"
MARKS = "<!-- written by tests/benchmarks/peers/run.py -->\n", "<!-- end of what it writes -->\n"
SCRIPTS = {  # in the order of the table's columns
    "here": (),
    "do_mpc_numpy": ("do-mpc",),
    "python_control": ("control", "osqp"),
    "commonroad_loop": ("commonroad-control",),
}
# largest difference of the mean of S from ours, relative; CommonRoad's vehicle drives in the plane
AGREE = {"do-mpc + NumPy": 1e-5, "python-control": 1e-5, "CommonRoad control": 1e-3}
REPEATS, SIDE, SEED = 3, 100, 1
LAWS = {"none": "no control", "lqr": "LQR", "mpc": "MPC"}


def interpreter(script: str, packages: tuple[str, ...]) -> Path:
    """One that has the packages: this one, or that of an environment below `out/peers`."""
    try:
        for name in packages:
            importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        folder = ROOT / "out" / "peers" / script
        python = folder / ("Scripts" if os.name == "nt" else "bin") / "python"
        if not (folder / "installed").exists():
            venv.create(folder, with_pip=True)
            subprocess.run([python, "-m", "pip", "install", "--quiet", "scipy", *packages], check=True)
            (folder / "installed").touch()
        return python
    return Path(sys.executable)


def measured(script: str, python: Path, folder: Path, **environment: str) -> dict[str, Any]:
    """The line that a script prints."""
    threads = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
    command = [python, HERE / f"{script}.py", folder / "departures.npz", folder / f"{script}.npz"]
    path = {"PYTHONPATH": str(ROOT)} if script == "here" else {}
    done = subprocess.run(
        command, env=os.environ | threads | path | environment, stdout=subprocess.PIPE, text=True, check=True
    )
    record: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return record


def best(records: list[dict[str, Any]]) -> dict[str, Any]:
    """One record with the least of all times."""
    one = dict(records[0])
    for times in ("seconds", "first"):
        one[times] = {law: min(record[times][law] for record in records) for law in one[times]}
    if "study_seconds" in one:
        one["study_seconds"] = min(record["study_seconds"] for record in records)
    return one


def processor() -> str:
    """Its name, where the system tells it."""
    info = Path("/proc/cpuinfo")
    names = [line.partition(": ")[2] for line in info.read_text().splitlines() if line.startswith("model name")]
    return f"{names[0] if names else platform.processor()}, {platform.machine()}, {os.cpu_count()} cores"


def measure(folder: Path) -> dict[str, Any]:
    """Results of all peers."""
    import ldctoolkit as ldc

    drawn = ldc.load_model("reference").sample(SIDE, SIDE, seed=SEED)
    columns = ("T", "d_y", "v_mean", "a_mean", "c_0", "dc", "side")
    np.savez(folder / "departures.npz", **{name: getattr(drawn, name) for name in columns})
    peers = []
    for script, packages in SCRIPTS.items():
        python = interpreter(script, packages)
        print(f"{script}: {REPEATS} runs", file=sys.stderr, flush=True)
        start = time.perf_counter()
        record = best([measured(script, python, folder) for _ in range(REPEATS)])
        if script == "here":
            cold = measured(script, python, folder, NUMBA_CACHE_DIR=str(folder / "cache"))
            record["compiling"] = round(sum(cold["first"].values()) - sum(record["first"].values()), 1)
        print(f"{json.dumps(record)}\n{time.perf_counter() - start:.0f} s", file=sys.stderr, flush=True)
        scores = np.load(folder / f"{script}.npz")
        ours = np.load(folder / "here.npz")
        record["largest_difference"] = {law: float(np.abs(scores[law] - ours[law]).max()) for law in scores.files}
        peers.append(record)
    day = datetime.datetime.now(datetime.UTC).date().isoformat()
    return {"day": day, "processor": processor(), "departures": drawn.n, "peers": peers}


def far(results: dict[str, Any]) -> list[str]:
    """Peers and laws whose mean S is not ours."""
    ours = results["peers"][0]["mean_S"]
    return [
        f"{one['peer']}, {LAWS[law]}: mean S {S}, ours {ours[law]}"
        for one in results["peers"][1:]
        for law, S in one["mean_S"].items()
        if abs(S / ours[law] - 1.0) > AGREE[one["peer"]]
    ]


def number(value: float | None, digits: int = 2) -> str:
    """A time to two significant digits."""
    return "" if value is None else f"{float(f'{value:.{digits}g}'):g}"


CONTAINS = """
| departures like the recorded ones | [model](scenario-model.md) fitted to recordings | to write | to write | scenarios of recorded traffic |
| intervals for all designs at once | [yes](statistics.md) | to write | to write | to write |
| acceleration, jerk, steering, way back | [yes](../reference/metrics.md) | to write | to write | part of it |
| requirements: accepted or refused | [yes](../how-to/my-requirements.md) | to write | to write | to write |
| Euro NCAP, UN R79, ISO 11270 | [yes](standards.md) | to write | to write | to write |
| actuator, camera, tyres, mismatch | [options](plant-options.md) | in your model | in your model | disturbance and noise models |
| the driver's hands | [yes](driver.md) | to write | to write | to write |
| stability margins | [of each design](../how-to/reviewing-a-design.md) | to write | yes, with plots | to write |
| robust MPC | to write | multi-stage MPC | to write | to write |
| state estimation | Kalman filter of the camera | EKF, moving horizon | Kalman filter, moving horizon | to write |
| C code, tested in the loop | [yes](../how-to/exporting.md) | functions of the problem; IPOPT remains | to write | to write |
| report to read | [yes](../how-to/reading-the-report.md) | plots, animation | plots | plots, animation |
| other tasks | lane departure only | any process | any system | any road, with traffic |
"""  # fmt: skip  # noqa: E501


def tables(results: dict[str, Any]) -> str:
    """What the page shows of the results."""
    ours, *_ = peers = results["peers"]
    said = ours["study"]
    rows: dict[str, Callable[[dict[str, Any]], Any]] = {
        "": lambda one: one["peer"],
        "---": lambda one: "---",
        "lines of code": lambda one: one["lines"],
        "and of what peers share": lambda one: one["lines_shared"] or "",
        "LQR [s]": lambda one: number(one["seconds"]["lqr"]),
        "MPC [s]": lambda one: number(one["seconds"].get("mpc")),
        "first call, LQR [s]": lambda one: number(one["first"]["lqr"]),
        "first call, MPC [s]": lambda one: number(one["first"].get("mpc")),
    }
    for law, title in LAWS.items():
        rows[f"mean S, {title} [m s]"] = lambda one, law=law: (
            f"{one['mean_S'][law]:.5f}" if law in one["mean_S"] else ""
        )
    for law in ("lqr", "mpc"):
        gap = f"largest difference of S, {LAWS[law]} [m s]"
        rows[gap] = lambda one, law=law: number(None if one is ours else one["largest_difference"].get(law))
    table = [f"| {title} | {' | '.join(str(cell(one)) for one in peers)} |" for title, cell in rows.items()]
    used = sorted({item for one in peers for item in one["versions"].items()})
    return (
        "\n".join(table)
        + f"""{CONTAINS}
The ranked study of the three laws takes {number(ours["study_seconds"])} s here; its loops are compiled in
{ours["compiling"]:.0f} s, once on a machine. Beside the same means it says, with 95 % confidence for all designs:

- The LQR's S is {said["S_low"]:.2f} to {said["S_high"]:.2f} m s, its difference from no control {said["low"]:.2f} to
  {said["high"]:.2f} m s.
- The MPC has the least S and misses the requirement `{said["mpc_unmet"]}`: it takes {said["mpc_a_y"]:.1f} m/s².

{results["departures"]} departures; {results["day"]}; {results["processor"]}.
{", ".join(f"{name} {version}" for name, version in used)}.
"""
    )


def write_page(results: dict[str, Any]) -> None:
    """Put the tables between their marks."""
    text = PAGE.read_text(encoding="utf-8")
    first, last = text.index(MARKS[0]) + len(MARKS[0]), text.index(MARKS[1])
    PAGE.write_text(f"{text[:first]}\n{tables(results)}\n{text[last:]}", encoding="utf-8")


def main() -> int:
    parser = argparse.ArgumentParser(description="the same job by every peer")
    parser.add_argument("--table", action="store_true", help="only write the page from the results that are there")
    if not parser.parse_args().table:
        with tempfile.TemporaryDirectory() as folder:
            results = measure(Path(folder))
        RESULTS.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")
    results = json.loads(RESULTS.read_text(encoding="utf-8"))
    write_page(results)
    print(tables(results))
    apart = far(results)
    print(*apart, sep="\n", file=sys.stderr)
    return 1 if apart else 0


if __name__ == "__main__":
    sys.exit(main())
