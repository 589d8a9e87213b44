"""Departures out of big SPMD DAS1 tables: `ldc extract` with two workers, from text on disk to a table on disk.

The tables are made first: DataLane and DataWsu in the real schema, 20 million rows each unless told otherwise, in a
scratch folder that is deleted. Joined rows a second and peak memory (resident, all processes together, shared pages
counted in each) are those of whole commands. The named reference is polars: the same columns of both files read with
`read_csv` and joined with `join_asof`; it finds nothing. Then the command is killed on its way and started again.

Run it on a machine that does nothing else; it prints, and asserts nothing of times and memory. The
exit code is 1 if the second start gives another table. ``--rows`` 1e6 is a quick look."""

import argparse
import hashlib
import os
import platform
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import polars as pl
import psutil

sys.path.insert(0, str(Path(__file__).parents[1]))
from history import report

from helpers import spmd

ROWS_OF_TRIP, TRIPS_OF_BLOCK = 6000, 100  # rows of a trip on average (10 minutes); trips that are made at a time

MIB = 1 << 20

REFERENCE = """
import sys
import polars as pl
lane = pl.read_csv(sys.argv[1] + "/DataLane.csv", columns=sys.argv[2].split(","))
wsu = pl.read_csv(sys.argv[1] + "/DataWsu.csv", columns=sys.argv[3].split(","))
both = lane.join_asof(wsu, on="Time", by=["Device", "Trip"], strategy="nearest", tolerance=5, check_sortedness=False)
print(both.filter(pl.col("SpeedWsu").is_not_null()).height)
"""


def write_big(folder: Path, rows: int) -> int:
    """DataLane and DataWsu of about so many rows, each; returns how many there are."""
    rng = np.random.default_rng(0)
    done = trip = 0
    with (folder / "DataLane.csv").open("wb") as lane, (folder / "DataWsu.csv").open("wb") as wsu:
        while done < rows:
            lengths = np.minimum(rng.integers(1, 2 * ROWS_OF_TRIP, TRIPS_OF_BLOCK), rows - done)
            lengths = lengths[: int(np.searchsorted(np.cumsum(lengths), rows - done)) + 1]
            lengths[-1] = min(int(lengths[-1]), rows - done - int(lengths[:-1].sum()))
            m = int(lengths.sum())
            t = np.arange(m) * 0.1
            # sways, a slow road, and every 90 s or so an edge beyond a line
            bump = 1.0 * np.exp(-(((t % 90.0 - 45.0) / 1.5) ** 2)) * np.where((t // 90.0) % 2 == 0, 1.0, -1.0)
            offset = bump + 0.2 * np.sin(0.9 * t) + 0.02 * rng.standard_normal(m)
            speed = 25.0 + 4.0 * np.sin(0.013 * t) + 0.05 * rng.standard_normal(m)
            yaw_rate = 0.03 * np.sin(0.021 * t) + 0.002 * rng.standard_normal(m)
            heading = np.cumsum(0.1 * yaw_rate)
            quality = np.where(rng.random(m) < 0.02, 0, rng.integers(2, 4, m))
            ends = np.cumsum(lengths)
            pieces = [slice(end - length, end) for end, length in zip(ends.tolist(), lengths.tolist(), strict=True)]
            drives = [
                spmd.Drive(
                    device=10100 + (trip + i) // 200, trip=trip + i, time=10 * np.arange(one.stop - one.start),
                    lane_offset=offset[one], lane_width=3.6, speed=speed[one], yaw_rate=yaw_rate[one],
                    heading=heading[one], quality=quality[one],
                )
                for i, one in enumerate(pieces)
            ]  # fmt: skip
            lane.write(spmd.text_of(spmd.lane_frame(drives), bom=done == 0, header=done == 0))
            wsu.write(spmd.text_of(spmd.wsu_frame(drives), header=done == 0))
            done += m
            trip += len(drives)
    return done


def _cpu_of_children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


class Tree:
    """A command, the memory of it and all its children watched while it runs."""

    def __init__(self, words: list[str], *, threads: int | None = None) -> None:
        environment = os.environ | ({} if threads is None else {"POLARS_MAX_THREADS": str(threads)})
        self.started = time.perf_counter()
        self.process = subprocess.Popen(
            words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment, start_new_session=True
        )
        self.peak = 0
        self.cpu = -_cpu_of_children()
        threading.Thread(target=self._watch, daemon=True).start()

    def _watch(self) -> None:
        try:
            root = psutil.Process(self.process.pid)
            while self.process.poll() is None:
                total = 0
                for one in [root, *root.children(recursive=True)]:
                    try:
                        total += one.memory_info().rss
                    except psutil.Error:
                        continue
                self.peak = max(self.peak, total)
                time.sleep(0.05)
        except psutil.Error:
            return

    def finish(self) -> tuple[float, str]:
        """Seconds that it took, and its output."""
        output, _ = self.process.communicate()
        seconds = time.perf_counter() - self.started
        self.cpu += _cpu_of_children()
        if self.process.returncode:
            raise SystemExit(f"{self.process.args}: exit code {self.process.returncode}\n{output}")
        return seconds, output

    def kill(self) -> None:
        """It and all its children, as a power cut would."""
        os.killpg(self.process.pid, signal.SIGKILL)
        self.process.communicate()


def told(tree: Tree, seconds: float, rows: int) -> str:
    """The figures of one command."""
    speed = f"{rows / seconds / 1e6:5.2f} million joined rows a second"
    return f"{seconds:6.1f} s ({tree.cpu:6.1f} s of CPU), {speed}, peak {tree.peak / MIB:6,.0f} MiB"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=float, default=20e6, help="rows of each table (default: 2e7)")
    parser.add_argument("--folder", type=Path, help="where the scratch folder is made (default: the system's)")
    parser.add_argument("--repeat", type=int, default=2)
    chosen = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="ldc-extraction-", dir=chosen.folder))
    try:
        same = run(folder, int(chosen.rows), chosen.repeat)
    finally:
        shutil.rmtree(folder)
    if not same:
        raise SystemExit(1)


