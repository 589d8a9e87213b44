"""The contract of a designer's metric, as one call in a test of its author's."""

from __future__ import annotations

import dataclasses
import pickle
import sys
from collections.abc import Callable, Iterator
from typing import ClassVar

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.code_content import modules_of
from ldctoolkit.control import Controller, LinearLaw
from ldctoolkit.declared import gain
from ldctoolkit.errors import InputError, LdcError
from ldctoolkit.metrics import UserMetric
from ldctoolkit.scenario_model import load_model
from ldctoolkit.setup import Setup
from ldctoolkit.simulation import Paths, Takeover, drive_many
from ldctoolkit.simulation.sampled_paths import PathSampler, checked_values
from ldctoolkit.testing.contract import ContractError, Fault
from ldctoolkit.vehicle import Plant


@dataclasses.dataclass(frozen=True)
class _Feedback(Controller):
    """Steer against offset and heading; a negative gain drives off the road."""

    name: ClassVar[str] = "feedback"
    title: ClassVar[str] = "Feedback"
    K: float = gain(0.02, unit="rad/m", description="gain on e_y")

    def prepare(self, plant: Plant) -> LinearLaw:
        n = plant.n
        F = np.tile([-self.K, 0.0, -10.0 * self.K, 0.0], (n, 1))
        return LinearLaw(F, np.zeros(1), plant.steady_state().delta[:, None], np.zeros((n, 1)), np.zeros(n))


def check_metric(metric: UserMetric, setup: Setup | None = None) -> None:
    """Raise a `ContractError` with every fault of a designer's metric: shape and type, the same numbers when called
    again, with other departures or from the other side, no number unknown, nothing written, a way to worker processes.

    Parameters
    ----------
    metric : UserMetric
        Made with `ldctoolkit.metric`.
    setup : Setup, optional
        Vehicle and plant of the departures that it is tried on.

    Examples
    --------
    >>> import numpy as np
    >>> import ldctoolkit as ldc
    >>> @ldc.metric(unit="m")
    ... def widest(paths):
    ...     return np.nanmax(np.abs(paths.e_y), axis=1)
    >>> check_metric(widest)
    """
    if not isinstance(metric, UserMetric):
        raise InputError("metric", value=metric, allowed="a function with the decorator @ldc.metric(unit=...)")
    # left and right, in bends, some never taken over; the second design drives all others off the road
    over = Takeover.build(load_model("reference").sample(20, 20, seed=1), setup or Setup(), y_s=0.2)
    sampler, faults = PathSampler(over, (metric,)), []
    for run in drive_many([_Feedback(), _Feedback(K=-0.2)], over, paths=True):
        for _, paths in sampler.parts(run):
            faults += [Fault(metric.name, check, sentence) for check, sentence in _faults(metric, paths)]
    if faults:
        raise ContractError(dict.fromkeys(faults))


def _faults(metric: UserMetric, paths: Paths) -> Iterator[tuple[str, str]]:
    try:
        values = checked_values(metric, paths)
        if unknown := int(np.isnan(values).sum()):
            yield "known", f"NaN in {unknown} of {paths.n} departures, whose mean is then unknown; allowed: numbers"
        order = np.arange(paths.n)[::-1]
        mirrored = dataclasses.replace(paths, side=-paths.side)
        others: dict[str, Callable[[], FloatArray]] = {
            "repeated": lambda: checked_values(metric, paths),
            "neighbours": lambda: checked_values(metric, paths.take(order))[order],
            "alone": lambda: np.concatenate([checked_values(metric, paths.take([i])) for i in order])[order],
            "side": lambda: checked_values(metric, mirrored),
            "worker": lambda: checked_values(_sent(metric), paths),
        }
        for check, again in others.items():
            if not np.array_equal(values, other := again(), equal_nan=True):
                i = int(np.flatnonzero(~((values == other) | np.isnan(values)))[0])
                yield check, f"{values[i]!r} becomes {other[i]!r}; allowed: the same bits"
    except LdcError as error:
        yield "values", error.without_path


def _sent(metric: UserMetric) -> UserMetric:
    """The metric as a worker process has it."""
    import cloudpickle

    by_value = [sys.modules[name] for name in modules_of(metric.function) if name in sys.modules]
    known = cloudpickle.list_registry_pickle_by_value()
    for module in (added := [module for module in by_value if module.__name__ not in known]):
        cloudpickle.register_pickle_by_value(module)
    try:
        sent: UserMetric = pickle.loads(cloudpickle.dumps(metric))
        return sent
    except Exception as error:  # whatever a function may hold
        raise LdcError(metric.name, f"cannot be sent to a worker process: {type(error).__name__}: {error}") from None
    finally:
        for module in added:
            cloudpickle.unregister_pickle_by_value(module)
