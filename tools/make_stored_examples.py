"""Make the small stored files of this version that tests of later versions read: one of each kind.

    python tools/make_stored_examples.py

writes a departures table with its signals, a scenario model fitted to it, and the result folder of a study on the model
to tests/data/stored_MAJOR_MINOR/. The recordings are synthetic. Run it once for a version that changes a format, and
leave the folders of earlier versions as they are: the literals in tests/test_promises.py are theirs.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np

import ldctoolkit
from ldctoolkit.studies.cli import main as ldc

ROOT = Path(__file__).resolve().parent.parent
RECORDINGS = 60  # of one departure each, to the left and to the right in turn
DROPPED = ("ranking.md", "report.html", "paths.parquet", "step-times.parquet")  # made anew when needed

STUDY = """\
name = "stored"
seed = 1

[scenarios]
model = "model.json"
left = 12
right = 12

[plant.actuator]
lag = 0.1

[ranking]
bootstrap = 200
finalists = 2
require = ["gain_margin >= 1.2"]

[[design]]
law = "none"

[[design]]
law = "lqr"
y_s = 0.1
gains = { r_delta = 500.0 }

[[design]]
law = "preview_proportional"
y_s = 0.1
"""


def recordings() -> str:
    """A plain table of recordings, each 8 s at 10 Hz on a gentle bend."""
    rng = np.random.default_rng(20261127)
    lines = ["recording,t,lane_offset,lane_width,speed,curvature"]
    for i in range(RECORDINGS):
        duration, peak, v, c = (
            rng.uniform(1.2, 4.0),
            rng.uniform(0.1, 0.5),
            rng.uniform(18.0, 33.0),
            rng.normal(0, 5e-4),
        )
        t = np.arange(0.0, 8.0, 0.1)
        beyond = np.maximum(peak * (1.0 - (2.0 * (t - 4.0) / duration) ** 2), -0.5) + rng.normal(0.0, 0.004, t.size)
        offset, speed = (-1) ** i * (0.85 + beyond), v + rng.normal(0.0, 0.3) * (t - 4.0) / 4.0
        lines += [f"r{i},{a:.1f},{b:.4f},3.6,{s:.3f},{c:.6f}" for a, b, s in zip(t, offset, speed, strict=True)]
    return "\n".join(lines) + "\n"


def make(folder: Path) -> None:
    """Extract, fit and run in a folder, as a user does."""
    with contextlib.chdir(folder):
        Path("recordings.csv").write_text(recordings(), encoding="utf-8")
        Path("stored.toml").write_text(STUDY, encoding="utf-8")
        for command in (
            "extract recordings.csv --signals -o departures.parquet",
            "fit departures.parquet --components 2 --kind mixture --workers 1 --no-page -o model.json",
            "run stored.toml --workers 1 --refits 10 --no-figures -o study",
        ):
            code = ldc(command.split())
            if code:
                sys.exit(f"ldc {command}: exit code {code}")
    Path(folder, "recordings.csv").unlink()
    Path(folder, "study", "ranking.csv").rename(folder / "ranking.csv")  # its columns are public
    for name in (*DROPPED, ".lock", "finalists/.lock"):
        Path(folder, "study", name).unlink(missing_ok=True)


def main() -> int:
    name = "stored_{}_{}".format(*ldctoolkit.__version__.split("."))
    target = ROOT / "tests" / "data" / name
    with tempfile.TemporaryDirectory() as place:
        make(Path(place))
        shutil.rmtree(target, ignore_errors=True)
        shutil.copytree(place, target)
    sizes = {path.relative_to(target).as_posix(): path.stat().st_size for path in target.rglob("*") if path.is_file()}
    print("\n".join(f"{size:9,} {name}" for name, size in sorted(sizes.items())))
    print(f"{sum(sizes.values()):9,} bytes in {os.path.relpath(target)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
