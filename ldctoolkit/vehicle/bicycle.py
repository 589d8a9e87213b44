"""Linear bicycle model in lane-error coordinates (Rajamani, *Vehicle Dynamics and Control*, 2nd ed., eq. 2.45).

State x = (e_y, de_y/dt, e_psi, de_psi/dt), input delta (front steering angle), disturbance psi_l' (yaw rate of the
lane seen by the vehicle, v times curvature): dx/dt = A(v) x + B delta + E(v) psi_l'. Signs after ISO 8855.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import warnings
from typing import ClassVar, Final, Literal, Protocol, get_args

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, unmasked
from ldctoolkit.declared import (
    UnitWarning,
    check_declared,
    checked_number,
    declared,
    short_repr,
    unit_slip,
    warn_of_units,
)
from ldctoolkit.errors import CheckedArguments, InputError
from ldctoolkit.vehicle.discretization import AugmentedStep, Discretization, discretize


@dataclasses.dataclass(frozen=True)
class Plant:
    """The vehicle discretised once for a scenario set, shared by every design.

    It carries nothing of a scenario but its speed, so that a design cannot fit the scenarios that it is scored on.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> plant = ldc.Plant.build(ldc.BicycleModel(), [20.0, 30.0], 0.05)
    >>> plant.n, plant.dt
    (2, 0.05)
    """

    model: BicycleModel  # The continuous model
    v: FloatArray  # (n,) [m/s] Speed of each scenario, frozen at the trigger
    dt: float  # [s] Sample time of the controller
    lag: float = 0.0  # [s] Time constant of the nominal actuator; 0 for none
    delay: float = 0.0  # [s] From what the law sees to the effect of its command: of the nominal actuator, and `age`
    age: float = 0.0  # [s] Mean age of a frame of the nominal camera when the law first sees it; 0 of the lane ahead

    @classmethod
    def build(
        cls, model: BicycleModel, v: npt.ArrayLike, dt: float, *, lag: float = 0.0, delay: float = 0.0, age: float = 0.0
    ) -> Plant:
        """`model` at the speeds `v` (n,) [m/s] with the step `dt` [s]; `delay` includes `age`."""
        return cls(model, checked_speeds(v), float(dt), lag=lag, delay=delay, age=age)

    def at(self, v: npt.ArrayLike) -> Plant:
        """The same plant at other speeds (n,) [m/s]."""
        return Plant.build(self.model, v, self.dt, lag=self.lag, delay=self.delay, age=self.age)

    @functools.cached_property
    def step(self) -> Discretization:
        """One step of dt at each speed, of the vehicle alone; computed at its first use."""
        return self.model.discretize(self.v, self.dt)

    @functools.cached_property
    def augmented(self) -> AugmentedStep:
        """One sample behind the actuator at each speed, exact to rounding; computed once."""
        from ldctoolkit.vehicle.speed_schedule import sampled

        return sampled(self)

    @property
    def n(self) -> int:
        """Number of scenarios."""
        return int(self.v.shape[0])

    def steady_state(self) -> SteadyState:
        """Steady cornering at each scenario's speed, per unit of lane yaw rate; computed once for all designs."""
        return self._steady_state

    @functools.cached_property
    def _steady_state(self) -> SteadyState:
        return self.model.steady_state(self.v)


GRAVITY: Final = 9.81  # gravitational acceleration [m/s^2]

