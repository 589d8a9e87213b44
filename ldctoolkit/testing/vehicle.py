"""The contract of a vehicle model, as a check that its author runs in tests of their own."""

import copy
import pickle
from collections.abc import Iterator

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.errors import expect
from ldctoolkit.law_checks import raised
from ldctoolkit.registry import controller_class
from ldctoolkit.scenarios import Scenarios
from ldctoolkit.setup import Setup
from ldctoolkit.simulation import simulate
from ldctoolkit.testing.contract import ContractError, Fault
from ldctoolkit.vehicle import RecordedTurn, VehicleModel
from ldctoolkit.vehicle.vehicle_model import equations


def check_vehicle_model(
    model: VehicleModel | type[VehicleModel], speeds: tuple[float, ...] = (10.0, 20.0, 35.0)
) -> None:
    """Raise a `ContractError` with every fault of a vehicle model.

    It drives straight and in bends of 1 m/s^2 to either side at the speeds [m/s] with finite derivatives, and holds
    them; a scenario's numbers are the same beside others, in a second run and after the way to another process; what
    it is given stays as it is.

    Examples
    --------
    >>> import dataclasses, ldctoolkit as ldc
    >>> @dataclasses.dataclass(frozen=True)
    ... class Kinematic(ldc.VehicleModel):
    ...     symbolic, states = False, ("yaw",)
    ...     def derivatives(self, x, delta, v, v_rate, lane):
    ...         return {"yaw": (v * delta / 2.9 - x.yaw) / 0.15,
    ...                 "e_psi_rate": 20.0 * (x.yaw - self.yaw_rate(x, lane)),
    ...                 "e_y_rate": self.e_y_acceleration(x, v, v_rate, lane, v * x.yaw)}
    >>> check_vehicle_model(Kinematic)
    """
    if isinstance(model, type) and issubclass(model, VehicleModel):
        model = model()
    expect("model", model, VehicleModel)
    faults = []
    for check in (_turns, _repeats):
        try:
            faults += [Fault(type(model).__name__, check.__name__.strip("_"), text) for text in check(model, speeds)]
        except Exception as error:  # a designer's code may raise anything
            faults.append(Fault(type(model).__name__, check.__name__.strip("_"), raised(error)))
            break  # the other would end with the same
    if faults:
        raise ContractError(faults)


def _turns(model: VehicleModel, speeds: tuple[float, ...]) -> Iterator[str]:
    """Straight driving and bends at every speed, one by one and together."""
    v, a_y = (part.ravel() for part in np.meshgrid(speeds, (0.0, 1.0, -1.0)))
    zero = np.zeros_like(v)
    turn = RecordedTurn(zero, zero, zero, zero, v, zero, a_y / v, zero, zero)
    eq, before = equations(model), copy.deepcopy(turn)
    x, delta = eq.start(turn)
    if any(not np.array_equal(was, now) for was, now in zip(vars(before).values(), vars(turn).values(), strict=True)):
        yield "initial changes what it is given in place; allowed: new arrays"
    if model.advances:
        return
    p = np.column_stack([v, zero, a_y / v, delta])
    rates = eq.rates(x, p)
    for i in np.flatnonzero(np.abs(rates[:, [1, 3]]).max(axis=1) > 1e-6):
        yield f"no steady turn of {a_y[i]:g} m/s^2 at {v[i]:g} m/s; allowed: rates of e_y_rate and e_psi_rate of 0"
    alone = np.concatenate([eq.rates(x[i : i + 1], p[i : i + 1]) for i in range(v.size)])
    if not np.array_equal(alone, rates):
        yield "derivatives of a scenario depend on the others; allowed: elementwise functions"
    for i in np.flatnonzero(eq.a_y(x, p) * a_y < 0.0):
        yield f"a_y is {eq.a_y(x, p)[i]:.3g} m/s^2 in a bend of {a_y[i]:g}; allowed: the same sign, left positive"


def _repeats(model: VehicleModel, speeds: tuple[float, ...]) -> Iterator[str]:
    """Departures in the closed loop: again, alone, and with the model as another process gets it."""
    n = len(speeds)
    both = Scenarios.from_arrays(T=np.full(2 * n, 2.0), d_y=np.tile([0.3, 0.6], n), v_mean=np.repeat(speeds, 2),
                                 c_0=np.tile([1e-3, -1e-3], n), side=np.tile([1, -1], n))  # fmt: skip
    sent = pickle.loads(pickle.dumps(model))
    if sent.identity != model.identity:
        yield "has another identity after the way to another process"

    def score(car: VehicleModel, scenarios: Scenarios) -> FloatArray:
        law = controller_class("preview_proportional")()
        return simulate(law, scenarios, y_s=0.1, setup=Setup(vehicle_model=car, settle=0.5)).S

    S, alone = score(model, both), np.concatenate([score(model, both.take([i])) for i in range(2 * n)])
    others = (score(model, both), "in a second run"), (score(sent, both), "in another process"), (alone, "alone")
    for other, what in others:
        for i in np.flatnonzero(other != S)[:1]:
            yield f"S of a departure is {S[i]:.17g} m s, and {other[i]:.17g} {what}; allowed: the same bits"
