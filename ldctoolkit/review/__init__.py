"""Review of a design before a study: poles, margins, sampling, limits, conditioning, steady bends."""

from ldctoolkit.review.design_review import (
    BEND,
    SPEEDS,
    Finding,
    Review,
    Severity,
    Thresholds,
    review,
    review_plant,
    without_review,
)
from ldctoolkit.review.loop_numbers import MISMATCH, LoopNumbers, design_margins

__all__ = [
    "BEND",
    "MISMATCH",
    "SPEEDS",
    "Finding",
    "LoopNumbers",
    "Review",
    "Severity",
    "Thresholds",
    "design_margins",
    "review",
    "review_plant",
    "without_review",
]
