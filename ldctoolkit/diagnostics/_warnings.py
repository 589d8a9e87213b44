"""What a user should know, in words."""

from __future__ import annotations

import math
from collections.abc import Iterator

from ldctoolkit.diagnostics.parts import SideDiagnostics
from ldctoolkit.diagnostics.thresholds import (
    COMPARISON_STANDARD_ERRORS,
    FAR_OUTSIDE,
    ILL_CONDITIONED,
    LEAST_PROBABILITY,
    strip_is_off,
)
from ldctoolkit.mixture import BoundedGaussianMixture
from ldctoolkit.scenario_model import SideSummary


def warnings_of(
    found: SideDiagnostics, mixture: BoundedGaussianMixture, summary: SideSummary | None
) -> tuple[str, ...]:
    """Sentences, the most serious first; each begins with the side where there is one."""
    prefix = f"{found.label}: " if found.label else ""
    lines = (*_fit(mixture, summary), *_misfit(found), *_components(found), *_events(found, summary))
    return tuple(f"{prefix}{line}" for line in lines)


def _fit(mixture: BoundedGaussianMixture, summary: SideSummary | None) -> Iterator[str]:
    converged = summary.converged if summary is not None else getattr(mixture, "converged_", True)
    if not converged:
        yield "the fit stopped before it had converged"
    K = mixture.distribution.weights.size
    if summary is not None and len(summary.n_components) > 1 and max(summary.n_components) == K:
        yield f"the chosen K = {K} is the largest that was tried, the best may be larger: try more"


def _misfit(found: SideDiagnostics) -> Iterator[str]:
    beyond = sorted((c for c in found.calibrations if c.distance > c.limit), key=lambda c: -c.distance)
    if beyond:
        shown = ", ".join(f"{c.name} {c.distance:.3g}" for c in beyond)
        yield (
            f"Kolmogorov distance beyond the {beyond[0].limit:.3g} that chance allows in {len(beyond)} of "
            f"{len(found.names)} parameters: {shown}"
        )
    off = sorted((strip for strip in found.strips if strip_is_off(strip)), key=lambda strip: -abs(strip.error))
    if off:
        shown = ", ".join(
            f"{s.name} {s.end} {abs(s.error):.0%} {'too much' if s.error > 0 else 'too little'} ({s.model:.2%}, events "
            f"{s.data:.2%})"
            for s in off
        )
        yield f"the model's mass next to bounds is not that of the events: {shown}".replace("%", " %")
    c = found.comparison
    if c is not None and c.difference > COMPARISON_STANDARD_ERRORS * c.standard_error:
        yield (
            f"a mixture after a logarithm or logit of the bounded parameters describes held-out events better, by "
            f"{c.difference:.3f} +- {c.standard_error:.3f} nats an event"
        )


def _components(found: SideDiagnostics) -> Iterator[str]:
    d = len(found.names)
    free = 1 + d + d * (d + 1) // 2
    for k, one in enumerate(found.components):
        if one.events < free:
            yield f"component {k} rests on {one.events:.1f} effective events, fewer than its {free} parameters"
        rare = one.log_probability < math.log(LEAST_PROBABILITY)
        if rare or one.outside > FAR_OUTSIDE:
            parts = [f"P = 10^{one.log_probability / math.log(10.0):.0f}"] if rare else []
            if one.outside > 0.0:
                parts.append(f"mean {one.outside:.1f} standard deviations outside in {one.outside_name}")
            yield (
                f"component {k} is the tail of a normal that lies outside the bounds ({', '.join(parts)}): its mean "
                "and covariance say little"
            )
        if one.condition > ILL_CONDITIONED:
            yield f"component {k} is nearly flat: its correlation matrix has condition number {one.condition:.2g}"


def _events(found: SideDiagnostics, summary: SideSummary | None) -> Iterator[str]:
    for name, count in summary.moved_inside if summary is not None else ():
        yield f"{count} events had {name} exactly on a bound, moved just inside"
    if found.outside:
        shown = ", ".join(f"{name} {count}" for name, count in found.outside)
        yield f"events outside the model's bounds were left out ({shown})"
    if found.comparison is None:
        yield f"no comparison with a transformed mixture: {found.comparison_note}"
