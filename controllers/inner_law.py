"""A law inside another: its design from two words of text, and linear laws stepped like all others."""

from __future__ import annotations

import dataclasses
from typing import Any, final

import numpy as np
import numpy.typing as npt

from ldctoolkit import Controller, EventStatus, Gain, LinearLaw, Plant, Preview, SteeringLaw, controller_class
from ldctoolkit.errors import InputError, UnknownNameError, nearest

FloatArray = npt.NDArray[np.float64]


def inner_design(inner: str, inner_gains: str, owner: type[Controller]) -> Controller:
    """The design that the options `inner` and `inner_gains` of a law name.

    Parameters
    ----------
    inner : str
        Registry key of a law that steers and is not the owner.
    inner_gains : str
        ``"gain=value, gain=value"``; empty for the defaults.
    owner : type
        The law whose options they are, for messages.

    Returns
    -------
    Controller

    Raises
    ------
    InputError
        For a law that cannot be inside, or a gain that is written wrongly or lies outside its declaration.
    UnknownNameError
        For an unknown law or gain, with the nearest name.

    Examples
    --------
    >>> from controllers.barrier_filter import BarrierFilter
    >>> inner_design("preview_proportional", "K_y=-0.02, T_lp=0.5", BarrierFilter).T_lp
    0.5
    """
    try:
        kind = controller_class(inner)
    except UnknownNameError as error:
        raise UnknownNameError(f"{owner.name}.inner: {str(error).removeprefix('law ')}") from None
    if issubclass(kind, owner):
        raise InputError(f"{owner.name}.inner: {inner!r}; allowed: a law other than itself")
    if inner == "none":
        raise InputError(f"{owner.name}.inner: 'none'; allowed: a law that steers, the recorded path has no command")
    where = f"{owner.name}.inner_gains"
    declared = {gain.name: gain for gain in kind.gains()}
    given: dict[str, Any] = {}
    for entry in inner_gains.split(",") if inner_gains.strip() else ():
        name, equals, value = (part.strip() for part in entry.partition("="))
        if not (name and equals and value):
            raise InputError(f"{where}: {entry.strip()!r}; allowed: gain=value, separated by commas")
        if name not in declared:
            raise UnknownNameError(f"{where}: {inner}.{name}: no such gain; {nearest(name, declared)}")
        if name in given:
            raise InputError(f"{where}: {name!r} is given twice; allowed: once")
        given[name] = _value(declared[name], value)
    try:
        return kind(**given)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _value(declared: Gain, word: str) -> Any:
    """What a word stands for; the gain's own check names what is not allowed."""
    if declared.choices or declared.text:
        return word
    if isinstance(declared.default, bool):
        return {"true": True, "false": False}.get(word, word)
    try:
        return float(word)
    except ValueError:
        return word


def steering_law(design: Controller, plant: Plant, owner: str) -> SteeringLaw:
    """Prepare a design as a law that is stepped, whatever its kind.

    Parameters
    ----------
    design : Controller
    plant : Plant
        Model, speeds (n,) and sample time.
    owner : str
        The law around it, for messages.

    Returns
    -------
    SteeringLaw

    Raises
    ------
    InputError
        If it does not steer.
    """
    law = design.prepare(plant)
    if isinstance(law, LinearLaw):
        return LinearSteps(law, plant.dt)
    if isinstance(law, SteeringLaw):
        return law
    what = type(law).__name__
    raise InputError(f"{owner}.inner: {design.name!r} prepared a {what}; allowed: a LinearLaw or a SteeringLaw")


@final
@dataclasses.dataclass(frozen=True)
class LinearSteps(SteeringLaw):
    """A linear law, one call a sample; its state is z, the integral of e_y.

    Sums are made column by column: a scenario's command has the same bits in a batch of any size.

    Attributes
    ----------
    law : LinearLaw
    dt : float [s]

    Examples
    --------
    >>> import numpy as np
    >>> from controllers.lqr import LQR
    >>> from ldctoolkit import BicycleModel, Plant
    >>> plant = Plant.build(BicycleModel(), [20.0], 0.05)
    >>> LinearSteps(LQR().prepare(plant), plant.dt).preview_times
    array([0.])
    """

    law: LinearLaw
    dt: float

    @property
    def preview_times(self) -> FloatArray:
        """Those of the linear law."""
        return self.law.preview_times

    def init(self, n: int) -> FloatArray:
        """No integral yet."""
        return np.zeros(n)

    def step(
        self, t: FloatArray, x: FloatArray, preview: Preview, delta_prev: FloatArray, state: FloatArray
    ) -> tuple[FloatArray, FloatArray, npt.NDArray[np.int8]]:
        """The weighted sum, and z for the next sample."""
        law = self.law
        delta = law.f_u * delta_prev
        if law.f_i is not None:
            delta += law.f_i * state
        for i in range(4):
            delta += law.F[:, i] * x[:, i]
        for j in range(law.preview_times.size):
            delta += law.G_yaw_rate[:, j] * preview.yaw_rate[:, j] + law.G_heading[:, j] * preview.heading[:, j]
        return delta, state + self.dt * x[:, 0], np.full(delta.size, EventStatus.OK, dtype=np.int8)

    def take(self, rows: npt.NDArray[np.int64], state: FloatArray) -> tuple[LinearSteps, FloatArray]:
        """Only some scenarios."""
        law = self.law
        kept = dataclasses.replace(
            law,
            F=law.F[rows],
            G_yaw_rate=law.G_yaw_rate[rows],
            G_heading=law.G_heading[rows],
            f_u=law.f_u[rows],
            f_i=None if law.f_i is None else law.f_i[rows],
        )
        return LinearSteps(kept, self.dt), state[rows]
