"""The work of one worker: designs on all scenarios, from plain data."""

from __future__ import annotations

import dataclasses
import os
import signal
import threading
import time
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ldctoolkit import BicycleModel, Controller, LdcError, Scenarios, VehicleParameters, controller_names, register
from ldctoolkit.simulation import InitialYawRate, Takeover, Window, drive
from ldctoolkit.vehicle import Convention
from studies.design import Design
from studies.store import RunResult

FloatArray = npt.NDArray[np.float64]

_TAKEOVERS_KEPT = 4


@dataclasses.dataclass(frozen=True)
class Job:
    """What all designs of a study share; sent to each worker once.

    Attributes
    ----------
    scenarios : Scenarios
        n departures.
    vehicle : VehicleParameters
    dt : float [s]
    windows : tuple of {"departure", "control"}
    initial_yaw_rate : {"path", "zero"}
    """

    scenarios: Scenarios
    vehicle: VehicleParameters
    dt: float
    windows: tuple[Window, ...]
    initial_yaw_rate: InitialYawRate


@dataclasses.dataclass(frozen=True)
class Block:
    """Designs of one threshold and convention, which share a takeover."""

    convention: Convention
    designs: tuple[Design, ...]


class Simulator:
    """Runs blocks of one job; keeps the last few takeovers, which designs of one threshold share."""

    def __init__(self, job: Job) -> None:
        self.job = job
        self._takeovers: dict[tuple[float, Convention], Takeover] = {}

    def takeover(self, y_s: float, convention: Convention) -> Takeover:
        """The scenarios at their triggers."""
        key = (y_s, convention)
        if key not in self._takeovers:
            while len(self._takeovers) >= _TAKEOVERS_KEPT:
                del self._takeovers[next(iter(self._takeovers))]
            self._takeovers[key] = Takeover.build(
                self.job.scenarios,
                BicycleModel(self.job.vehicle, convention),
                y_s=y_s,
                dt=self.job.dt,
                initial_yaw_rate=self.job.initial_yaw_rate,
            )
        return self._takeovers[key]

    def run(self, block: Block) -> list[RunResult]:
        """Every design of a block.

        Raises
        ------
        LdcError
            Naming the design whose controller raised or gave numbers that are not finite.
        """
        return [self._one(design, block.convention) for design in block.designs]

    def _one(self, design: Design, convention: Convention) -> RunResult:
        try:
            run = drive(design.controller(convention), self.takeover(design.y_s, convention))
        except Exception as error:  # a controller may be anybody's code: whatever it raises must name the design
            kind = "" if isinstance(error, LdcError) else f"{type(error).__name__}: "
            raise LdcError(f"design {design.id} ({design.label}): {kind}{error}") from error
        # two windows are two ways to score the same run
        outcomes = [run.outcome(window) for window in self.job.windows]
        first = outcomes[0]
        if not all(np.isfinite(outcome.S).all() for outcome in outcomes):
            raise LdcError(f"design {design.id} ({design.label}): S is not finite in some scenario")
        return RunResult(
            key=(design.id, convention),
            S=np.stack([outcome.S for outcome in outcomes]),
            S_uncorrected=np.stack([outcome.S_uncorrected for outcome in outcomes]),
            status=first.status,
            deepest=first.deepest,
            failed_solves=first.failed_solves,
        )


_simulator: Simulator | None = None


def start_worker(job: Job, controllers: Sequence[type[Controller]]) -> None:
    """Make a fresh process ready; classes that were only registered in the parent are registered here too."""
    global _simulator
    # the parent decides what an interrupt means; a group of its own, because solvers (OSQP) catch the signal themselves
    # and would report an interrupted solve as a failed one
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "setpgrp"):
        os.setpgrp()
    threading.Thread(target=_leave_with, args=(os.getppid(),), daemon=True).start()
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    for controller in controllers:
        if controller.name not in controller_names():
            register(controller)
    _simulator = Simulator(job)


def _leave_with(parent: int) -> None:
    """End this process soon after its parent was killed: nobody would read what it computes."""
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)


def work(block: Block) -> list[RunResult]:
    """One block, in a worker process."""
    if _simulator is None:
        raise LdcError("a worker process was not started by run_study")
    return _simulator.run(block)
