"""Closed-loop benchmark: the compiled loop against a plain loop in numba, one scenario after the other, on one thread.

The reference, written here in full, is what an engineer writes in an hour: a scalar function, compiled, with the same
equations (steering actuator with delay, limit, rate limit and lag; saturating tyres; speed profile), the classical
Runge-Kutta method with five substeps a sample, S and the largest depth, acceleration, steering angle and rate. Both
drive the same departures with the same LQR from the trigger to three seconds after the end; the median of five runs
side by side. S has to agree within 5e-5 m s."""

import math
import statistics
import time
from collections.abc import Callable

import numba
import numpy as np
from closed_loop import REAL, linear_law, machine, scenarios
from history import report

from ldctoolkit import LQR, Setup
from ldctoolkit.plant_options import PlantOptions
from ldctoolkit.simulation import Takeover, drive, drive_many
from ldctoolkit.vehicle.bicycle import GRAVITY

N, SUBSTEPS, TOGETHER = 10_000, 5, 20


@numba.njit(cache=True)
def plain(car, actuator, dt, edge, scenes, gains, out):
    """Every scenario by itself; (S, depth, a_y, steering angle, rate) of each into `out`."""
    m, inertia, stiff_f, stiff_r, l_f, l_r, mu, shape = car
    delta_max, rate_max, lag, delay = actuator
    load_f, load_r = mu * m * GRAVITY * l_r / (l_f + l_r), mu * m * GRAVITY * l_f / (l_f + l_r)
    b_f, b_r = 2.0 * stiff_f / (shape * load_f), 2.0 * stiff_r / (shape * load_r)
    h, late = dt / SUBSTEPS, math.ceil(delay / dt) + 1
    sent = np.empty(late + 1)
    k_1, k_2, k_3, k_4, x = np.empty(5), np.empty(5), np.empty(5), np.empty(5), np.empty(5)

    def slopes(t, z, u, T, v_0, a, c_0, c_1, k):
        s = min(t, T)
        v, dv = v_0 + a * s, a if t < T else 0.0
        lane = v * (c_0 + c_1 * s)
        sine, cosine, omega = math.sin(z[2]), math.cos(z[2]), z[3] + lane
        v_y = (z[1] - v * sine) / cosine
        front = load_f * math.sin(shape * math.atan(b_f * (z[4] - math.atan((v_y + l_f * omega) / v))))
        rear = load_r * math.sin(shape * math.atan(b_r * math.atan((l_r * omega - v_y) / v)))
        a_y = (front * math.cos(z[4]) + rear) / m
        k[0], k[2] = z[1], z[3]
        k[1] = dv * sine + z[3] * (v * cosine - v_y * sine) + (a_y - v * omega) * cosine
        k[3] = (l_f * front * math.cos(z[4]) - l_r * rear) / inertia
        k[4] = min(max((u - z[4]) / lag, -rate_max), rate_max)
        return a_y

    for i in range(scenes.shape[0]):
        start, T, v_0, a, c_0, c_1, delta_0, steps = scenes[i, :8]
        x[:4], x[4] = scenes[i, 8:12], delta_0
        sent[:] = delta_0
        area, deepest, a_peak, angle_peak, rate_peak = 0.0, x[0] - edge, 0.0, abs(delta_0), 0.0
        for k in range(int(steps)):
            t, before = start + k * dt, x[4]
            s = min(t, T)
            lane = (v_0 + a * s) * (c_0 + c_1 * s)
            command = gains[i, 0] * x[0] + gains[i, 1] * x[1] + gains[i, 2] * x[2] + gains[i, 3] * x[3]
            sent[1:] = sent[:-1].copy()
            sent[0] = command + gains[i, 4] * lane
            for j in range(SUBSTEPS):
                # the command that has arrived: the delay need not be a multiple of the sample
                n = math.ceil((delay - j * h) / dt - 1e-9)
                raw = sent[max(n, 0)]
                u = min(max(raw, -delta_max), delta_max) if k >= n else raw
                now = t + j * h
                e, rate = x[0], x[1]
                a_y = slopes(now, x, u, T, v_0, a, c_0, c_1, k_1)
                slopes(now + 0.5 * h, x + 0.5 * h * k_1, u, T, v_0, a, c_0, c_1, k_2)
                slopes(now + 0.5 * h, x + 0.5 * h * k_2, u, T, v_0, a, c_0, c_1, k_3)
                slopes(now + h, x + h * k_3, u, T, v_0, a, c_0, c_1, k_4)
                x += h / 6.0 * (k_1 + 2.0 * k_2 + 2.0 * k_3 + k_4)
                if now < T:
                    w = min(h, T - now)
                    bend = (x[1] - rate) / h
                    end = e + w * (rate + 0.5 * w * bend)
                    part = w * (e + w * (0.5 * rate + w * bend / 6.0))
                    area += abs(part) if e * end >= 0.0 else 0.5 * w * (e * e + end * end) / (abs(e) + abs(end))
                    deepest = max(deepest, end - edge)
                a_peak = max(a_peak, abs(a_y))
                angle_peak = max(angle_peak, abs(x[4]))
            rate_peak = max(rate_peak, abs(x[4] - before) / dt)
        out[i, 0], out[i, 1], out[i, 2], out[i, 3], out[i, 4] = area, deepest, a_peak, angle_peak, rate_peak