def run(folder: Path, wanted: int, repeat: int) -> bool:
    """Measure and print; whether the command that was killed and started again gave the same table."""
    print(f"{platform.machine()}, Python {platform.python_version()}, polars {pl.__version__}, {os.cpu_count()} cores")
    started = time.perf_counter()
    rows = write_big(folder, wanted)
    size = sum(path.stat().st_size for path in folder.iterdir()) / MIB
    print(f"made {rows:,} rows of each table, {size:,.0f} MiB, in {time.perf_counter() - started:.0f} s")

    from ldctoolkit.recordings.spmd_das1 import LANE, WSU

    key = "Device,Trip,"
    reference = [sys.executable, "-c", REFERENCE, str(folder), key + ",".join(LANE), key + ",".join(WSU)]
    output = folder / "departures.parquet"
    command = [sys.executable, "-m", "ldctoolkit", "extract", "--format", "spmd-das1", str(folder / "DataLane.csv")]
    command += [str(folder / "DataWsu.csv"), "-o", str(output), "--workers", "2"]
    best, digest = float("inf"), ""
    for attempt in range(repeat):
        tree = Tree(reference)
        theirs, said = tree.finish()
        print(f"polars, nothing found:   {told(tree, theirs, int(said))}")
        output.unlink(missing_ok=True)
        tree = Tree(command)
        ours, said = tree.finish()
        best = min(best, ours)
        print(f"ldc extract --workers 2: {told(tree, ours, rows)}; {ours / theirs:.2f} of the reference's time")
        report("ldc extract over polars", ours / theirs)
        if attempt == 0:
            print("  " + "\n  ".join(said.strip().splitlines()[-12:]))
        digest = hashlib.sha256(output.read_bytes()).hexdigest()
    output.unlink()
    tree = Tree(command)
    time.sleep(0.6 * best)
    tree.kill()
    kept = "is" if output.exists() else "is not"
    tree = Tree(command)
    again, _ = tree.finish()
    same = hashlib.sha256(output.read_bytes()).hexdigest() == digest
    print(f"killed after {0.6 * best:.1f} s (the table {kept} there), started again: {again:.1f} s more; "
          f"{'the same' if same else 'ANOTHER'} table, bit for bit")  # fmt: skip
    return same


if __name__ == "__main__":
    main()
