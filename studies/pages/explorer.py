"""The departures explorer: single departures with the paths of designs, and distributions over all departures."""

import math
from collections.abc import Iterator
from typing import Final

import numpy as np
from markupsafe import Markup

from ldctoolkit.arrays import FloatArray
from ldctoolkit.control import EventStatus
from ldctoolkit.departures import LEFT
from ldctoolkit.metrics import A_Y_LIMIT, DTLE_LIMIT, JERK_LIMIT

from ..ranking.verdict import design_name, law_title
from ..results import status_among
from ..text import compact, number, percent, plural
from .charts import RECORDED, Axis, Chart, Style, ecdf, legend
from .context import MOST_CURVES, Context, side_rows
from .replay import STATUS_TEXT, Replay, explorer_departures, explorer_designs, plan_stride, replay
from .shell import Section, figure, packed, paragraphs, render

RESOLUTION: Final = {"y": 1e-3, "delta": 1e-2, "a_y": 1e-2}
"""Steps of the embedded positions [m], steering angles [deg] and accelerations [m/s^2]."""

SHORTEST_STEP: Final = 0.05  # between embedded samples [s], where the controller's clock is faster

_SPANS: Final = (0.5, 1.0, 2.0, 4.0, 6.0, 8.0, 10.0, 15.0, 20.0, 30.0, 50.0, 100.0, 200.0, 500.0, 1000.0)


def section(context: Context) -> Section:
    """The section on single departures."""
    designs = explorer_designs(context)
    charts = tuple(_distributions(context))
    every = max(1, round(SHORTEST_STEP / context.report.setup.dt))
    shown = context.best_of_each_law[:MOST_CURVES]
    data: dict[str, object] | None = None
    note = ""
    if designs:
        departures = explorer_departures(context, designs)
        replayed = replay(context, departures, designs)
        data = _data(context, replayed, every)
        if replayed.mismatch > 1e-3:
            note = (
                f"Paths were simulated again for this page. Their scores differ from the stored ones by up to "
                f"{percent(replayed.mismatch)}: the results are of another version or machine."
            )
    body = render("explorer.html", explorer=data is not None, note=note)
    entries = [("No control", RECORDED), *((law_title(context.ranking.designs[i]), context.style(i)) for i in shown)]
    body += Markup("<h3>Distributions</h3>") + figure(
        charts,
        "Share of departures (for added a_y and jerk, of interventions) below the value on the axis. A dash-dotted "
        "line is a limit of ISO 11270 or Euro NCAP. Axes leave out a few far values.",
        legend(entries),
    )
    return Section("departures", "Departures", body, charts, data, ("explorer.js",) if data else ())


def _data(context: Context, replayed: Replay, every: int) -> dict[str, object]:
    """Data of the script: numbers as whole steps of `RESOLUTION`, and all text."""
    step = every * context.report.setup.dt
    recorded = _recorded(replayed, step)
    count, start = [], []
    values: dict[str, list[FloatArray]] = {name: [] for name in RESOLUTION}
    for paths in replayed.paths:
        angles = np.degrees(paths.delta)
        for k, t in enumerate(paths.t):
            times = t[np.isfinite(t)]
            since = (times - times[:1]) / step
            on_grid = np.flatnonzero(np.abs(since - np.rint(since)) * step < 1e-9)
            count.append(on_grid.size)
            start.append(float(times[0]) if times.size else 0.0)
            for name, table in (("y", paths.y), ("delta", angles), ("a_y", paths.a_y)):
                values[name].append(np.nan_to_num(table[k, on_grid]))
    # a requested departure opens first, else one where the first design intervenes
    acts = np.isfinite(replayed.paths[0].t).any(axis=1)
    opened = int(
        np.argmax(acts + np.array([2 * ("requested" in departure.roles) for departure in replayed.departures]))
    )
    joined = {name: np.concatenate([np.empty(0), *arrays]) for name, arrays in values.items()}
    return {
        "step": step,
        "open": opened,
        "resolution": RESOLUTION,
        "departures": [_departure(replayed, k) for k in range(len(replayed.departures))],
        "duration": packed(replayed.scenarios.T),
        "designs": [
            {
                "name": design_name(context.ranking.designs[entry.position]),
                "why": entry.reason,
                "style": context.style(entry.position).name,
                "dash": context.style(entry.position).dash,
            }
            for entry in replayed.designs
        ],
        "recorded": {name: _whole(arrays, name) for name, arrays in recorded.items() if name != "count"}
        | {"count": packed(recorded["count"], "i4")},
        "count": packed(count, "i4"),
        "start": packed(start),
        "paths": {name: _whole(arrays, name) for name, arrays in joined.items()},
        "plans": [_plans(paths.plan) for paths in replayed.paths],
        "plan_step": plan_stride(context.report.setup.dt) * context.report.setup.dt,
        "dt": context.report.setup.dt,
        "facts": _facts(context, replayed),
        "scales": {
            "t": [_axis_scale(0.0, span) for span in (5.0, 10.0, 20.0, 40.0, 80.0)],
            "y": _around_zero(),
            "delta": _around_zero(),
            "a_y": _around_zero(),
        },
    }


