"""Extractions for the page's tests: invented departures, accounts that fit to them, drawn ones with noise."""

import dataclasses

import numpy as np

from ldctoolkit.departures import LEFT, RIGHT, Departures, ExtraColumn, rebuild_signals
from ldctoolkit.recordings import Criteria, Extraction, Provenance, Refused, SourceFile
from ldctoolkit.recordings.find_departures import REASONS
from ldctoolkit.recordings.preparation import Preparation
from ldctoolkit.recordings.quality import WIDTH_BINS, Account, Drawn, Origin, example_events
from ldctoolkit.recordings.recording import Label, Problem


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
        read_ns=int(hours * 3.6e12), valid_ns=int(hours * 3.0e12), departures=np.array(departures, dtype=np.int64),
        refused=rng.integers(0, 30, (2, len(REASONS))), widths=widths,
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
    refused = np.sum([one.refused for one in accounts], axis=(0, 1)) if accounts else np.zeros(len(REASONS), dtype=int)
    settings: dict[str, object] = {
        "criteria": Criteria(vehicle_width=1.8),
        "refused": Refused(**dict(zip(REASONS, refused.tolist(), strict=True))),
        "sources": tuple(
            SourceFile(f"{name}/PROC_LANE_DETECTION.txt", 123_456, f"{i:064x}"[::-1]) for i, name in enumerate(names)
        ),
        "recordings": sum(one.recordings for one in accounts),
        "samples": sum(one.samples for one in accounts),
        "invalid_samples": sum(one.samples - one.usable for one in accounts),
        "hours": sum(one.hours_valid for one in accounts),
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
