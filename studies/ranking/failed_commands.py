"""What a reader must know of commands that were not finite, or came from a law's own fallback."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import get_type_hints

import numpy as np

from ldctoolkit import BicycleModel, EventStatus, LinearLaw, Plant, SteeringLaw, VehicleParameters
from ldctoolkit.vehicle import Convention
from studies.design import Design
from studies.results import CaseResults

_OFTEN = 0.1
"""Share of a design's interventions with a failed solve from which on a reader is told at once."""

_NAMED = 3
"""Designs that a warning names."""


def warnings_of(case: CaseResults, designs: Sequence[Design]) -> Iterator[str]:
    """Sentences that name designs: from the first command where it cannot be a fallback, else where it is often."""
    wrong, often = [], []
    for i in np.flatnonzero((case.failed_solves > 0).any(axis=1)).tolist():
        design, failed_solves, status = designs[i], case.failed_solves[i], case.status[i]
        driven = ~np.isin(status, (EventStatus.NEVER_TRIGGERED, EventStatus.INVALID))
        failing, total = int((failed_solves[driven] > 0).sum()), int(driven.sum())
        if not failing:
            continue
        name = f"{design.label} in {failing:,} of {total:,} interventions"
        if not has_solver(design, case.case.convention):
            wrong.append(name)
        elif failing >= _OFTEN * total:
            often.append(name)
    if wrong:
        yield f"Commands that were not finite, of laws that declare no solver to fall back from: {_listed(wrong)}."
    if often:
        yield f"Commands that were not finite, or came from a law's fallback: {_listed(often)}."


def _listed(names: Sequence[str]) -> str:
    more = f"; and {len(names) - _NAMED} more designs" if len(names) > _NAMED else ""
    return "; ".join(names[:_NAMED]) + more


def has_solver(design: Design, convention: Convention) -> bool:
    """Whether the design's law declares a solver, by a `solver_calls` of its own; true where that is not known."""
    try:
        controller = design.controller(convention)
        kind = get_type_hints(type(controller).prepare).get("return")
        if not (isinstance(kind, type) and issubclass(kind, LinearLaw | SteeringLaw) and kind is not SteeringLaw):
            # its type says nothing; any plant shows what kind of law it makes
            model = BicycleModel(VehicleParameters(), convention)
            kind = type(controller.prepare(Plant.build(model, 25.0, 0.05)))
    except (KeyboardInterrupt, GeneratorExit):
        raise
    except BaseException:  # a controller may be anybody's code
        return True
    return issubclass(kind, SteeringLaw) and kind.solver_calls is not SteeringLaw.solver_calls
