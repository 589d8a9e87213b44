"""How well a fitted mixture describes events: numbers and warnings, no plots."""

from ldctoolkit.diagnostics._marginals import box_share
from ldctoolkit.diagnostics.diagnosis import diagnose, diagnose_model
from ldctoolkit.diagnostics.parts import (
    Calibration,
    Comparison,
    Component,
    Marginal,
    ModelDiagnostics,
    PairDensity,
    SideDiagnostics,
    Strip,
)

__all__ = [
    "Calibration",
    "Comparison",
    "Component",
    "Marginal",
    "ModelDiagnostics",
    "PairDensity",
    "SideDiagnostics",
    "Strip",
    "box_share",
    "diagnose",
    "diagnose_model",
]
