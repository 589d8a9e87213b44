"""What the numbers on other plants follow from, in a few digits: stored ones of anything else are worked out again."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import ldctoolkit
from studies.robustness.plants import OtherPlant

if TYPE_CHECKING:
    from ldctoolkit import Scenarios, Setup
    from studies.results import Case
    from studies.robustness.chosen_designs import ChosenDesigns

_FORMAT: Final = 2
"""To be raised with whatever changes the numbers or the file."""


def content_key(
    chosen: ChosenDesigns, plants: Sequence[OtherPlant], scenarios: Scenarios, setup: Setup, case: Case
) -> str:
    """Sixteen hexadecimal digits.

    Parameters
    ----------
    chosen : ChosenDesigns
    plants : sequence of OtherPlant
    scenarios : Scenarios
    setup : Setup
    case : Case

    Returns
    -------
    str
    """
    said = [
        _FORMAT,
        ldctoolkit.__version__,
        [[design.id, contends] for design, contends in zip(chosen.designs, chosen.contends, strict=True)],
        [chosen.slow, chosen.unsafe, chosen.more],
        [dataclasses.asdict(plant) for plant in plants],
        dataclasses.asdict(setup),
        dataclasses.asdict(case),
    ]
    content = hashlib.sha256(json.dumps(said, sort_keys=True, separators=(",", ":")).encode())
    for field in dataclasses.fields(scenarios):
        content.update(getattr(scenarios, field.name).tobytes())
    return content.hexdigest()[:16]