def _plans(plan: FloatArray) -> dict[str, object]:
    """Departures with plans, their shape, and their numbers."""
    rows = np.flatnonzero(np.isfinite(plan).any(axis=(1, 2)))
    return {"departures": rows.tolist(), "shape": plan.shape[1:], "values": packed(plan[rows])}


def _whole(values: FloatArray, name: str) -> dict[str, str]:
    steps = np.clip(np.rint(values / RESOLUTION[name]), -(2.0**31) + 1, 2.0**31 - 1).astype(np.int64)
    return packed(steps, "i2" if steps.size == 0 or np.abs(steps).max() < 2**15 else "i4")


def _axis_scale(low: float, high: float) -> dict[str, object]:
    return {"low": low, "high": high, "ticks": [[value, text] for value, text in Axis("", low, high).ticks(260.0)]}


def _around_zero() -> list[dict[str, object]]:
    """Scales that contain zero, the tightest first: the script takes the first that contains all its values."""
    ends = [(low, high) for low in (0.0, *_SPANS) for high in (0.0, *_SPANS) if 0.2 * max(low, high) <= min(low, high)]
    return [_axis_scale(-low, high) for low, high in sorted(ends, key=lambda pair: pair[0] + pair[1]) if low + high]


def _departure(replayed: Replay, k: int) -> dict[str, str]:
    scenarios, departure = replayed.scenarios, replayed.departures[k]
    side = "left" if scenarios.side[k] == LEFT else "right"
    roles = f": {', '.join(departure.roles)}" if departure.roles else ""
    facts = (
        f"T = {number(float(scenarios.T[k]), 1)} s, d_y = {number(float(scenarios.d_y[k]), 2)} m, "
        f"v = {number(float(scenarios.v_mean[k]), 1)} m/s, curvature "
        f"{number(1000.0 * float(scenarios.c_0[k]), 2)}\u00b710\u207b\u00b3 1/m"
    )
    return {"name": f"{scenarios.index[k]}, {side}{roles}", "number": str(int(scenarios.index[k])), "facts": facts}


def _recorded(replayed: Replay, step: float) -> dict[str, FloatArray]:
    """Recorded paths in steps of time: samples of each, and y and a_y of one path after the other."""
    scenarios, path = replayed.scenarios, replayed.recorded
    count = np.ceil(scenarios.T / step - 1e-9).astype(np.int64) + 1
    t = np.minimum(np.arange(int(count.max())) * step, scenarios.T[:, None])
    used = np.arange(t.shape[1]) < count[:, None]
    a_y = path.lateral_acceleration(t) + path.speed(t) ** 2 * path.curvature(t)
    return {"count": count.astype(np.float64), "y": path.lateral(t)[used], "a_y": a_y[used]}


def _facts(context: Context, replayed: Replay) -> list[list[list[str]]]:
    """Text of S, reduction, deepest crossing, added acceleration and status for every design and departure."""
    results, rows = context.results, [departure.row for departure in replayed.departures]
    texts = []
    for entry in replayed.designs:
        i = int(context.ranking.index[entry.position])
        S, S_0 = results.counted[i][rows], results.S_uncorrected[i][rows]
        deepest, a_y = results.metrics.deepest[i][rows], results.metrics.a_y_added_peak[i][rows]
        status = results.status[i][rows]
        saved = 1.0 - np.divide(S, S_0, out=np.ones_like(S), where=S_0 > 0)
        texts.append(
            [
                [
                    number(float(S[k])),
                    f"{percent(float(saved[k]))}",
                    number(float(deepest[k]), 2),
                    number(float(a_y[k]), 2) if status[k] != EventStatus.NEVER_TRIGGERED else "\u2013",
                    STATUS_TEXT[EventStatus(int(status[k]))],
                ]
                for k in range(len(rows))
            ]
        )
    return texts


# ------------------------------------------------------------------------------------------------ distributions