REAR_CORNERING_COEFFICIENT: Final = 20.0  # [1/rad] of an axle: lateral force per radian of slip and newton of load
LOADS_AGREE: Final = 0.01  # share of the mass that two axle loads, weighed and rounded, may miss it by
_NOTES: Final = {
    "yaw_inertia": "I_z = m l_f l_r, a dynamic index of 1 (usual: 0.8 to 1.2; 0.94, 1.00 and 1.10 in CommonRoad's "
    "vehicle models, 1.05 in Rajamani)",
    "rear_cornering_coefficient": f"rear axle's cornering stiffness = {REAR_CORNERING_COEFFICIENT:g}/rad times its "
    "load (usual: 12 to 26; 21.9 of the tyres in CommonRoad's vehicle models, 25 in Rajamani; compliance takes some)",
    "steering_ratio": "steering_ratio = 15 (usual: 13 to 18)",
    "width": "w_v = 1.9 m (usual without mirrors: 1.7 to 2.0)",
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class VehicleParameters(CheckedArguments):
    """Single-track vehicle and the lane it drives in; the defaults are the paper's Table I.

    Raises `InputError` where a value is not a finite number > 0, or the vehicle is not narrower than the lane.

    Attributes
    ----------
    C_af, C_ar : float [N/rad]
        Cornering stiffness of one front and one rear tyre.
    l_f, l_r : float [m]
        Distance from the centre of gravity to the front and rear axle.
    m : float [kg]
        Mass.
    I_z : float [kg m^2]
        Yaw inertia.
    w_l : float [m]
        Lane width.
    w_v : float [m]
        Vehicle width, less than the lane's.
    steering_ratio : float
        Angle of the steering wheel over that of the front wheels; an assumption of the usual size, not the paper's. It
        decides no path, only the steering wheel's velocity in tests of regulations.
    notes : tuple of str
        What `from_data_sheet` assumed, with source and usual range; empty for other vehicles.

    Examples
    --------
    >>> VehicleParameters().edge_offset
    0.85
    """

    __repr__ = short_repr
    notes: ClassVar[tuple[str, ...]] = ()

    C_af: float = declared(80000.0, unit="N/rad", above=0.0)
    C_ar: float = declared(80000.0, unit="N/rad", above=0.0)
    l_f: float = declared(1.43, unit="m", above=0.0)
    l_r: float = declared(1.47, unit="m", above=0.0)
    m: float = declared(1000.0, unit="kg", above=0.0)
    I_z: float = declared(3344.0, unit="kg m^2", above=0.0)
    w_l: float = declared(3.6, unit="m", above=0.0)
    w_v: float = declared(1.9, unit="m", above=0.0)
    steering_ratio: float = declared(15.0, above=0.0)

    def __post_init__(self) -> None:
        check_declared(self, "vehicle")
        if self.w_v >= self.w_l:
            raise InputError("vehicle.w_v", "m", value=self.w_v, allowed=f"less than the lane's width, {self.w_l!r} m")
        warn_of_units("vehicle", self)

    @classmethod
    def from_data_sheet(
        cls,
        *,
        mass: float,
        front_load: float | None = None,
        rear_load: float | None = None,
        wheelbase: float,
        understeer_gradient: float,
        steering_ratio: float | None = None,
        yaw_inertia: float | None = None,
        rear_cornering_coefficient: float | None = None,
        width: float | None = None,
        lane_width: float | None = None,
    ) -> VehicleParameters:
        """The vehicle of a data sheet; what is assumed for values that are not given is in its `notes`.

        Axle loads give the centre of gravity, m_f and m_r the masses on the axles. With the rear axle's stiffness C_r
        the understeer gradient K = m_f/C_f - m_r/C_r gives that of the front axle (T. D. Gillespie, *Fundamentals of
        Vehicle Dynamics*, 1992, chapter 6).

        Raises `InputError` for a value that no vehicle has, and for axle loads that do not add up to the mass. A value
        that is likely to be in another unit gives a `UnitWarning`.

        Parameters
        ----------
        mass : float [kg]
            Of the vehicle as it is driven, driver included.
        front_load, rear_load : float
            Load of the axle in kg, or its share of the mass, below 1; one of the two, or both.
        wheelbase : float [m]
        understeer_gradient : float [rad/(m/s^2)]
            Wheel angle, not steering wheel angle, per lateral acceleration; 1 deg/g is 0.00178.
        steering_ratio : float, optional
        yaw_inertia : float [kg m^2], optional
        rear_cornering_coefficient : float [1/rad], optional
            Cornering stiffness of the rear axle over its load in newtons, at most 100.
        width, lane_width : float [m], optional

        Examples
        --------
        >>> vehicle = VehicleParameters.from_data_sheet(
        ...     mass=1650.0, front_load=910.0, wheelbase=2.8, understeer_gradient=0.003, yaw_inertia=2800.0
        ... )
        >>> round(vehicle.l_f, 3), round(vehicle.C_ar)
        (1.256, 72594)
        >>> len(vehicle.notes)
        3
        """
        needed = ("mass", "wheelbase", "understeer_gradient")
        given = {key: value for key, value in locals().items() if key in needed or value is not None}
        del given["cls"], given["needed"]
        for name, value in given.items():
            least, most = -1.0 if "gradient" in name else 0.0, 100.0 if "coefficient" in name else math.inf
            given[name] = checked_number(f"data_sheet.{name}", value, above=least, upper=most)
            if slip := unit_slip(f"data_sheet.{name}", given[name]):
                warnings.warn(slip, UnitWarning, stacklevel=2)
        mass, wheelbase, gradient = (given[name] for name in needed)
        loads = {name: given[name] for name in ("front_load", "rear_load") if name in given}
        shares = {name: load if load < 1.0 else load / mass for name, load in loads.items()}
        if not loads:
            raise InputError("data_sheet.front_load", "missing, and so is rear_load", allowed="one of the two, or both")
        for name, share in shares.items():
            if not 0.2 <= share <= 0.8:
                what = "kg on the axle, or its share of the mass, from 0.2 to 0.8"
                raise InputError(f"data_sheet.{name}", f"of {mass:g} kg", value=loads[name], allowed=what)
        total = sum(shares.values()) if len(shares) == 2 else 1.0
        if abs(total - 1.0) > LOADS_AGREE + 1e-9:
            problem = f"and front_load add up to {total * mass:g} kg"
            allowed = f"the mass, {mass:g} kg, within {LOADS_AGREE:.0%}; not the highest loads that an axle may carry"
            raise InputError("data_sheet.rear_load", problem, value=loads["rear_load"], allowed=allowed)
        front = shares["front_load"] / total if "front_load" in shares else 1.0 - shares["rear_load"]
        l_f, l_r = wheelbase * (1.0 - front), wheelbase * front
        compliance = 1.0 / (given.get("rear_cornering_coefficient", REAR_CORNERING_COEFFICIENT) * GRAVITY)  # m_r/C_r
        if gradient + compliance <= 0.0:
            allowed = f"> {-compliance:.3g} rad/(m/s^2) with this rear axle; or a larger rear_cornering_coefficient"
            raise InputError("data_sheet.understeer_gradient", value=gradient, allowed=allowed)
        optional = {"steering_ratio": "steering_ratio", "width": "w_v", "lane_width": "w_l"}
        with warnings.catch_warnings(action="ignore", category=UnitWarning):  # the sheet's values were looked at
            vehicle = cls(
                m=mass,
                l_f=l_f,
                l_r=l_r,
                C_af=0.5 * mass * front / (gradient + compliance),
                C_ar=0.5 * mass * (1.0 - front) / compliance,
                I_z=given.get("yaw_inertia", mass * l_f * l_r),
                **{field: given[name] for name, field in optional.items() if name in given},
            )
        notes = tuple(f"assumed: {note}" for name, note in _NOTES.items() if name not in given)
        object.__setattr__(vehicle, "notes", notes)
        return vehicle

    @property
    def edge_offset(self) -> float:
        """Offset of the vehicle's centre when its edge is on the line, (w_l - w_v)/2 [m]."""
        return round((self.w_l - self.w_v) / 2.0, 12)


Convention = Literal["consistent", "as_printed"]


class _SingleTrack(Protocol):
    """What the error dynamics take from a vehicle: numbers, or arrays of n where vehicles differ."""

    @property
    def C_af(self) -> float | FloatArray: ...
    @property
    def C_ar(self) -> float | FloatArray: ...
    @property
    def l_f(self) -> float | FloatArray: ...
    @property
    def l_r(self) -> float | FloatArray: ...
    @property
    def m(self) -> float | FloatArray: ...
    @property
    def I_z(self) -> float | FloatArray: ...


@dataclasses.dataclass(frozen=True)
class SteadyState:
    """Steady cornering per unit of lane yaw rate, at each of n speeds."""

    delta: FloatArray  # (n,) [rad per rad/s] Steering angle that holds the bend with e_y = 0
    e_psi: FloatArray  # (n,) [rad per rad/s] Heading error there: minus the vehicle's side slip


@dataclasses.dataclass(frozen=True)
class BicycleModel(CheckedArguments):
    """Error dynamics of one vehicle, for any speeds at once.

    Raises `InputError` for an unknown convention.

    Parameters
    ----------
    parameters : VehicleParameters
        Vehicle and lane.
    convention : {"consistent", "as_printed"}
        ``"as_printed"`` takes the paper's A[1, 3] with its sign slip; the default is Rajamani's.

    Examples
    --------
    >>> A, B, E = BicycleModel(VehicleParameters()).matrices([20.0, 30.0])
    >>> A.shape, B.shape, E.shape
    ((2, 4, 4), (2, 4), (2, 4))
    """

    parameters: VehicleParameters = dataclasses.field(default_factory=VehicleParameters)
    convention: Convention = "consistent"

    def __post_init__(self) -> None:
        if self.convention not in get_args(Convention):
            raise InputError("convention", value=self.convention, allowed=get_args(Convention))

    def matrices(self, v: npt.ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Continuous-time A, B, E of Rajamani's eq. 2.45.

        Raises `InputError` for a speed that is not a finite number > 0.

        Parameters
        ----------
        v : (n,) [m/s]
            Longitudinal speeds, > 0.

        Returns
        -------
        A : (n, 4, 4)
        B : (n, 4)
        E : (n, 4)
        """
        return error_dynamics_matrices(self.parameters, checked_speeds(v), self.convention)

    def discretize(self, v: npt.ArrayLike, dt: npt.ArrayLike) -> Discretization:
        """Exact discretisation at speeds v (n,) [m/s] > 0, over dt [s] >= 0, one for all or (n,): zero-order hold on
        delta, first-order hold on psi_l'.
        """
        return discretize(*self.matrices(v), dt)

    def steady_state(self, v: npt.ArrayLike) -> SteadyState:
        """Steering angle and heading error that hold a bend without lateral offset (Rajamani, section 3.2).

        Parameters
        ----------
        v : (n,) [m/s]
            Speeds, > 0.

        Returns
        -------
        SteadyState
            Per unit of lane yaw rate.
        """
        return steady_cornering(*self.matrices(v))


def error_dynamics_matrices(
    vehicle: _SingleTrack, v: FloatArray, convention: Convention
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Continuous-time A (n, 4, 4), B and E (n, 4) of Rajamani's eq. 2.45 at speeds v (n,) [m/s], one vehicle or n."""
    p = vehicle
    stiffness = 2.0 * p.C_af + 2.0 * p.C_ar
    moment = 2.0 * p.C_af * p.l_f - 2.0 * p.C_ar * p.l_r
    damping = 2.0 * p.C_af * p.l_f**2 + 2.0 * p.C_ar * p.l_r**2
    # the printed matrix adds the rear moment here, and only here (paper, eq. of A; see the consistent reading)
    coupling = moment if convention == "consistent" else 2.0 * p.C_af * p.l_f + 2.0 * p.C_ar * p.l_r

    A = np.zeros((v.size, 4, 4))
    A[:, 0, 1] = A[:, 2, 3] = 1.0
    A[:, 1, 1] = -stiffness / (p.m * v)
    A[:, 1, 2] = stiffness / p.m
    A[:, 1, 3] = -coupling / (p.m * v)
    A[:, 3, 1] = -moment / (p.I_z * v)
    A[:, 3, 2] = moment / p.I_z
    A[:, 3, 3] = -damping / (p.I_z * v)
    B = np.zeros((v.size, 4))
    B[:, 1] = 2.0 * p.C_af / p.m
    B[:, 3] = 2.0 * p.C_af * p.l_f / p.I_z
    E = np.zeros((v.size, 4))
    E[:, 1] = -moment / (p.m * v) - v
    E[:, 3] = -damping / (p.I_z * v)
    return A, B, E


def steady_cornering(A: FloatArray, B: FloatArray, E: FloatArray) -> SteadyState:
    """Steady cornering that belongs to continuous-time matrices A (n, 4, 4), B (n, 4), E (n, 4)."""
    # 0 = A[:, 2] e_psi + B delta + E on the two force balances; e_y and both rates are zero
    system = np.stack([np.stack([A[:, i, 2], B[:, i]], axis=-1) for i in (1, 3)], axis=-2)
    solution: FloatArray = np.asarray(np.linalg.solve(system, -E[:, (1, 3), None])[..., 0], dtype=np.float64)
    return SteadyState(delta=solution[:, 1], e_psi=solution[:, 0])


def checked_speeds(v: npt.ArrayLike) -> FloatArray:
    """Speeds (n,) [m/s] as an array."""
    speed = np.atleast_1d(np.asarray(unmasked(v), dtype=float))
    bad = ~(np.isfinite(speed) & (speed > 0))
    if bad.any():
        i = int(np.argmax(bad))
        raise InputError(f"v[{i}]", "m/s", value=float(speed[i]), allowed="a finite number > 0")
    return speed
