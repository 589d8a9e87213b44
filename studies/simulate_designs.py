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

from ldctoolkit import (
    BicycleModel,
    Controller,
    EventStatus,
    LdcError,
    Scenarios,
    VehicleParameters,
    controller_names,
    register,
)
from ldctoolkit.law_errors import raised
from ldctoolkit.plant_options import PlantOptions
from ldctoolkit.simulation import InitialYawRate, Run, Takeover, Window, drive, drive_many
from ldctoolkit.vehicle import Convention
from studies.design import Design
from studies.results import per_scenario
from studies.run_table import FailedRun, LawTime, RunResult
from studies.steadiness import first_departures, kept_state

_TAKEOVERS_KEPT = 4

_NOT_OF_A_LAW = (KeyboardInterrupt, GeneratorExit)
"""What ends a study even where it comes out of a law."""


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
    options : PlantOptions
        What differs from the ideal plant.
    settle : float [s]
        How long the loop goes on after a departure's end.
    seed : int
        Of what is drawn for each scenario.
    """

    scenarios: Scenarios
    vehicle: VehicleParameters
    dt: float
    windows: tuple[Window, ...]
    initial_yaw_rate: InitialYawRate
    options: PlantOptions
    settle: float
    seed: int


@dataclasses.dataclass(frozen=True)
class Block:
    """Designs of one threshold and convention, which share a takeover."""

    convention: Convention
    designs: tuple[Design, ...]


class Simulator:
    """Runs blocks of one job; keeps the last few takeovers, which designs of one threshold share.

    Every design of a `SteeringLaw` drives a few of its departures once more, and fails if they do not give the numbers
    that are stored. So its fate does not depend on the order, the blocks or the workers, with one exception that no
    check can rule out: a law with hidden state of the whole process, which settles before this design runs or changes
    only after it, behaves here as what ran before in the same process made it.
    """

    def __init__(self, job: Job) -> None:
        self.job = job
        self._takeovers: dict[tuple[float, Convention], Takeover] = {}
        self._few: dict[tuple[float, Convention], tuple[npt.NDArray[np.int64], Takeover]] = {}

    def takeover(self, y_s: float, convention: Convention) -> Takeover:
        """The scenarios at their triggers."""
        key = (y_s, convention)
        if key not in self._takeovers:
            while len(self._takeovers) >= _TAKEOVERS_KEPT:
                oldest = next(iter(self._takeovers))
                del self._takeovers[oldest]
                self._few.pop(oldest, None)
            self._takeovers[key] = Takeover.build(
                self.job.scenarios,
                BicycleModel(self.job.vehicle, convention),
                y_s=y_s,
                dt=self.job.dt,
                initial_yaw_rate=self.job.initial_yaw_rate,
                options=self.job.options,
                seed=self.job.seed,
                settle=self.job.settle,
            )
        return self._takeovers[key]

    def run(self, block: Block) -> list[RunResult | FailedRun]:
        """Every design of a block; one whose law raises, gives what no law may give, or keeps state, has failed."""
        self.takeover(block.designs[0].y_s, block.convention)  # what this raises is no fault of a law
        try:
            results: list[RunResult | FailedRun] = [*self._together(block)]
        except _NOT_OF_A_LAW:
            raise
        except BaseException:  # a controller may be anybody's code
            # which design it was is not known: one after the other, the one that raises is named
            results = [self._alone(design, block.convention) for design in block.designs]
        return [self._steady(*pair, block.convention) for pair in zip(block.designs, results, strict=True)]

    def _together(self, block: Block) -> list[RunResult]:
        """All designs in one go over the scenarios, as far as their laws allow."""
        takeover = self.takeover(block.designs[0].y_s, block.convention)
        controllers = [design.controller(block.convention) for design in block.designs]
        runs = drive_many(controllers, takeover, threads=1)
        return [self._result(design, block.convention, run) for design, run in zip(block.designs, runs, strict=True)]

    def _alone(self, design: Design, convention: Convention) -> RunResult | FailedRun:
        try:
            return self._together(Block(convention, (design,)))[0]
        except _NOT_OF_A_LAW:
            raise
        except BaseException as error:
            return FailedRun((design.id, convention), raised(error))

    def _steady(self, design: Design, result: RunResult | FailedRun, convention: Convention) -> RunResult | FailedRun:
        """The result, unless a few departures, driven once more, give other numbers."""
        # only the steps of a steering law take time: linear laws and recorded paths have no code that runs again
        if isinstance(result, FailedRun) or result.law_time is None or not result.law_time.seconds:
            return result
        key = (design.y_s, convention)
        takeover = self.takeover(*key)
        if key not in self._few:
            self._few[key] = first_departures(takeover, self.job.initial_yaw_rate, self.job.settle)
        rows, few = self._few[key]
        try:
            run = drive(design.controller(convention), few, threads=1)
            reason = kept_state(result, rows, self._result(design, convention, run))
            if reason:  # state, or a law that minds its neighbours? all of them once more tell
                run = drive(design.controller(convention), takeover, threads=1)
                reason = kept_state(result, np.arange(result.status.size), self._result(design, convention, run))
        except _NOT_OF_A_LAW:
            raise
        except BaseException as error:  # it did not raise the first time
            reason = f"driven a second time: {raised(error)}"
        return FailedRun(result.key, reason) if reason else result

    def _result(self, design: Design, convention: Convention, run: Run) -> RunResult:
        # two windows are two ways to score the same run
        outcomes = [run.outcome(window) for window in self.job.windows]
        first = outcomes[0]
        driven = first.status != EventStatus.INVALID
        if not all(np.isfinite(outcome.S[driven]).all() for outcome in outcomes):
            raise LdcError("S is not finite in some scenario")
        return RunResult(
            key=(design.id, convention),
            S=np.stack([outcome.S for outcome in outcomes]),
            S_uncorrected=np.stack([outcome.S_uncorrected for outcome in outcomes]),
            status=first.status,
            companions=per_scenario(first.companions, lambda values: values.astype(np.float32)),
            failed_solves=first.failed_solves.astype(np.int32),
            law_time=LawTime(first.law_seconds, _commands(run)),
        )


def _commands(run: Run) -> int:
    """Scenarios times samples that a run has a command for; one that diverges counts as if driven to the end."""
    over = run.takeover
    return int(np.sum(over.full_steps + over.settle + (over.rest > 0)))


_simulator: Simulator | None = None
_computing = False
_ended = False


def start_worker(job: Job, controllers: Sequence[type[Controller]]) -> None:
    """Make a fresh process ready; classes that were only registered in the parent are registered here too."""
    global _simulator
    # the parent decides what an interrupt means; a group of its own, because solvers (OSQP) catch the signal themselves
    # and would report an interrupted solve as a failed one
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _end)
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


def _end(signum: int, frame: object) -> None:  # noqa: ARG001
    """End this process, but not while it sends: the parent would wait for the rest of a result that never comes.

    At the second time in any case: the pool asks so once nothing reads results any more.
    """
    global _ended
    if _computing or _ended:
        os._exit(1)
    _ended = True


def work(block: Block) -> list[RunResult | FailedRun]:
    """One block, in a worker process."""
    global _computing
    if _simulator is None:
        raise LdcError("a worker process was not started by run_study")
    _computing = True
    if _ended:
        os._exit(1)
    try:
        return _simulator.run(block)
    finally:
        _computing = False
