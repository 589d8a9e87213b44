"""Settings of a scenario model's fits, checked."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any, Final

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.departures import PARAMETER_NAMES
from ldctoolkit.errors import InputError, nearest
from ldctoolkit.mixture.checks import check_components
from ldctoolkit.scenario_model.bounds import WantedBounds
from ldctoolkit.scenario_model.card import FitSettings

TRANSFORMS: Final = ("none", "log", "logit", "auto")


@dataclasses.dataclass(frozen=True)
class SideSettings:
    """How each side is fitted.

    Attributes
    ----------
    components : int or tuple of int
        K, or the K to choose from in ascending order.
    seed : int
        Of the fits.
    bounds : WantedBounds
        Of each parameter.
    transform : dict of str to str
        Of each parameter: ``"none"``, ``"log"``, ``"logit"`` or ``"auto"``.
    fit : FitSettings
        Choice of K, prior, tolerance, starts.
    workers : int, optional
        Cores; all by default.
    verbose : bool
        Tell of every start and pass on stderr.
    """

    components: int | tuple[int, ...]
    seed: int
    bounds: WantedBounds
    transform: dict[str, str]
    fit: FitSettings
    workers: int | None
    verbose: bool

    def selection(self) -> dict[str, Any]:
        """Arguments of `select_components` but for the events and the box."""
        return dataclasses.asdict(self.fit) | {
            "random_state": self.seed,
            "n_jobs": self.workers,
            "verbose": int(self.verbose),
        }


def fit_settings(*values: Any) -> FitSettings:
    """Settings in Python's own numbers, as a file needs them; the fits check them."""
    return FitSettings(*(value.item() if isinstance(value, np.generic) else value for value in values))


def component_numbers(components: int | Iterable[int]) -> int | tuple[int, ...]:
    """K, or the K to choose from, in ascending order."""
    if isinstance(components, int | np.integer):
        return check_components([components])[0]
    return tuple(check_components(components))


def transforms(transform: str | Mapping[str, str] | None) -> dict[str, str]:
    """The wanted transform of each parameter."""
    if transform is None or isinstance(transform, str):
        return dict.fromkeys(PARAMETER_NAMES, _transform("transform", transform or "none"))
    out = dict.fromkeys(PARAMETER_NAMES, "none")
    for name, kind in transform.items():
        if name not in out:
            raise InputError(f"transform: no parameter {name!r}; {nearest(str(name), PARAMETER_NAMES)}")
        out[name] = _transform(f"transform[{name!r}]", kind)
    return out


def _transform(where: str, kind: Any) -> str:
    if kind not in TRANSFORMS:
        raise InputError(f"{where}: {kind!r}; {nearest(str(kind), TRANSFORMS)}")
    return str(kind)


def check_transform(wanted: Mapping[str, str], lower: FloatArray, upper: FloatArray) -> None:
    """Refuse a map that the bounds (8,) do not allow, by the parameter's name."""
    for j, name in enumerate(PARAMETER_NAMES):
        finite = int(np.isfinite(lower[j])) + int(np.isfinite(upper[j]))
        needed = {"log": 1, "logit": 2}.get(wanted[name], finite)
        if finite != needed:
            allowed = "one finite bound" if needed == 1 else "two finite bounds"
            raise InputError(
                f"transform[{name!r}]: {wanted[name]!r} with the bounds {lower[j]:g} to {upper[j]:g}; allowed: with "
                f"{allowed}"
            )
