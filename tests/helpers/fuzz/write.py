"""Files on disk, with odd things beside them."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from hypothesis import strategies as st

NAMES = ("DataLane.csv", "DataWsu.csv", "HV_Primary.csv", "a.csv", "a.parquet", "a.csv.gz", "RAW_GPS.txt", "D1", "D9")
TRIP = "20151110175712-16km-D1-NORMAL1-SECONDARY"
KINDS = (
    "loop", "dangling", "up", "folder", "empty", "closed", "closed_folder", "pipe", "bytes", "deep", "newline", "trip",
)  # fmt: skip


def write(root: Path, files: dict[str, bytes]) -> list[Path]:
    """Write files below a folder; one whose place is taken is passed over."""
    written = []
    for name, content in files.items():
        path = root / name
        with contextlib.suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
            written.append(path)
    return written


PLACES = st.lists(st.tuples(st.sampled_from(KINDS), st.sampled_from(NAMES)), max_size=3)
"""What else lies in the folder: kind and name of each."""

PATHS = st.sampled_from(
    (
        *("", ".", "..", "none.csv", "none/none.csv", "DataLane.csv/x", "drives.csv/", "a" * 300 + ".csv", "x/" * 3000),
        *("a\0b.csv", "\udcff.csv", "D1", "D1/..", "D1/*", "[!]", "~", "-o", "DataLane.csv", "./DataLane.csv", "\n"),
        *("../../../../../../../../dev/null", "../../../../../../../../dev/zero", "HV_Primary.csv", "a.csv"),
    )
)
"""Paths that a user may name, below the folder."""


def put_places(root: Path, places: list[tuple[str, str]]) -> list[Path]:
    """Make these places; those that are taken are passed over."""
    made = []
    for kind, name in places:
        with contextlib.suppress(OSError):
            made.append(_put(root / "D1" if kind == "trip" else root, kind, name))
    return made


def open_again(made: list[Path]) -> None:
    """Give back what was closed, so that it can be removed."""
    for path in made:
        if not path.is_symlink():
            path.chmod(0o700)


def _put(root: Path, kind: str, name: str) -> Path:
    path = root / name
    if kind == "loop":
        path.symlink_to(path)
    elif kind == "dangling":
        path.symlink_to(root / "gone")
    elif kind == "up":
        path.symlink_to(root, target_is_directory=True)
    elif kind == "folder":
        path.mkdir()
    elif kind == "empty":
        path.touch(exist_ok=False)
    elif kind == "closed":
        path.touch(exist_ok=False)  # a pipe that is there would be waited for
        path.write_bytes(b"Device,Trip,Time\n")
        path.chmod(0)
    elif kind == "closed_folder":
        path.mkdir()
        (path / "DataLane.csv").touch()
        path.chmod(0)
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind == "bytes":
        path = Path(os.fsdecode(os.fsencode(root) + b"/\xff\xfe" + os.fsencode(name)))
        path.write_bytes(b"1,2,3\n")
    elif kind == "newline":
        path = root / f"a\nb\x1b[31m{name}"
        path.write_bytes(b"recording,t,lane_offset,lane_width,speed\na,0,x,3.6,25\n")
    elif kind == "deep":
        path = root / "/".join("abcdefghijkl") / name
        path.parent.mkdir(parents=True)
        path.write_bytes(b"1 2 3\n")
    else:
        path = root / TRIP
        path.mkdir(parents=True)
    return path
