"""Recordings made for tests."""

import dataclasses
import pickle
from collections.abc import Iterable
from typing import Any

import numpy as np
import polars as pl

from helpers.bits import assert_same_bits
from ldctoolkit.departures import LEFT, RIGHT, Departures, ExtraColumn, rebuild_signals
from ldctoolkit.recordings import Criteria, Extraction, Provenance, Recording, Refused, SourceFile
from ldctoolkit.recordings.extraction_statistics import WIDTH_BINS, Account, Drawn, Origin, example_events
from ldctoolkit.recordings.find_departures import REASONS
from ldctoolkit.recordings.preparation import Preparation
from ldctoolkit.recordings.recording import Label, Problem, RecordingSource

T = np.arange(100) * 0.1
OFFSET = 0.9 + np.maximum(0.3 * (1.0 - ((T - 5.0) / 0.95) ** 2), -0.4 - 0.01 * np.abs(T - 5.0))
"""With a vehicle of 1.8 m in a lane of 3.6 m the left edge is beyond the line by y = 0.3 (1 - ((t - 5)/0.95)^2) around
t = 5 s, that is for 1.9 s, and well inside before and after; it never stands still for long."""


def read_source(source: RecordingSource) -> tuple[list[Recording], list[Problem]]:
    """Recordings of all parts, which go to other processes, and what is wrong with the source and its parts."""
    assert len({part.key for part in source.parts}) == len(source.parts)
    items = [item for part in pickle.loads(pickle.dumps(source.parts)) for item in part.read()]
    problems = [*source.problems, *(item for item in items if isinstance(item, Problem))]
    return [item for item in items if isinstance(item, Recording)], problems


def drive(name: str = "a", t: Any = T, **columns: Any) -> Recording:
    """One recording at 10 Hz, 25 m/s, straight, in one lane; columns may be scalars, None takes one away."""
    n = len(t)
    values: dict[str, Any] = {"lane_offset": OFFSET, "lane_width": 3.6, "speed": 25.0, "valid": True}
    values |= {"curvature": 0.0, "lane": 1} | columns
    kinds: dict[str, type] = dict.fromkeys(("valid", "engaged", "cut", "yaw_rate_measured"), bool)
    kinds |= dict.fromkeys(("lane", "turn_signal"), np.int64)
    for column in {*values} & {*Recording.COLUMNS}:
        if values[column] is not None:
            values[column] = np.array(np.broadcast_to(values[column], n), dtype=kinds.get(column, np.float64))
    return Recording(name, np.array(t, dtype=np.float64), **values)


def frame_of(recordings: Iterable[Recording]) -> pl.DataFrame:
    """Recordings as a file would hold them."""
    names = [name for name in Recording.COLUMNS if name not in ("cut", "yaw_rate_measured")]
    frames = []
    for recording in recordings:
        columns = {name: getattr(recording, name) for name in names if getattr(recording, name) is not None}
        frames.append(pl.DataFrame({"recording": [recording.name] * recording.samples} | columns))
    return pl.concat(frames)


TABLE_HEADER = "recording,t,lane_offset,lane_width,speed\n"


def table_of(first: int, n: int = 10) -> str:
    """A table of n recordings of one departure each, alternating sides, all different."""
    generator = np.random.default_rng(first)
    lines = [TABLE_HEADER]
    for i in range(first, first + n):
        duration, peak, v = generator.uniform(1, 4), generator.uniform(0.1, 0.5), generator.uniform(15, 30)
        t = np.arange(0, 8, 0.1)
        offset = (-1) ** i * (np.maximum(peak * (1 - (2 * (t - 4) / duration) ** 2), -0.6) + 0.9)
        lines += [f"r{i},{a:.2f},{b:.4f},3.6,{v:.4f}\n" for a, b in zip(t, offset, strict=True)]
    return "".join(lines)


def assert_same(left: Extraction, right: Extraction) -> None:
    """The same departures, counts and warnings; sources and columns of the source's own aside."""
    first, second = (dataclasses.replace(result.departures, extra=()) for result in (left, right))
    assert_same_bits(first, second, "departures")
    assert left.refused == right.refused
    assert (left.hours, left.recordings, left.warnings) == (right.hours, right.recordings, right.warnings)
    assert left.distance == right.distance
    assert left.provenance.invalid_samples == right.provenance.invalid_samples


