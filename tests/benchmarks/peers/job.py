"""The job that every peer does, and what all of them but the toolkit need for it: vehicle, takeover, score.

Three laws on the same departures: S = integral of |e_y| over each departure, and its mean for each law. Departures come
from a file that `run.py` draws and writes. The plant is the linear single track at the speed of the trigger, sampled
with DT; control starts where the edge is further than Y_S beyond the line, in the steady turn of the recorded path. The
laws: none; an LQR with feedforward for the bend; an MPC with the lane previewed and with limits on angle and rate.

Lines of a script between its marks "job" and "end of job" are counted, without blank ones, comments and docstrings.
"""

import argparse
import ast
import dataclasses
import json
import platform
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

PARAMETERS = ("T", "d_y", "v_mean", "a_mean", "c_0", "dc")
VEHICLE = {"C_af": 80000.0, "C_ar": 80000.0, "l_f": 1.43, "l_r": 1.47, "m": 1000.0, "I_z": 3344.0}
EDGE, Y_S, DT = 0.85, 0.2, 0.05  # e_y when the edge is on the line [m], trigger [m], sample time [s]
Q, R_LQR = np.diag([1.0, 0.0, 1.0, 0.0]), 20_000.0  # weights of e_y, de_y/dt, e_psi, de_psi/dt, and of the angle
R_MPC, HORIZON, DELTA_MAX, RATE_MAX = 100.0, 20, 0.15, 0.3  # weight, samples, limits [rad], [rad/s]


# --------------------------------------------------------------------------------------------------------------- job


@dataclasses.dataclass(frozen=True)
class Takeover:
    """The m of n departures that reach Y_S, at their triggers."""

    rows: np.ndarray  # (m,) which of the n
    S: np.ndarray  # (n,) without control
    S_before: np.ndarray  # (m,) before the trigger
    left: np.ndarray  # (m,) time from the trigger to the end [s]
    v: np.ndarray  # (m,) speed [m/s]
    x: np.ndarray  # (m, 4)
    delta: np.ndarray  # (m,) [rad]
    r: np.ndarray  # (m, samples) yaw rate of the lane at the samples [rad/s], held after the end
    slope: np.ndarray  # (m,) its rate of change before the end [rad/s^2]