def _distributions(context: Context) -> Iterator[Chart]:
    """Distributions of S by side, of crossings, and of the acceleration and jerk that control adds."""
    ranking, results = context.ranking, context.results
    shown = context.best_of_each_law[:MOST_CURVES]
    for name, rows in side_rows(context):
        recorded = context.S_uncorrected(context.shown)[rows]
        samples: list[tuple[str, FloatArray, Style]] = [("No control", recorded, RECORDED)]
        samples += [(law_title(ranking.designs[i]), context.S(i)[rows], context.style(i)) for i in shown]
        label = f"S, departures to the {name} [m\u00b7s], less is better"
        yield _distribution_chart(f"S-{name}", f"S of departures to the {name}", samples, label, "Share of departures")
    for name, title, label, limit in (
        ("deepest", "Deepest crossing", "Edge beyond the line [m]", None),
        ("dtle", "Distance to the lane edge", "Front axle beyond the line [m]", (-DTLE_LIMIT, "Euro NCAP")),
        ("a_y_added_peak", "Added a_y", "Added a_y [m/s\u00b2]", (A_Y_LIMIT, "ISO 11270")),
        ("jerk_added_peak", "Added jerk", "Added jerk over 0.5 s [m/s\u00b3]", (JERK_LIMIT, "ISO 11270")),
    ):
        table, sign = getattr(results.metrics, name), -1.0 if name == "dtle" else 1.0
        samples = []
        if name == "deepest":
            samples.append(("No control", context.scenarios.d_y, RECORDED))
        elif name == "dtle" and context.no_control is not None:
            samples.append(("No control", sign * table[int(ranking.index[context.no_control])], RECORDED))
        for i in shown:
            values, status = sign * table[ranking.index[i]], results.status[ranking.index[i]]
            if "added" in name:
                values = values[~status_among(status, (EventStatus.NEVER_TRIGGERED, EventStatus.INVALID))]
            samples.append((law_title(ranking.designs[i]), values, context.style(i)))
        if any(np.isfinite(values).any() for _, values, _ in samples):
            of = "Share of interventions" if "added" in name else "Share of departures"
            yield _distribution_chart(name.replace("_", "-"), title, samples, label, of, limit)


def _distribution_chart(
    name: str, title: str, samples: list[tuple[str, FloatArray, Style]], label: str, of: str,
    limit: tuple[float, str] | None = None,
) -> Chart:  # fmt: skip
    finite = [values[np.isfinite(values)] for _, values, _ in samples]
    finite = [values for values in finite if values.size]
    low = min(0.0, *(float(np.quantile(values, 0.01)) for values in finite))
    high = max(float(np.quantile(values, 0.98)) for values in finite)
    if limit is not None:
        median = max(float(np.quantile(values, 0.75)) for values in finite)
        high = max(1.25 * limit[0], min(high, max(5.0 * limit[0], 1.05 * median)))
    axis = Axis(label, low, high if high > low else low + 1.0)
    return ecdf(f"distribution-{name}", f"Distribution: {title}", samples, axis, of, limit=limit)


def failure_sentences(context: Context) -> Iterator[str]:
    """Departures in which a law failed, for the shown design and the best design of each law."""
    results = context.results
    for position in dict.fromkeys((context.shown, *context.best_of_each_law)):
        status = results.status[int(context.ranking.index[position])]
        parts = []
        for which in (EventStatus.DIVERGED, EventStatus.SOLVER_FAILED, EventStatus.TIMED_OUT, EventStatus.CRASHED):
            rows = np.flatnonzero(status == which)
            if rows.size:
                numbers = ", ".join(str(int(context.scenarios.index[row])) for row in rows[:5])
                more = " and others" if rows.size > 5 else ""
                parts.append(f"{STATUS_TEXT[which]} in {plural(rows.size, 'departure')} (no. {numbers}{more})")
        if parts:
            yield f"{design_name(context.ranking.designs[position])}: {'; '.join(parts)}."


def worst_sentence(context: Context) -> str:
    """The share of the worst departures in the sum of S."""
    S = np.sort(context.S(context.shown))[::-1]
    if S.size < 40 or not S.sum() > 0:
        return ""
    count = math.ceil(0.05 * S.size)
    return (
        f"The worst 5 % of departures ({count:,}) make up {percent(float(S[:count].sum() / S.sum()), 0)} of the sum of "
        f"S of {context.shown_name}; their largest S is {compact(float(f'{S[0]:.3g}'))} m\u00b7s."
    )


def failures(context: Context) -> Markup:
    """Paragraphs of failures and of the worst departures."""
    return paragraphs(*failure_sentences(context), worst_sentence(context))