def inputs(over: Takeover, design: LQR) -> tuple[np.ndarray, ...]:
    """What the plain loop reads."""
    setup, p, law = over.setup, over.triggered, linear_law(design, over)
    vehicle, actuator, tyres = setup.vehicle, setup.options.actuator, setup.options.tyres
    car = np.array(
        [vehicle.m, vehicle.I_z, vehicle.C_af, vehicle.C_ar, vehicle.l_f, vehicle.l_r, tyres.mu, tyres.shape]
    )
    limits = np.array([actuator.delta_max, actuator.rate_max, actuator.lag, actuator.delay], dtype=np.float64)
    v_0, steps = p.v_mean - 0.5 * p.a_mean * p.T, np.ceil((over.driven_for - 1e-9) / setup.dt)
    scenes = np.column_stack([over.start, p.T, v_0, p.a_mean, p.c_0, p.dc / p.T, over.delta_0, steps, over.x_0])
    return car, limits, scenes, np.column_stack([law.F, law.G_yaw_rate[:, 0]])


def side_by_side(*runs: Callable[[], object]) -> list[float]:
    """Median of five runs of each, taken in turns after a warm-up."""
    for run in runs:
        run()
    times: list[list[float]] = [[] for _ in runs]
    for _ in range(5):
        for run, taken in zip(runs, times, strict=True):
            start = time.perf_counter()
            run()
            taken.append(time.perf_counter() - start)
    return [statistics.median(taken) for taken in times]


def main() -> None:
    many, design = scenarios(N), LQR(r_delta=200_000.0)
    options = PlantOptions(actuator=REAL.actuator, tyres=REAL.tyres, speed="profile")
    over = Takeover.build(many, Setup(options=options, plant_knowledge="ideal"), y_s=0.1)
    car, limits, scenes, gains = inputs(over, design)
    out, edge = np.empty((over.m, 5)), over.setup.vehicle.edge_offset
    ideal, real = (Takeover.build(many, Setup(options=plant), y_s=0.1) for plant in (PlantOptions(), REAL))
    run = drive(design, over, threads=1)
    ours, theirs, exact, every, together = side_by_side(
        lambda: drive(design, over, threads=1),
        lambda: plain(car, limits, over.setup.dt, edge, scenes, gains, out),
        lambda: drive(design, ideal, threads=1),
        lambda: drive(design, real, threads=1),
        lambda: list(drive_many([design] * TOGETHER, real, threads=1)),
    )
    assert run.area is not None
    off = np.abs(run.area - out[:, 0])[run.status == 0]  # a departure that diverged scores the bound in one of them
    print(machine("numba", "numpy"), f"One thread, {over.m:,} of {N:,} departures, LQR; median of five.\n")
    print(f"S agrees within {off.max():.1e} m s, in the median {np.median(off):.1e}.\n")
    print("| case | ms | |\n| --- | ---: | --- |")
    print(f"| plain loop: actuator, tyres, speed profile | {1e3 * theirs:.1f} | reference |")
    print(f"| ours | {1e3 * ours:.1f} | {theirs / ours:.1f} times as fast |")
    report("actuator, tyres, speed profile", theirs / ours)
    print(f"| ours, ideal plant | {1e3 * exact:.1f} | |")
    print(f"| ours, all options | {1e3 * every:.1f} | {every / exact:.1f} times the ideal plant |")
    one = together / TOGETHER
    print(
        f"| ours, all options, one of {TOGETHER} designs | {1e3 * one:.1f} | {one / exact:.1f} times the ideal plant |"
    )
    if off.max() > 5e-5:
        raise RuntimeError("the reference does not give the same S")


if __name__ == "__main__":
    main()