def single_track(v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A (m, 4, 4), B and E (m, 4) of the error dynamics (Rajamani, eq. 2.45) at speeds v."""
    C_f, C_r, l_f, l_r, m, I_z = (
        2 * VEHICLE["C_af"],
        2 * VEHICLE["C_ar"],
        *(VEHICLE[k] for k in ("l_f", "l_r", "m", "I_z")),
    )
    A, B, E = np.zeros((v.size, 4, 4)), np.zeros((v.size, 4)), np.zeros((v.size, 4))
    A[:, 0, 1] = A[:, 2, 3] = 1.0
    for row, front, rear, inertia in ((1, 1.0, 1.0, m), (3, l_f, -l_r, I_z)):
        total, turning = (front * C_f + rear * C_r) / inertia, (front * C_f * l_f - rear * C_r * l_r) / inertia
        A[:, row, 1], A[:, row, 2], A[:, row, 3] = -total / v, total, -turning / v
        B[:, row], E[:, row] = front * C_f / inertia, -turning / v
    E[:, 1] -= v
    return A, B, E


def balance(v: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Heading error and angle at which the lateral and the yaw acceleration are minus what is `known` (m, 2)."""
    A, B, _ = single_track(v)
    both = np.linalg.solve(np.stack([A[:, [1, 3], 2], B[:, [1, 3]]], axis=2), -known[:, :, None])[:, :, 0]
    return both[:, 0], both[:, 1]


def steady_turn(v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """State (m, 4) and angle (m,) that hold a bend, per unit of its yaw rate."""
    e_psi, delta = balance(v, single_track(v)[2][:, [1, 3]])
    return e_psi[:, None] * np.array([0.0, 0.0, 1.0, 0.0]), delta


def takeover(departures: dict[str, np.ndarray]) -> Takeover:
    """Recorded paths y = 4 d_y s (1 - s), s the share of the way, up to their triggers."""
    T, d_y, v_mean, a, c_0, dc = (departures[name] for name in PARAMETERS)
    X, v_0 = v_mean * T, v_mean - 0.5 * a * T

    def area(t: np.ndarray) -> np.ndarray:  # of e_y from 0 to t: a quartic, exact with three Gauss points
        points, weights = np.polynomial.legendre.leggauss(3)
        times = 0.5 * t[:, None] * (points + 1.0)
        s = (v_0[:, None] + 0.5 * a[:, None] * times) * times / X[:, None]
        return 0.5 * t * ((4.0 * d_y[:, None] * s * (1.0 - s) + EDGE) @ weights)

    rows = np.flatnonzero(d_y > Y_S)
    way = 0.5 * X * (1.0 - np.sqrt(np.maximum(1.0 - Y_S / d_y, 0.0)))
    start = 2.0 * way / (v_0 + np.sqrt(v_0**2 + 2.0 * a * way))
    v, steep = v_0 + a * start, 4.0 * d_y / X * (1.0 - 2.0 * way / X)
    bend = steep * a - 8.0 * d_y / X**2 * v**2
    state = np.column_stack([np.full(T.size, Y_S + EDGE), steep * v, np.zeros(T.size), bend / v])[rows]
    v, left, bend = v[rows], (T - start)[rows], bend[rows]
    times = DT * np.arange(int(left.max() / DT) + HORIZON + 3)
    share = np.minimum((start[rows, None] + times) / T[rows, None], 1.0)
    r = v[:, None] * (c_0[rows, None] + dc[rows, None] * share)
    A, _, E = single_track(v)
    moved = (A @ state[:, :, None])[:, :, 0] + E * r[:, :1]
    state[:, 2], delta = balance(v, np.column_stack([moved[:, 1] - bend, moved[:, 3]]))
    return Takeover(rows, area(T), area(start)[rows], left, v, state, delta, r, v * (dc / T)[rows])


def score(over: Takeover, e_y: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """S of all n departures from e_y and de_y/dt at the samples, (m, samples): cubics, 20 straight lines in each."""
    h = np.linspace(0.0, 1.0, 21)[:-1, None, None]
    ends = DT * np.arange(e_y.shape[1] - 1)
    t = np.minimum(ends + h * DT, over.left[:, None])
    h = np.clip((t - ends) / DT, 0.0, 1.0)
    first = (1.0 + 2.0 * h) * (1.0 - h) ** 2 * e_y[:, :-1] + h * (1.0 - h) ** 2 * DT * rate[:, :-1]
    fine = first + h**2 * (3.0 - 2.0 * h) * e_y[:, 1:] - h**2 * (1.0 - h) * DT * rate[:, 1:]
    t, fine = (np.moveaxis(one, 0, 2).reshape(over.rows.size, -1) for one in (t, fine))
    S = over.S.copy()
    S[over.rows] = over.S_before + np.trapezoid(np.abs(fine), t, axis=1)
    return S


# -------------------------------------------------------------------------------------------------------- end of job


def lines(path: str | Path) -> int:
    """Lines of the job in a script: neither blank, nor a comment, nor of a docstring."""
    text = Path(path).read_text(encoding="utf-8")
    first, last = (text[: text.index(mark)].count("\n") + 1 for mark in ("-- job\n", "-- end of job\n"))
    inside = set(range(first + 1, last))
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            inside -= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    rows = text.splitlines()
    return sum(bool(rows[i - 1].strip()) and not rows[i - 1].strip().startswith("#") for i in inside)


def timed(work: Callable[[], np.ndarray], repeats: int) -> tuple[np.ndarray, float, float]:
    """What it gives, and processor times [s]: the best of the calls after the first, and the first."""
    times = []
    for _ in range(1 + repeats):
        start = time.process_time()
        result = work()
        times.append(time.process_time() - start)
    return result, min(times[1:]), times[0]


Departures = dict[str, np.ndarray]


def main(
    peer: str,
    script: str,
    packages: tuple[str, ...],
    laws: dict[str, Callable[[Departures], np.ndarray]],
    *,
    shared: int | None = None,
    once: tuple[str, ...] = (),
    more: Callable[[Departures], dict[str, Any]] = lambda _: {},
) -> None:
    """Do the job on the departures of a file, keep S in another, and print the line of JSON.

    Laws `once` are timed once after the first call, others three times. `shared`: lines of this module that the peer
    needs, all of them by default.
    """
    parser = argparse.ArgumentParser(description=peer)
    parser.add_argument("departures", type=Path, help="file of departures (.npz)")
    parser.add_argument("scores", type=Path, help="file for S of each law (.npz)")
    given = parser.parse_args()
    with np.load(given.departures) as file:
        departures = {name: file[name] for name in file.files}
    runs = {law: timed(lambda work=work: work(departures), 1 if law in once else 3) for law, work in laws.items()}
    np.savez(given.scores, **{law: S for law, (S, _, _) in runs.items()})
    record = {
        "peer": peer,
        "versions": {"Python": platform.python_version()} | {name: version(name) for name in packages},
        "lines": lines(script),
        "lines_shared": lines(__file__) if shared is None else shared,
        "seconds": {law: round(best, 5) for law, (_, best, _) in runs.items()},
        "first": {law: round(first, 3) for law, (_, _, first) in runs.items()},
        "mean_S": {law: round(float(S.mean()), 7) for law, (S, _, _) in runs.items()},
    }
    print(json.dumps(record | more(departures)), flush=True)
