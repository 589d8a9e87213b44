"""How well a fitted mixture describes events: numbers and warnings, no plots."""

from ldctoolkit.diagnostics._marginals import (
    Calibration,
    Component,
    Marginal,
    ModelDiagnostics,
    ModelMarginal,
    PairDensity,
    SideDiagnostics,
    Strip,
    bin_edges,
    box_share,
    kolmogorov_limit,
    model_marginal,
)
from ldctoolkit.diagnostics.diagnosis import diagnose, diagnose_model

__all__ = [
    "Calibration",
    "Component",
    "Marginal",
    "ModelDiagnostics",
    "ModelMarginal",
    "PairDensity",
    "SideDiagnostics",
    "Strip",
    "bin_edges",
    "box_share",
    "diagnose",
    "diagnose_model",
    "kolmogorov_limit",
    "model_marginal",
]
