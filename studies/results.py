"""The results of a study, in memory: what the store reads and what ranking and report are made from."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from ldctoolkit import Scenarios
from ldctoolkit.simulation import Window
from ldctoolkit.vehicle import Convention
from studies.design import Design

FloatArray = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Case:
    """One way to score a study: the window of S and the reading of the paper."""

    window: Window
    convention: Convention

    @property
    def label(self) -> str:
        """``"departure window, consistent"``."""
        return f"{self.window} window, {self.convention.replace('_', ' ')}"


@dataclasses.dataclass(frozen=True)
class CaseResults:
    """Per-scenario results of all d designs on all n scenarios in one case.

    Attributes
    ----------
    case : Case
    S : (d, n) [m s]
    S_uncorrected : (d, n) [m s]
        The recorded path's score over the same window; equal for all designs in the departure window, dependent on the
        design's y_s in the control window.
    status : (d, n) int8
        `ldctoolkit.EventStatus`.
    deepest : (d, n) [m]
        Deepest position of the edge beyond the line.
    failed_solves : (d, n) int
    """

    case: Case
    S: FloatArray
    S_uncorrected: FloatArray
    status: npt.NDArray[np.int8]
    deepest: FloatArray
    failed_solves: npt.NDArray[np.int64]


@dataclasses.dataclass(frozen=True)
class StudyResults:
    """Everything a finished study knows.

    Attributes
    ----------
    designs : tuple of Design
        d designs, in the study's own order.
    scenarios : Scenarios
        The n scenarios that every design was run on: left ones first.
    cases : tuple of CaseResults
        The first one is the study's primary case.
    """

    designs: tuple[Design, ...]
    scenarios: Scenarios
    cases: tuple[CaseResults, ...]