def make_departures(sides: np.ndarray, sources: list[str], rng: np.random.Generator) -> Departures:
    """One departure for each side and source."""
    n = sides.size
    T = 0.5 + rng.gamma(2.0, 1.0, n).clip(0.0, 9.0)
    return Departures(
        side=sides,
        T=T,
        d_y=0.02 + 0.1 * T * rng.gamma(2.0, 0.6, n),
        sigma_y=rng.gamma(2.0, 0.01, n),
        v_mean=rng.normal(24.0, 6.0, n).clip(6.0, 40.0),
        a_mean=rng.normal(0.0, 0.3, n),
        sigma_v=rng.gamma(2.0, 0.05, n),
        c_0=rng.normal(0.0, 1e-3, n),
        dc=rng.normal(0.0, 4e-4, n),
        recording=np.array([f"{source or 'none'}/{i // 20}" for i, source in enumerate(sources)], dtype=np.str_),
        start_time=np.cumsum(rng.uniform(1.0, 99.0, n)),
        samples=(10 * T).astype(np.int64),
        extra=(ExtraColumn("source", np.array(sources, dtype=np.str_)),) if any(sources) else (),
    )


def make_drawn(departures: Departures, sources: list[str], rng: np.random.Generator, dt: float = 0.1) -> Drawn:
    """Signals of the departures, with noise."""
    signals = rebuild_signals(departures, dt)
    owner = np.repeat(np.arange(departures.n), np.diff(signals.offsets))
    noisy = dataclasses.replace(
        signals,
        y=signals.y + departures.sigma_y[owner] * rng.standard_normal(owner.size) * (signals.y > 0.0),
        v=signals.v + departures.sigma_v[owner] * rng.standard_normal(owner.size),
        c=signals.c + 1e-4 * rng.standard_normal(owner.size),
    )
    return example_events(departures, noisy, sources)


def make_account(
    origin: Origin, departures: tuple[int, int], rng: np.random.Generator, *, recordings: int = 4, hours: float = 2.0
) -> Account:
    """One origin; some candidates refused."""
    widths = np.histogram(rng.normal(3.5, 0.2, 5000), np.arange(WIDTH_BINS + 1) * 0.1)[0]
    return Account(
        origin=origin, recordings=recordings, samples=int(hours * 36_000), usable=int(hours * 30_000),
        read_ns=int(hours * 3.6e12), valid_ns=int(hours * 3.0e12), valid_um=int(hours * 6e10),
        departures=np.array(departures, dtype=np.int64), refused=rng.integers(0, 30, (2, len(REASONS))), widths=widths,
    )  # fmt: skip


def make_extraction(
    sources: int = 1, each: tuple[int, int] = (30, 20), *, seed: int = 1, labels: bool = False,
    problems: tuple[Problem, ...] = (), dt: float = 0.1, **provenance: object,
) -> Extraction:  # fmt: skip
    """So many sources with so many departures left and right."""
    rng = np.random.default_rng(seed)
    names = [f"D{i + 1}" for i in range(sources)]
    sides = np.array([side for _ in names for side, n in zip((LEFT, RIGHT), each, strict=True) for _ in range(n)])
    owner = [name for name in names for _ in range(sum(each))]
    departures = make_departures(sides.astype(np.int64), owner, rng)
    behaviours = ("normal", "drowsy", "aggressive")
    accounts = tuple(
        make_account(
            Origin(name, (Label("driver", name), Label("behaviour", behaviours[i % 3])) if labels else ()), each, rng
        )
        for i, name in enumerate(names)
    )
    refused = sum((account.refused.sum(axis=0) for account in accounts), np.zeros(len(REASONS), dtype=int))
    settings: dict[str, object] = {
        "criteria": Criteria(vehicle_width=1.8),
        "refused": Refused(**dict(zip(REASONS, refused.tolist(), strict=True))),
        "sources": tuple(
            SourceFile(f"{name}/PROC_LANE_DETECTION.txt", 123_456, f"{i:064x}"[::-1]) for i, name in enumerate(names)
        ),
        "recordings": sum(account.recordings for account in accounts),
        "samples": sum(account.samples for account in accounts),
        "invalid_samples": sum(account.samples - account.usable for account in accounts),
        "hours": sum(account.hours_valid for account in accounts),
        "distance": sum(account.valid_um for account in accounts) / 1e6,
        "curvature": "yaw_rate",
        "reader": "uah-driveset",
        "preparation": Preparation(step=0.1),
    }
    return Extraction(
        departures,
        Provenance(**(settings | provenance)),  # type: ignore[arg-type]
        accounts,
        make_drawn(departures, owner, rng, dt),
        problems,
    )
