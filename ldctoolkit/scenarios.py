"""Scenarios: lane departures to be replayed, and the model that generates them."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import IntArray
from ldctoolkit.departures import LEFT, RIGHT, DepartureParameters
from ldctoolkit.errors import InputError

SPEED_FLOOR = 1.0
"""Lowest speed [m/s] at which a scenario can be replayed: the vehicle model divides by the speed."""


@dataclasses.dataclass(frozen=True)
class Scenarios(DepartureParameters):
    """n departures to be replayed: side and the eight parameters, arrays of n, outward frame.

    Built with `from_arrays`, which checks them, or by ``ScenarioModel.sample``.

    Attributes
    ----------
    index : (n,) int
        Each scenario's number, 0 to n - 1 when it was made, kept by `take`: what is drawn for a scenario follows from
        the seed and this number.
    """

    index: IntArray

    @classmethod
    def from_arrays(
        cls,
        *,
        T: npt.ArrayLike,
        d_y: npt.ArrayLike,
        v_mean: npt.ArrayLike,
        a_mean: npt.ArrayLike = 0.0,
        c_0: npt.ArrayLike = 0.0,
        dc: npt.ArrayLike = 0.0,
        sigma_y: npt.ArrayLike = 0.0,
        sigma_v: npt.ArrayLike = 0.0,
        side: npt.ArrayLike = LEFT,
    ) -> Scenarios:
        """Build and check scenarios from arrays of n (scalars are repeated).

        Parameters
        ----------
        T, d_y, v_mean, a_mean, c_0, dc, sigma_y, sigma_v : (n,)
            The eight parameters in SI units, curvature in the outward frame.
        side : (n,) int
            +1 left, -1 right.

        Returns
        -------
        Scenarios
            n rows, float64.

        Raises
        ------
        InputError
            Naming the column, the row and what is allowed.

        Examples
        --------
        >>> from ldctoolkit import Scenarios
        >>> len(Scenarios.from_arrays(T=[2.0, 3.0], d_y=0.3, v_mean=25.0))
        2
        """
        given = {"side": side, "T": T, "d_y": d_y, "sigma_y": sigma_y, "v_mean": v_mean, "a_mean": a_mean}
        given |= {"sigma_v": sigma_v, "c_0": c_0, "dc": dc}
        try:
            columns = np.broadcast_arrays(*[np.atleast_1d(np.asarray(value, dtype=float)) for value in given.values()])
        except ValueError as error:
            raise InputError(f"scenarios: the columns do not have one common length ({error})") from None
        if columns[0].ndim != 1:
            raise InputError(f"scenarios: columns must be one-dimensional, got {columns[0].ndim} dimensions")
        named = dict(zip(given, (np.array(column) for column in columns), strict=True))
        _check(named)
        count = columns[0].size
        return cls(side=named.pop("side").astype(np.int64), index=np.arange(count, dtype=np.int64), **named)


def _check(column: dict[str, npt.NDArray[np.float64]]) -> None:
    def refuse(bad: npt.NDArray[np.bool_], name: str, allowed: str) -> None:
        if bad.any():
            row = int(np.argmax(bad))
            more = f" ({int(bad.sum())} rows in all)" if bad.sum() > 1 else ""
            raise InputError(f"scenarios: {name}[{row}] = {column[name][row]:g}; allowed: {allowed}{more}")

    for name in column:
        refuse(~np.isfinite(column[name]), name, "finite numbers")
    refuse(~np.isin(column["side"], (LEFT, RIGHT)), "side", f"{LEFT} (left) or {RIGHT} (right)")
    refuse(column["T"] <= 0, "T", "> 0 s")
    for name in ("d_y", "sigma_y", "sigma_v"):
        refuse(column[name] < 0, name, ">= 0")
    refuse(
        slowest_speed(column["v_mean"], column["a_mean"], column["T"]) < SPEED_FLOOR,
        "v_mean",
        f"the speed v_mean +- a_mean T/2 stays at or above {SPEED_FLOOR} m/s over the whole departure",
    )


def slowest_speed(v_mean: npt.ArrayLike, a_mean: npt.ArrayLike, T: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Lowest speed [m/s] of a departure whose speed changes linearly: v_mean - |a_mean| T/2."""
    return np.asarray(np.asarray(v_mean) - 0.5 * np.abs(np.asarray(a_mean)) * np.asarray(T), dtype=np.float64)
