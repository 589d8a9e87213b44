"""Which scenarios two studies share: the same departures to the bit, and the same numbers drawn for them."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from ldctoolkit import Scenarios
from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.departures import LEFT, RIGHT
from ldctoolkit.paths.random_streams import RandomStream
from ldctoolkit.plant_options import PlantOptions


@dataclasses.dataclass(frozen=True)
class SharedScenarios:
    """Scenarios that two sets hold, as positions in each."""

    # (n,) Position of each in the old and in the new set, in the order of the new one
    old: IntArray
    new: IntArray
    side: IntArray  # (n,) ``LEFT`` (+1) or ``RIGHT`` (-1)
    # Scenarios whose departure both sets hold, but for which other numbers were drawn; they are not shared
    other_draws: int = 0

    @property
    def n(self) -> int:
        """Number of shared scenarios."""
        return int(self.old.size)

    @property
    def left(self) -> int:
        """Those to the left."""
        return int(np.sum(self.side == LEFT))

    @property
    def right(self) -> int:
        """Those to the right."""
        return int(np.sum(self.side == RIGHT))

    def take(self, rows: BoolArray) -> SharedScenarios:
        """Some of them."""
        return dataclasses.replace(self, old=self.old[rows], new=self.new[rows], side=self.side[rows])


def drawn_streams(options: PlantOptions) -> frozenset[RandomStream]:
    """What a plant draws for each scenario beside its parameters."""
    ranges = (getattr(options.mismatch, field.name) for field in dataclasses.fields(options.mismatch))
    uses = {
        RandomStream.MISMATCH: any(low != high for low, high in ranges),
        RandomStream.RESIDUAL_Y: options.residuals.y,
        RandomStream.RESIDUAL_V: options.residuals.v,
        RandomStream.CAMERA: options.sensors.e_y_noise > 0 or options.sensors.e_psi_noise > 0,
        RandomStream.CURVATURE: options.sensors.curvature_noise > 0,
    }
    return frozenset(stream for stream, used in uses.items() if used)


def share_scenarios(
    old: Scenarios, new: Scenarios, *, both_draw: bool = False, same_seed: bool = True
) -> SharedScenarios:
    """Find the scenarios that two sets share, by content."""
    group = _same_rows(np.concatenate([_rows(old), _rows(new)]))
    old_at, new_at = _pairs(group[: old.n], group[old.n :])
    if both_draw:
        every = new_at.size
        numbers = np.concatenate([old.index, new.index])
        drawn = _same_rows(np.column_stack([group, numbers]))
        old_at, new_at = _pairs(drawn[: old.n], drawn[old.n :])
        if not same_seed:
            old_at, new_at = old_at[:0], new_at[:0]
        return SharedScenarios(old_at, new_at, new.side[new_at], every - new_at.size)
    return SharedScenarios(old_at, new_at, new.side[new_at])


def _rows(scenarios: Scenarios) -> FloatArray:
    return np.column_stack([scenarios.side.astype(np.float64), scenarios.matrix()]) + 0.0  # -0.0 is 0.0


def _same_rows(table: npt.NDArray[np.generic]) -> IntArray:
    """A number for each row, equal for rows of the same bytes."""
    table = np.ascontiguousarray(table)
    whole = table.view(np.dtype((np.void, table.dtype.itemsize * table.shape[1]))).ravel()
    group: IntArray = np.unique(whole, return_inverse=True)[1].astype(np.int64).ravel()
    return group


def _pairs(old: IntArray, new: IntArray) -> tuple[IntArray, IntArray]:
    """Positions of equal numbers, the k-th occurrence with the k-th, in the order of `new`."""
    most = max(old.size, new.size, 1)
    _, old_at, new_at = np.intersect1d(
        old * most + _occurrence(old), new * most + _occurrence(new), assume_unique=True, return_indices=True
    )
    order = np.argsort(new_at, kind="stable")
    return old_at[order].astype(np.int64), new_at[order].astype(np.int64)


def _occurrence(group: IntArray) -> IntArray:
    """How often each number occurred before."""
    order = np.argsort(group, kind="stable")
    ordered = group[order]
    first = np.searchsorted(ordered, ordered, side="left")
    count = np.empty(group.size, dtype=np.int64)
    count[order] = np.arange(group.size) - first
    return count
