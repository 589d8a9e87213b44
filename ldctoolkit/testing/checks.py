"""All checks of the contract by name, in the order in which they are best read."""

from __future__ import annotations

from typing import Final

from ldctoolkit.testing import design_checks, law_checks
from ldctoolkit.testing.subject import Check

CHECKS: Final[dict[str, Check]] = {
    "declared": design_checks.declared,
    "frozen": design_checks.frozen,
    "picklable": design_checks.picklable,
    "bounds": design_checks.bounds,
    "toml": design_checks.toml,
    "interface": law_checks.interface,
    "repeatable": law_checks.repeatable,
    "mirror": law_checks.mirror,
    "quiet": law_checks.quiet,
    "finite": law_checks.finite,
    "limits": law_checks.limits,
    "inputs": law_checks.inputs,
    "state": law_checks.state,
    "batch": law_checks.batch,
    "take": law_checks.take,
    "ended": law_checks.ended,
    "extremes": law_checks.extremes,
}
"""Name -> check; the first line of a check's documentation says what it asks for."""
