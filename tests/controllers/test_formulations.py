"""A designer's own formulations against IPOPT on the same problem written plainly."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

import ldctoolkit as ldc
from helpers.closed_loop import DT, mpc_situations
from ldctoolkit import EventStatus

frozen = dataclasses.dataclass(frozen=True)
HARD = 0.05, 0.01  # rad, and rad a sample


class Own(ldc.PredictiveController):
    def limits(self, u: Any) -> list[Any]:
        return [(u.delta, -HARD[0], HARD[0]), (u.change, -HARD[1], HARD[1])]


@frozen
class Corridor(Own):
    name, title, horizon = "corridor", "Corridor", 10
    r: float = ldc.gain(300.0, unit="1/rad^2", lower=1.0, upper=1e6, description="weight on steering")
    width: float = ldc.gain(0.3, unit="m", lower=0.0, upper=2.0, description="corridor")

    def stage(self, x: Any, u: Any, lane: Any, k: Any) -> ldc.Stage:
        cost = x.e_y**2 + x.e_psi**2 + self.r * (u.delta - lane.steady_delta) ** 2
        return ldc.Stage(cost, self.limits(u), [ldc.Soft(x.e_y, -self.width, self.width, weight=20.0)])

    def terminal(self, x: Any, lane: Any) -> Any:
        return 10.0 * x.e_y**2 + 50.0 * x.e_psi**2 + x.e_y_rate**2


@frozen
class Saturating(Own):
    """A cost that is not convex far from the lane, and a state of its own: a leaky integral of e_y."""

    name, title, horizon, states = "saturating", "Saturating", 10, ("area",)
    r: float = ldc.gain(100.0, unit="1/rad^2", lower=1.0, upper=1e6, description="weight on steering")

    def dynamics(self, x: Any, u: Any, lane: Any, vehicle: Any) -> Any:
        return {**vehicle.nonlinear(x, u.delta, lane), "area": x.e_y - 0.5 * x.area}

    def stage(self, x: Any, u: Any, lane: Any, k: Any) -> ldc.Stage:
        cost = x.e_y**2 / (1 + x.e_y**2) + 0.3 * x.area**2 + 2 * x.e_psi**2 + self.r * u.delta**2 + 10 * u.change**2
        return ldc.Stage(cost, self.limits(u))

    def terminal(self, x: Any, lane: Any) -> Any:
        return 5.0 * ca.log(1 + x.e_y**2) + 20.0 * x.e_psi**2 + x.area**2 + x.e_y_rate**2


def corridor_cost(opti: Any, x: Any, u: Any, change: Any, steady: Any) -> Any:
    return x[0] ** 2 + x[2] ** 2 + 300 * (u - steady) ** 2


def saturating_cost(opti: Any, x: Any, u: Any, change: Any, steady: Any) -> Any:
    return x[0] ** 2 / (1 + x[0] ** 2) + 0.3 * x[4] ** 2 + 2 * x[2] ** 2 + 100 * u**2 + 10 * change**2


def corridor_end(x: Any) -> Any:
    return 10 * x[0] ** 2 + 50 * x[2] ** 2 + x[1] ** 2


def saturating_end(x: Any) -> Any:
    return 5 * ca.log(1 + x[0] ** 2) + 20 * x[2] ** 2 + x[4] ** 2 + x[1] ** 2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("design", "cost", "end", "width"),
    [(Corridor(), corridor_cost, corridor_end, 0.3), (Saturating(), saturating_cost, saturating_end, 0.0)],
    ids=["corridor", "saturating"],
)
def test_ipopt_finds_the_same_optimum(
    design: Any, cost: Callable[..., Any], end: Callable[[Any], Any], width: float
) -> None:
    """32 random problems each; the cost, penalties included, within 1e-6 relative; limits are active in many."""
    n, N, m = 32, design.horizon, 4 + len(design.states)
    plant, x, preview, prev = mpc_situations(n, N, seed=11, size=0.8)
    prev = np.clip(prev, -0.04, 0.04)
    law = design.prepare(plant)
    _, state, status = law.step(np.zeros(n), x, preview, prev, law.init(n))
    assert (status == EventStatus.OK).all()
    samples, predict = law.samples(preview.yaw_rate), law.form.program(N).predict

    def follow(i: int, z: Any, u: Any, before: Any, k: int) -> Any:
        """A sample; behind the states the formulation may keep the command before."""
        full = ca.vertcat(z, before)[: law.form.size]
        return predict(full, u, samples[i, k], law.columns[i])[0][:m]

    active = 0
    for i in range(n):
        opti = ca.Opti()
        X, U, slack = opti.variable(m, N), opti.variable(N), opti.variable(2 * N)
        total: Any = 0
        z: Any = ca.DM([*x[i], *[0.0] * (m - 4)])
        driven, start = z, []
        ours = 0.0
        for k in range(N):
            before, was = (U[k - 1], state.U[i, k - 1]) if k else (prev[i], prev[i])
            total += cost(opti, z, U[k], U[k] - before, samples[i, k, 3])
            ours += float(cost(opti, driven, state.U[i, k], state.U[i, k] - was, samples[i, k, 3]))
            opti.subject_to(X[:, k] == follow(i, z, U[k], before, k))
            driven = follow(i, driven, state.U[i, k], was, k)
            opti.subject_to(opti.bounded(-HARD[0], U[k], HARD[0]))
            opti.subject_to(opti.bounded(-HARD[1], U[k] - before, HARD[1]))
            z = X[:, k]
            start.append(np.asarray(driven).ravel())
            if width:
                opti.subject_to(z[0] <= width + slack[2 * k])
                opti.subject_to(z[0] >= -width - slack[2 * k + 1])
                beyond = max(abs(float(driven[0])) - width, 0.0)
                ours += 20 * (beyond + beyond**2 / 2)
        opti.subject_to(slack >= 0)
        total += 20.0 * (ca.sum1(slack) + ca.sumsqr(slack) / 2)
        opti.minimize(total + end(z))
        ours += float(end(driven))
        opti.set_initial(U, state.U[i])
        opti.set_initial(X, np.array(start).T)
        quiet = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-11}
        opti.solver("ipopt", quiet | {"ipopt.bound_relax_factor": 0.0, "ipopt.mu_init": 1e-5, "expand": True})
        theirs = float(opti.solve().value(opti.f))
        assert ours == pytest.approx(theirs, rel=1e-6)
        active += np.abs(np.diff(state.U[i], prepend=prev[i])).max() > HARD[1] - 1e-7
    assert active > n / 3
    assert plant.dt == DT
