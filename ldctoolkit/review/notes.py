"""Findings about a law by itself, and notes on what a review leaves out."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.control import Controller
from ldctoolkit.plant_options import PlantOptions
from ldctoolkit.review.findings import Finding
from ldctoolkit.review.law_model import LARGER, PULSE, LinearView
from ldctoolkit.review.limits import limit_of
from ldctoolkit.review.loop_numbers import BEND_ERROR, LoopNumbers

_NONLINEAR = 0.05
"""Relative difference of the answers to small and larger pulses from which it is told."""

_IN_THE_LOOP = ("period", "delay", "kalman")
"""What of the camera the loop holds."""

_UNEXPLAINED = 0.02
"""Part of a pulse response that the model of the memory may leave out untold."""


def law_findings(view: LinearView, v: FloatArray) -> Iterator[Finding]:
    """What can be said of a law by itself."""
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


def bound_notes(controller: Controller, view: LinearView) -> Iterator[Finding]:
    """What a review does not see of a law that keeps a corridor."""
    bound = limit_of(controller, "e_y_max")
    if bound is not None and not view.exact:
        text = f"The law keeps |e_y| <= e_y_max = {bound:g} m by itself: the loop while that bound holds the command"
        yield Finding("note", "bound", f"{text} is not looked at, poles and margins are those far from it.")


def bend_notes(numbers: LoopNumbers) -> Iterator[Finding]:
    """Offsets in a bend that are left out because the law is not linear up to them."""
    i, wrong = int(np.argmax(numbers.bend_error)), numbers.bend_error > BEND_ERROR
    if wrong.any():
        text = (
            f"At {numbers.v[i]:.3g} m/s the law is not linear in a steady bend: its command there differs by "
            f"{100 * numbers.bend_error[i]:.3g} % from what small deviations foretell. Offsets in the bend are left "
            f"out ({int(wrong.sum())} of {wrong.size} speeds)."
        )
        yield Finding("note", "bend_not_linear", text, float(numbers.bend_error[i]), BEND_ERROR, float(numbers.v[i]))


def plant_notes(options: PlantOptions) -> Iterator[Finding]:
    """What of a plant the review leaves out."""
    sensors = options.sensors
    words = {
        "the speed profile": options.speed == "profile",
        "mismatch": not options.mismatch.ideal,
        "saturating tyres": not options.tyres.ideal,
        "noise, bias, quantisation and errors of the curvature of the camera": any(
            getattr(sensors, field.name) for field in dataclasses.fields(sensors) if field.name not in _IN_THE_LOOP
        ),
        "the camera's period but for the age that it adds on average": sensors.period > 0,
        "residuals": not options.residuals.ideal,
    }
    left_out = [text for text, holds in words.items() if holds]
    if left_out:
        yield Finding(
            "note", "left_out", f"The study's plant has more than the review looks at: {', '.join(left_out)}."
        )
