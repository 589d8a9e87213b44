"""Findings in words, from the numbers of a loop."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from ldctoolkit.control import Controller
from ldctoolkit.plant_options import PlantOptions
from ldctoolkit.review.findings import Finding, Severity, Thresholds
from ldctoolkit.review.law_model import LARGER, PULSE, LinearView
from ldctoolkit.review.loop_numbers import MISMATCH, LoopNumbers
from ldctoolkit.review.sampled_loop import FloatArray

_NONLINEAR = 0.05
"""Relative difference of the answers to small and larger pulses from which it is told."""

_UNEXPLAINED = 0.02
"""Part of a pulse response that the model of the memory may leave out untold."""


def law_findings(view: LinearView, v: FloatArray) -> Iterator[Finding]:
    """What can be said of a law by itself.

    Parameters
    ----------
    view : LinearView
    v : (n,) [m/s]

    Yields
    ------
    Finding
    """
    if not view.finite.all():
        at = float(v[int(np.argmin(view.finite))])
        text = f"At {at:.3g} m/s the law gives commands that are not finite numbers near straight, centred driving."
        yield Finding("fault", "finite", f"{text} Nothing else can be said about its loop.", v=at)
        return
    if not view.quiet.all():
        at = float(v[int(np.argmin(view.quiet))])
        yield Finding("fault", "quiet", f"At {at:.3g} m/s the law steers while driving straight and centred.", v=at)
    if view.exact:
        return
    memory = f"a memory of order {view.order}" if view.order else "no memory"
    yield Finding(
        "note",
        "linearised",
        f"The law is not linear by its type: poles and margins are those of its answers to pulses of {PULSE[0]:g} m, "
        f"{PULSE[1]:g} m/s and {PULSE[2]:g} rad around straight driving, which show {memory}.",
    )
    i = int(np.argmax(view.nonlinearity))
    if view.nonlinearity[i] > _NONLINEAR:
        yield Finding(
            "note",
            "nonlinear",
            f"At {v[i]:.3g} m/s the answers to pulses {LARGER:g} times larger differ from proportional ones by "
            f"{100 * view.nonlinearity[i]:.2g} % of the largest: poles and margins hold for small deviations only.",
            float(view.nonlinearity[i]),
            _NONLINEAR,
            float(v[i]),
        )
    i = int(np.argmax(view.unexplained))
    if view.unexplained[i] > _UNEXPLAINED:
        yield Finding(
            "warning",
            "memory",
            f"At {v[i]:.3g} m/s {100 * view.unexplained[i]:.2g} % of the law's answer to a pulse are not those of a "
            "small linear system: poles and margins may be wrong.",
            float(view.unexplained[i]),
            _UNEXPLAINED,
            float(v[i]),
        )


def loop_findings(
    numbers: LoopNumbers, controller: Controller, dt: float, a_y: float, thresholds: Thresholds
) -> Iterator[Finding]:
    """What the numbers of a loop say, one finding a check, at its worst speed.

    Parameters
    ----------
    numbers : LoopNumbers
    controller : Controller
        Its gains are named where a remedy is.
    dt : float [s]
    a_y : float [m/s^2]
    thresholds : Thresholds

    Yields
    ------
    Finding
    """
    v, t = numbers.v, thresholds
    softer = _softer(controller)
    if not numbers.stable.all():
        i = int(np.argmax(numbers.radius))
        grows = numbers.radius[i] > 1.0 + 1e-6
        text = (
            f"a deviation grows by a factor of {numbers.radius[i]:.3g} a sample of {dt:g} s"
            if grows
            else "a deviation is never corrected: a pole lies on the stability limit"
        )
        help_ = f"{softer}, or shorten delay and lag." if grows else "Raise the gains on e_y and e_psi."
        yield Finding(
            "fault",
            "stability",
            f"At {v[i]:.3g} m/s the closed loop is unstable: {text}{_share(~numbers.stable)}. {help_}",
            float(numbers.radius[i]),
            1.0,
            float(v[i]),
        )
    stable = numbers.stable
    rows: tuple[tuple[str, FloatArray, tuple[float, float], float, str, str, str], ...] = (
        ("gain_margin", numbers.gain_margin, t.gain_margin, 1.0, "dB", "the loop has a gain margin of", softer),
        (
            "gain_reduction_margin", numbers.gain_reduction_margin, t.gain_margin, 1.0, "dB",
            "the loop gets unstable if its gain shrinks by", "Give more weight to e_psi and the rates against e_y",
        ),
        (
            "phase_margin", numbers.phase_margin, t.phase_margin, 180.0 / math.pi, "deg",
            "the loop has a phase margin of", softer,
        ),
        ("disk_margin", numbers.disk_margin, t.disk_margin, 1.0, "", "the loop has a disk margin of", softer),
        (
            "delay_margin", numbers.delay_margin, (t.delay_margin[0] * dt, t.delay_margin[1] * dt), 1000.0, "ms",
            "the loop stands no more further delay than", softer,
        ),
        (
            "damping", np.where(stable, numbers.damping, np.nan), t.damping, 1.0, "",
            "the closed loop has a damping ratio of", softer,
        ),
    )  # fmt: skip
    for name, values, pair, unit, word, text, help_ in rows:
        yield from _least(
            name, values, pair, v, f"{text} {{value}}; allowed: at least {{allowed}}", (unit, word), help_
        )
    yield from _most(
        "slowest_pole", np.where(stable, numbers.slowest, np.nan), t.slowest, v,
        "the loop's slowest pole has a time constant of {value}; allowed: at most {allowed}", (1.0, "s"),
        "Raise the gain on e_y",
    )  # fmt: skip
    sampling = 2.0 * math.pi / dt
    yield from _bandwidth(numbers.bandwidth / sampling, sampling, dt, v, t.sampling, softer)
    yield from _most(
        "bend", np.abs(numbers.e_y_bend), t.bend, v,
        f"a steady bend of {a_y:g} m/s^2 leaves an offset of {{value}}; allowed: at most {{allowed}}", (1.0, "m"),
        "Add curvature feedforward or integral action, or raise the gain on e_y",
    )  # fmt: skip
    yield from _most(
        "bend_mismatched", np.abs(numbers.e_y_bend_mismatched), t.bend_mismatched, v,
        f"on tyres that are {100 * MISMATCH:g} % softer or stiffer than the law knows a steady bend of {a_y:g} m/s^2 "
        "leaves an offset of {value}; allowed: at most {allowed}", (1.0, "m"),
        "Raise the gain on e_y or add integral action",
    )  # fmt: skip
    yield from _most(
        "hessian", numbers.hessian_condition, t.hessian, v,
        "the condensed Hessian has a condition number of {value}; allowed: at most {allowed}", (1.0, ""),
        "Raise r_delta against the other weights or shorten the horizon",
    )  # fmt: skip


def _bandwidth(
    ratio: FloatArray, sampling: float, dt: float, v: FloatArray, pair: tuple[float, float], softer: str
) -> Iterator[Finding]:
    found = list(_most("sampling", ratio, pair, v, "{value}{allowed}", (1.0, ""), ""))
    for finding in found:
        nyquist = finding.severity == "fault" and pair[1] == 0.5
        bound = "half the sampling frequency (Nyquist)" if nyquist else f"{finding.allowed:g} of the sampling frequency"
        text = (
            f"At {finding.v:.3g} m/s the loop's bandwidth is {finding.value * sampling:.3g} rad/s, above {bound} of "
            f"{sampling:.3g} rad/s{_share(ratio > finding.allowed)}. {softer}, or sample faster than every {dt:g} s."
        )
        yield Finding(finding.severity, finding.name, text, finding.value, finding.allowed, finding.v)


def _least(
    name: str,
    values: FloatArray,
    pair: tuple[float, float],
    v: FloatArray,
    text: str,
    unit: tuple[float, str],
    help_: str,
) -> Iterator[Finding]:
    """A finding where the smallest value is below its threshold; NaN is no value."""
    turned = _most(name, -values, (-pair[0], -pair[1]), v, text, (-unit[0], unit[1]), help_)
    yield from (Finding(f.severity, f.name, f.sentence, -f.value, -f.allowed, f.v) for f in turned)


def _most(
    name: str,
    values: FloatArray,
    pair: tuple[float, float],
    v: FloatArray,
    text: str,
    unit: tuple[float, str],
    help_: str,
) -> Iterator[Finding]:
    """A finding where the largest value is above its threshold; NaN is no value."""
    known = np.where(np.isnan(values), -math.inf, values)
    i = int(np.argmax(known))
    worst = float(known[i])
    if not worst > pair[0]:
        return
    severity: Severity = "fault" if worst > pair[1] else "warning"
    shown = text.format(value=_shown(worst * unit[0], unit[1]), allowed=_shown(pair[0] * unit[0], unit[1]))
    sentence = f"At {v[i]:.3g} m/s {shown}{_share(known > pair[0])}. {help_}."
    bound = pair[1] if name == "sampling" and severity == "fault" else pair[0]
    yield Finding(severity, name, sentence, worst, bound, float(v[i]))


def _shown(value: float, unit: str) -> str:
    text = "more than can be told: it is unstable" if math.isinf(value) else f"{value:.3g}"
    return f"{text} {unit}".rstrip() if math.isfinite(value) else text


def _share(where: npt.NDArray[np.bool_]) -> str:
    n = int(where.sum())
    return f" (so at {n} of {where.size} speeds)" if where.size > 1 else ""


def _softer(controller: Controller) -> str:
    """What makes a law gentler, by the names of its own gains."""
    names = [g.name for g in controller.gains()]
    restraint = [name for name in names if name.startswith("r_")]
    if restraint:
        return f"Raise {restraint[0]}"
    gains = [name for name in names if name.lower().startswith("k") and "max" not in name]
    return f"Lower {', '.join(gains)} in size" if gains else "Make the law softer"


def plant_notes(options: PlantOptions) -> Iterator[Finding]:
    """What of a plant the review leaves out.

    Parameters
    ----------
    options : PlantOptions

    Yields
    ------
    Finding
        At most one.
    """
    sensors = options.sensors
    words = {
        "the speed profile": options.speed == "profile",
        "mismatch": not options.mismatch.ideal,
        "saturating tyres": not options.tyres.ideal,
        "noise, bias and quantisation of the camera": not sensors.ideal,
        "the camera's period but for the age that it adds on average": sensors.period > 0,
        "residuals": not options.residuals.ideal,
    }
    left_out = [text for text, holds in words.items() if holds]
    if left_out:
        yield Finding(
            "note", "left_out", f"The study's plant has more than the review looks at: {', '.join(left_out)}."
        )
