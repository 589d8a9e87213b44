"""Findings about a loop: each check at its worst speed, in words."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray
from ldctoolkit.control import Controller
from ldctoolkit.review.findings import Finding, Severity, Thresholds
from ldctoolkit.review.loop_numbers import MISMATCH, LoopNumbers


@dataclasses.dataclass(frozen=True)
class Check:
    """One number of a loop against its thresholds."""

    name: str
    values: FloatArray  # (n,) NaN where there is none
    limits: tuple[float, float]  # Where a warning starts, and a fault
    text: str  # Half a sentence with {value}
    help: str  # What helps, a sentence without its full stop
    # How values are shown
    factor: float = 1.0
    unit: str = ""
    at_least: bool = True  # Small values are the bad ones

    def finding(self, v: FloatArray) -> Finding | None:
        """The finding at the worst speed, None where all is well."""
        sign = -1.0 if self.at_least else 1.0
        badness = np.where(np.isnan(self.values), -math.inf, sign * self.values)
        i = int(np.argmax(badness))
        warning, fault = sign * self.limits[0], sign * self.limits[1]
        if not badness[i] > warning:
            return None
        severity: Severity = "fault" if badness[i] > fault else "warning"
        value, word = float(self.values[i]), "at least" if self.at_least else "at most"
        shown = self.text.format(value=self._shown(value))
        sentence = (
            f"At {v[i]:.3g} m/s {shown}; allowed: {word} {self._shown(self.limits[0])}{share(badness > warning)}. "
            f"{self.help}."
        )
        return Finding(severity, self.name, sentence, value, self.limits[0], float(v[i]))

    def _shown(self, value: float) -> str:
        return f"{value * self.factor:.3g} {self.unit}".rstrip()


def share(where: npt.NDArray[np.bool_]) -> str:
    """How many of several speeds are meant."""
    return f" (so at {int(where.sum())} of {where.size} speeds)" if where.size > 1 else ""


def loop_findings(numbers: LoopNumbers, controller: Controller, dt: float, thresholds: Thresholds) -> Iterator[Finding]:
    """What the numbers of a loop say."""
    softer = _softer(controller)
    yield from _instability(numbers, dt, softer)
    checks = (
        *_margins(numbers, dt, thresholds, softer),
        *_bends(numbers, thresholds),
        _sampling(numbers, dt, thresholds),
    )
    for check in checks:
        found = check.finding(numbers.v)
        if found is not None:
            yield found


def _instability(numbers: LoopNumbers, dt: float, softer: str) -> Iterator[Finding]:
    v, i = numbers.v, int(np.argmax(numbers.radius))
    radius = float(numbers.radius[i])
    where = share(~numbers.stable)
    if not numbers.stable.all() and radius > 1.0 + 1e-6:
        text = (
            f"At {v[i]:.3g} m/s the closed loop is unstable: a deviation grows by a factor of {_factor(radius)} a "
            f"sample of {dt:g} s{where}. {softer}, or shorten delay and lag."
        )
        yield Finding("fault", "stability", text, radius, 1.0, float(v[i]))
    elif not numbers.stable.all():
        text = (
            f"At {v[i]:.3g} m/s a deviation is never corrected: a pole of the closed loop lies on the stability limit"
            f"{where}. Give the law a gain on both e_y and e_psi."
        )
        yield Finding("fault", "stability", text, radius, 1.0, float(v[i]))
    lost = np.isinf(numbers.e_y_bend_mismatched)
    if lost.any():
        at = float(v[int(np.argmax(lost))])
        text = (
            f"At {at:.3g} m/s the closed loop is unstable on tyres that are {100 * MISMATCH:g} % softer or stiffer "
            f"than the law knows{share(lost)}. {softer}, or shorten delay and lag."
        )
        yield Finding("fault", "stability_mismatched", text, v=at)


def _factor(radius: float) -> str:
    """A factor above 1 with as many digits as tell it from 1."""
    digits = max(2, 1 - math.floor(math.log10(radius - 1.0)))
    return f"{radius:.3g}" if radius >= 1.1 else f"{radius:.{digits}f}"


def _margins(numbers: LoopNumbers, dt: float, t: Thresholds, softer: str) -> Iterator[Check]:
    stable = numbers.stable
    yield Check(
        "gain_margin", numbers.gain_margin, t.gain_margin, "the loop has a gain margin of {value}", softer, 1, "dB"
    )
    yield Check(
        "gain_reduction_margin",
        numbers.gain_reduction_margin,
        t.gain_margin,
        "the loop gets unstable if its gain shrinks by {value}",
        "Weigh e_psi and the rates more against e_y",
        unit="dB",
    )
    in_degrees = 180.0 / math.pi
    text = "the loop has a phase margin of {value}"
    yield Check("phase_margin", numbers.phase_margin, t.phase_margin, text, softer, in_degrees, "deg")
    yield Check("disk_margin", numbers.disk_margin, t.disk_margin, "the loop has a disk margin of {value}", softer)
    samples = (t.delay_margin[0] * dt, t.delay_margin[1] * dt)
    text = "the loop stands no more additional delay than {value}"
    yield Check("delay_margin", numbers.delay_margin, samples, text, softer, 1000.0, "ms")
    damping = np.where(stable, numbers.damping, np.nan)
    yield Check("damping", damping, t.damping, "the closed loop has a damping ratio of {value}", softer)
    slowest = np.where(stable, numbers.slowest, np.nan)
    text = "the slowest pole of the closed loop has a time constant of {value}"
    yield Check(
        "slowest_pole", slowest, t.slowest, text, "Raise the gain on e_y or its integral", unit="s", at_least=False
    )
    yield Check(
        "hessian",
        numbers.hessian_condition,
        t.hessian,
        "the condensed Hessian has a condition number of {value}",
        "Raise r_delta against the other weights or shorten the horizon",
        at_least=False,
    )


def _bends(numbers: LoopNumbers, t: Thresholds) -> Iterator[Check]:
    largest = float((numbers.bend * numbers.v).max())
    bend = f"a steady bend of {largest:.3g} m/s^2 leaves an offset of {{value}}"
    nominal, other = np.abs(numbers.e_y_bend), np.abs(numbers.e_y_bend_mismatched)
    help_ = "Add curvature feedforward or integral action, or raise the gain on e_y"
    yield Check("bend", nominal, t.bend, bend, help_, unit="m", at_least=False)
    yield Check(
        "bend_mismatched",
        np.where(np.isinf(other), np.nan, other),
        t.bend_mismatched,
        f"on tyres that are {100 * MISMATCH:g} % softer or stiffer than the law knows {bend}",
        "Add integral action or raise the gain on e_y",
        unit="m",
        at_least=False,
    )


def _sampling(numbers: LoopNumbers, dt: float, t: Thresholds) -> Check:
    sampling = 2.0 * math.pi / dt
    beyond = float(numbers.bandwidth.max()) > 0.5 * sampling
    above = ", above the Nyquist frequency, which is half of it" if beyond else ""
    return Check(
        "sampling",
        numbers.bandwidth / sampling,
        t.sampling,
        f"the loop's bandwidth is {{value}} of the sampling frequency of {sampling:.3g} rad/s{above}",
        f"Lower the gains or sample faster than every {dt:g} s",
        at_least=False,
    )


def _softer(controller: Controller) -> str:
    """What makes a law gentler, by the names of its own gains."""
    names = [g.name for g in controller.gains()]
    restraint = [name for name in names if name.startswith("r_")]
    if restraint:
        return f"Raise {restraint[0]}"
    gains = [name for name in names if name.lower().startswith("k") and "max" not in name and "soft" not in name]
    return f"Lower {', '.join(gains)} in size" if gains else "Make the law softer"
