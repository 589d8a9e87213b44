"""Small sound files of every format, with departures in them: the more of them stay, the deeper the damage is felt."""

import gzip
import io

import numpy as np
import polars as pl

from helpers import spmd

Files = dict[str, bytes]  # content of each file by its name, with folders

TRIPS = 3
ROWS = 36  # samples of a trip at 10 Hz

DEPARTURES = {"table": TRIPS, "spmd-das1": TRIPS, "spmd-das2": TRIPS, "uah-driveset": 2}
"""In the sound files of each format: one a trip."""


def _drives() -> list:
    return [
        spmd.planted_drive(7, trip, [spmd.Planted((-1) ** trip, 0.93, 1.5, 0.2 + 0.05 * trip)], rows=ROWS)
        for trip in range(1, TRIPS + 1)
    ]


def _table() -> tuple[Files, Files, Files]:
    names = np.repeat([f"r{i}" for i in range(TRIPS)], ROWS)
    t = np.tile(np.arange(ROWS) * 0.1, TRIPS)
    side = np.where(np.repeat(np.arange(TRIPS), ROWS) % 2, -1, 1)
    y = np.maximum(0.3 * (1.0 - ((t - 1.7) / 0.75) ** 2), -0.5)
    frame = pl.DataFrame(
        {
            "recording": names, "t": np.round(t, 2), "lane_offset": np.round(side * (y + 0.85), 4),
            "lane_width": 3.6 + 0.0 * t, "speed": np.round(25.0 + 0.1 * t, 3),
            "yaw_rate": np.round(0.01 * np.sin(t), 5), "lane": np.ones(t.size, dtype=np.int64),
            "valid": np.ones(t.size, dtype=bool), "turn_signal": np.zeros(t.size, dtype=np.int64),
        }
    )  # fmt: skip
    text = frame.write_csv().encode()
    columns = io.BytesIO()
    frame.write_parquet(columns, compression="uncompressed")
    return {"drives.csv": text}, {"drives.csv.gz": gzip.compress(text, mtime=0)}, {"drives.parquet": columns.getvalue()}


def _das1() -> Files:
    drives = _drives()
    return {
        "DataLane.csv": spmd.text_of(spmd.lane_frame(drives), bom=True, crlf=False),
        "DataWsu.csv": spmd.text_of(spmd.wsu_frame(drives), crlf=False),
    }


def _das2() -> tuple[Files, Files]:
    rows = [row for drive in _drives() for row in spmd.rows_of(drive)]
    with_header = "\n".join([spmd.HEADER, *spmd.lines_of(rows)]) + "\n"
    without = "\n".join([spmd.ODD_FIRST, *spmd.lines_of(rows, 45)]) + "\n"
    return {"HV_Primary.csv": with_header.encode()}, {"HV_Primary.csv": without.encode()}


def _uah() -> Files:
    files: Files = {}
    t = np.arange(1.0, 1.0 + 0.1 * ROWS, 0.1)
    ends = ("NORMAL-MOTORWAY", "AGGRESSIVE1-SECONDARY")  # two trips are enough: they are six files
    for i in range(len(ends)):
        y = np.maximum((0.3 + 0.02 * i) * (1.0 - ((t - 2.7) / 0.75) ** 2), -0.5)
        x = (-1) ** i * (y + 0.85)
        folder = f"D{1 + i}/2015111017571{i}-16km-D{1 + i}-{ends[i]}"
        lane = [f"{a:.2f} {b:.3f} 0.01 3.5 2 \n" for a, b in zip(t, x, strict=True)]
        gps = [f"{a:.1f} 90 40.5 -3.4 600 6 10 {5 * a:.0f} 0 0 \n" for a in np.arange(0.5, 7.0)]
        yaw = [f"{a:.1f} 1 0 0 0 0 0 0 0 0 {np.angle(np.exp(1j * (3.0 + 0.1 * a))):.4f} \n" for a in t]
        for name, lines in (("PROC_LANE_DETECTION", lane), ("RAW_GPS", gps), ("RAW_ACCELEROMETERS", yaw)):
            files[f"{folder}/{name}.txt"] = "".join(lines).encode()
    return files


_CSV, _GZIP, _PARQUET = _table()
_HEADER, _HEADERLESS = _das2()

SOUND: dict[str, tuple[Files, ...]] = {
    "table": (_CSV, _GZIP, _PARQUET), "spmd-das1": (_das1(),), "spmd-das2": (_HEADER, _HEADERLESS),
    "uah-driveset": (_uah(),),
}  # fmt: skip
"""Files of each format, in each of its shapes."""
