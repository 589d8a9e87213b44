"""The sampled nominal plant, driven sample by sample, and its closed loop about the lane's centre."""

from collections.abc import Callable

import numpy as np

from ldctoolkit import BicycleModel, LinearLaw, Plant

DT = 0.05


def plant_at(*v: float, model: BicycleModel | None = None, dt: float = DT) -> Plant:
    return Plant.build(model or BicycleModel(), np.array(v), dt)


def weights_of(law: LinearLaw, i: int) -> np.ndarray:
    """Of the state, the wheel angle and the commands on their way, in scenario i."""
    wheel = [] if law.f_wheel is None else [law.f_wheel[i]]
    past = [] if law.f_past is None else law.f_past[i]
    return np.array([*law.F[i], *wheel, *([law.f_u[i]] if law.f_u.any() else []), *past])


def moved(
    plant: Plant, x: np.ndarray, delta: np.ndarray, r: np.ndarray | float = 0.0, r_next: np.ndarray | None = None
) -> np.ndarray:
    """The state (n, 4) one sample later; the lane's yaw rate goes from r to r_next, or stays."""
    step, now = plant.step, np.broadcast_to(r, delta.shape)[:, None]
    after = now if r_next is None else r_next[:, None]
    return np.einsum("nij,nj->ni", step.A, x) + step.B * delta[:, None] + step.E_0 * now + step.E_1 * after


def closed_loop_matrices(plant: Plant, command: Callable[[np.ndarray], np.ndarray], small: float = 1e-5) -> np.ndarray:
    """(n, 4, 4) under a law without memory, given as commands (n,) for states (n, 4)."""
    loop = np.zeros((plant.n, 4, 4))
    for i in range(4):
        x = np.zeros((plant.n, 4))
        x[:, i] = small
        loop[:, :, i] = moved(plant, x, command(x)) / small
    return loop
