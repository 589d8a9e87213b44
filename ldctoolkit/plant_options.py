"""What makes a plant more than the ideal linear one: frozen values, all off by default, all combinable.

The ideal plant is a linear bicycle at the speed of the trigger, whose steering angle is the command at once and whose
state the law sees as it is. Every option here takes one of these idealisations away.
"""

import dataclasses
import functools
import math
from collections.abc import Mapping
from fractions import Fraction
from typing import Any, Final, Literal, get_args

from ldctoolkit.declared import check_declared, checked_number, declarations, declared, short_repr, warn_of_units
from ldctoolkit.errors import CheckedArguments, InputError

Speed = Literal["frozen", "profile"]
TyreModel = Literal["linear", "magic_formula"]
DriverModel = Literal["grip", "arms"]
INTENTS: Final = ("recorded", "straight", "follows", "against", "returns")  # what a driver means to do

_SHORTEST_LAG: Final = 1e-4  # shortest lag [s] that is a lag and not a slip of the pen
_SHORTEST_PERIOD: Final = 1e-3  # shortest period [s] of a camera: each frame that is on its way at the trigger is kept


def whole_multiple(time: float, dt: float) -> float:
    """A time [s] >= 0 that is a multiple of dt, or of a simple part of it, but for rounding: that multiple."""
    near = float(Fraction(time / dt).limit_denominator(100)) * dt
    return near if 1e-12 * time < abs(near - time) <= 1e-7 * dt + 2e-9 * time else time


class _Options(CheckedArguments):
    """A table of declared options, all off by default."""

    __repr__ = short_repr

    @property
    def ideal(self) -> bool:
        """Nothing differs from the ideal plant."""
        kind: type = type(self)
        return bool(self == _ideal(kind))


@functools.cache
def _ideal(options: type) -> Any:
    """Options of a class that are all off."""
    return options()


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class Actuator(_Options):
    """Steering actuator: pure delay, then the angle limit, then a first-order lag whose rate is limited.

    With the delayed, limited command u, the steering angle follows d delta/dt = (u - delta)/lag, cut off at +-rate_max;
    without a lag it moves towards u at rate_max, or is u at once. Raises `InputError` for a value outside what is
    allowed.

    Examples
    --------
    >>> Actuator(rate_max=0.5, lag=0.1, delay=0.03).ideal
    False
    """

    # Limit of the angle; None for no limit
    delta_max: float | None = declared(None, unit="rad", above=0.0)
    # Limit of the rate; None for no limit
    rate_max: float | None = declared(None, unit="rad/s", above=0.0)
    lag: float = declared(0.0, unit="s", lower=0.0, upper=10.0)  # Time constant; 0 for none, otherwise at least 1e-4
    delay: float = declared(0.0, unit="s", lower=0.0, upper=10.0)  # Pure delay, any part of a sample included

    def __post_init__(self) -> None:
        check_declared(self, "actuator")
        if 0.0 < self.lag < _SHORTEST_LAG:
            raise InputError("actuator.lag", value=self.lag, allowed=f"0, or at least {_SHORTEST_LAG:g} s")
        warn_of_units("actuator", self)


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class Mismatch(_Options):
    """Ranges of factors on the true vehicle, one uniform draw per scenario; the law is designed on the nominal one.

    Raises `InputError` for a range that is not 0 < low <= high.

    Examples
    --------
    >>> Mismatch(m=(0.9, 1.3)).ideal
    False
    """

    # Lowest and highest factor on mass, yaw inertia, and the stiffnesses
    m: tuple[float, float] = declared((1.0, 1.0), above=0.0, pair="ascending")
    I_z: tuple[float, float] = declared((1.0, 1.0), above=0.0, pair="ascending")
    C_af: tuple[float, float] = declared((1.0, 1.0), above=0.0, pair="ascending")
    C_ar: tuple[float, float] = declared((1.0, 1.0), above=0.0, pair="ascending")
    # On the friction coefficient; only saturating tyres have one
    mu: tuple[float, float] = declared((1.0, 1.0), above=0.0, pair="ascending")

    def __post_init__(self) -> None:
        check_declared(self, "mismatch")


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class Tyres(_Options):
    """Lateral tyre force.

    Raises `InputError` for a value outside what is allowed.

    Examples
    --------
    >>> Tyres(model="magic_formula", mu=0.3).ideal
    False
    """

    # Linear, or Pacejka's Magic Formula without curvature factor: F = mu F_z sin(C atan(C_alpha alpha/(C mu F_z))),
    # with static wheel loads
    model: TyreModel = declared("linear", choices=get_args(TyreModel))
    mu: float = declared(0.9, above=0.0, upper=2.0)  # Friction coefficient
    shape: float = declared(1.3, lower=1.0, upper=2.0)  # Shape factor C, 1 to 2

    def __post_init__(self) -> None:
        check_declared(self, "tyres")
        for name in ("mu", "shape"):
            if self.ideal and getattr(self, name) != declarations(Tyres)[name].default:
                hint = "linear tyres have none; allowed with tyres.model = 'magic_formula'"
                raise InputError(f"tyres.{name}", value=getattr(self, name), hint=hint)

    @property
    def ideal(self) -> bool:
        """The force is linear in the slip angle."""
        return self.model == "linear"


@dataclasses.dataclass(frozen=True, kw_only=True)
class KalmanFilter(CheckedArguments):
    """Stationary Kalman filter on the nominal vehicle; it gives the law all four states from the camera's two.

    Raises `InputError` for a value that is not > 0.

    Examples
    --------
    >>> KalmanFilter(r_y=0.05).q_y
    0.5
    """

    __repr__ = short_repr

    # [m/s^2/sqrt(Hz)] Density of the lateral acceleration that the model does not know
    q_y: float = declared(0.5, unit="m/s^2/sqrt(Hz)", above=0.0)
    # [rad/s^2/sqrt(Hz)] Density of the yaw acceleration that the model does not know
    q_psi: float = declared(0.2, unit="rad/s^2/sqrt(Hz)", above=0.0)
    # [m] Standard deviation of the measured e_y that the filter is designed for
    r_y: float = declared(0.03, unit="m", above=0.0)
    # [rad] Standard deviation of the measured e_psi that the filter is designed for
    r_psi: float = declared(0.003, unit="rad", above=0.0)

    def __post_init__(self) -> None:
        check_declared(self, "sensors.kalman")


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class Sensors(_Options):
    """Lane camera: frames of e_y and e_psi, and the curvature ahead. Biases are in the road's frame, positive left.

    A frame is value + bias + noise, rounded to the step of quantisation. It is taken every `period`, one of them at the
    trigger, and arrives `delay` later; at each sample the law sees the latest that has arrived. Without a Kalman filter
    the law sees the true rates. Raises `InputError` for a value outside what is allowed, or both `period` and `fps`.

    Examples
    --------
    >>> Sensors(e_y_noise=0.05, fps=10, kalman=KalmanFilter()).period
    0.1
    """

    # Standard deviation, independent from frame to frame
    e_y_noise: float = declared(0.0, unit="m", lower=0.0)
    e_psi_noise: float = declared(0.0, unit="rad", lower=0.0)
    e_y_bias: float = declared(0.0, unit="m")
    e_psi_bias: float = declared(0.0, unit="rad")
    e_y_step: float = declared(0.0, unit="m", lower=0.0)  # Step of quantisation; 0 for none
    e_psi_step: float = declared(0.0, unit="rad", lower=0.0)  # Step of quantisation; 0 for none
    # [s] Time between frames, 0.001 to 10; 0 for a frame at every sample. ``fps=30`` stands for ``period=1/30``.
    period: float = declared(0.0, unit="s", lower=0.0, upper=10.0)
    delay: float = declared(0.0, unit="s", lower=0.0, upper=10.0)  # [s] Age of a frame when it arrives
    curvature_gain: float = declared(0.0)  # Relative error of the curvature that the law previews
    curvature_bias: float = declared(0.0, unit="1/m")  # [1/m] Its constant error
    # [1/m] Standard deviation of a further constant error, one draw per scenario
    curvature_noise: float = declared(0.0, unit="1/m", lower=0.0)
    kalman: KalmanFilter | None = declared(None, kind=KalmanFilter)
    fps: dataclasses.InitVar[float | None] = None

    def __post_init__(self, fps: float | None) -> None:
        check_declared(self, "sensors")
        if fps is not None:
            if self.period:
                problem = f"beside period = {self.period:g} s"
                raise InputError("sensors.fps", problem, value=fps, allowed="one of the two")
            rate = checked_number("sensors.fps", fps, lower=0.1, upper=1000.0, unit="Hz")
            object.__setattr__(self, "period", 1.0 / rate)
        if 0.0 < self.period < _SHORTEST_PERIOD:
            raise InputError("sensors.period", value=self.period, allowed=f"0, or at least {_SHORTEST_PERIOD:g} s")
        warn_of_units("sensors", self)

    def age(self, dt: float, *, held: bool = False) -> float:
        """Mean age [s] of a frame at the sample, one every dt [s], that first sees it; or, `held`, at any sample."""
        delay, period = whole_multiple(self.delay, dt), whole_multiple(self.period, dt) or dt
        short, long = sorted((period, dt))
        grid = short / Fraction(long / short).limit_denominator(100).denominator  # ages are this far apart
        return math.ceil(delay / grid - 1e-9) * grid + 0.5 * ((period if held else short) - grid)


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class Residuals(_Options):
    """What the eight parameters leave out of the recorded path, drawn anew from sigma_y and sigma_v.

    Raises `InputError` for a value outside what is allowed.

    Examples
    --------
    >>> Residuals(y=True).ideal
    False
    """

    y: bool = declared(False)  # Add eps_y to the lateral path
    v: bool = declared(False)  # Add eps_v to the speed
    bandwidth: float = declared(1.0, unit="Hz", above=0.0, upper=5.0)  # [Hz] Highest frequency

    def __post_init__(self) -> None:
        check_declared(self, "residuals")
        if self.ideal and self.bandwidth != declarations(Residuals)["bandwidth"].default:
            hint = "allowed with residuals.y or residuals.v"
            raise InputError("residuals.bandwidth", value=self.bandwidth, hint=hint)

    @property
    def ideal(self) -> bool:
        """The recorded path is the fitted parabola, its speed the fitted line."""
        return not (self.y or self.v)


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class Driver(_Options):
    """A driver who holds the wheel, the steering column, and an assist that the driver can override.

    Each of the five intents has a share of the departures; together 1. Without shares nobody holds the wheel. Ranges
    are drawn for each departure, uniformly. Torques and angles are those at the steering wheel, `steering_ratio` of the
    vehicle times the wheels' angle. Equations and sources: docs/explanation/driver.md. Raises `InputError` for shares
    that do not sum to 1, and for a value outside what is allowed or of the other model.

    Examples
    --------
    >>> Driver(straight=0.4, recorded=0.4, against=0.2).model
    'grip'
    >>> Driver(model="arms", recorded=1.0, stiffness=(20.0, 20.0)).ideal
    False
    """

    # Springs and arms' damping alone, or arms, wheel and aligning torque with their dynamics
    model: DriverModel = declared("grip", choices=get_args(DriverModel))
    # Share of the drivers who steer on along the recorded path
    recorded: float = declared(0.0, lower=0.0, upper=1.0)
    straight: float = declared(0.0, lower=0.0, upper=1.0)  # Of those who hold the wheel as it was at the trigger
    follows: float = declared(0.0, lower=0.0, upper=1.0)  # Of those who give way after their reaction time
    against: float = declared(0.0, lower=0.0, upper=1.0)  # Of those who mean to leave the lane
    returns: float = declared(0.0, lower=0.0, upper=1.0)  # Of those who correct by themselves after it
    # Share of the arms in the stiffness that holds the wheel; only of model grip
    grip: tuple[float, float] = declared((0.2, 0.5), lower=0.0, upper=1.0, pair="ascending")
    arm_lag: float = declared(0.08, unit="s", lower=1e-3, upper=1.0)  # Damping over stiffness; only of model grip
    # Stiffness, damping and inertia of the arms; only of model arms
    stiffness: tuple[float, float] = declared((10.0, 40.0), unit="N m/rad", lower=0.0, upper=500.0, pair="ascending")
    damping: float = declared(1.6, unit="N m s/rad", lower=0.0, upper=50.0)
    inertia: float = declared(0.1, unit="kg m^2", lower=0.0, upper=1.0)
    reaction: tuple[float, float] = declared((0.3, 1.2), unit="s", lower=0.0, upper=5.0, pair="ascending")
    # Lateral acceleration outward that a driver who means to leave the lane steers for a second
    across: tuple[float, float] = declared((0.3, 0.8), unit="m/s^2", lower=0.0, upper=5.0, pair="ascending")
    # Of the oscillation back to the lane's centre that a driver who corrects means, and its damping ratio
    frequency: tuple[float, float] = declared((0.6, 1.2), unit="rad/s", above=0.0, upper=5.0, pair="ascending")
    return_damping: float = declared(0.4, lower=0.0, upper=2.0)
    # The assist's position loop and its limit
    assist_stiffness: float = declared(40.0, unit="N m/rad", lower=1.0, upper=1000.0)
    assist_damping: float = declared(2.5, unit="N m s/rad", lower=0.0, upper=100.0)  # Only of model arms
    torque_max: float = declared(5.0, unit="N m", above=0.0, upper=100.0)
    # The column; only of model arms: inertia and damping, trail of the front tyres, share that power steering takes
    wheel_inertia: float = declared(0.1, unit="kg m^2", lower=0.01, upper=1.0)
    wheel_damping: float = declared(0.3, unit="N m s/rad", lower=0.0, upper=10.0)
    trail: float = declared(0.06, unit="m", lower=0.0, upper=0.2)
    boost: float = declared(0.6, lower=0.0, upper=1.0)
    # The assist yields where the driver's torque is larger for so long, leaves within the ramp, and comes back after so
    # long below it; 0 for never
    override_torque: float = declared(3.0, unit="N m", above=0.0, upper=100.0)
    override_time: float = declared(0.2, unit="s", lower=0.0, upper=10.0)
    ramp: float = declared(0.5, unit="s", lower=0.0, upper=10.0)
    return_after: float = declared(0.0, unit="s", lower=0.0, upper=60.0)

    def __post_init__(self) -> None:
        check_declared(self, "driver")
        total, defaults = sum(self.shares), {name: d.default for name, d in declarations(Driver).items()}
        if total and abs(total - 1.0) > 1e-9:
            raise InputError("driver", f"shares that sum to {total:g}", allowed="a sum of 1", hint=", ".join(INTENTS))
        other = "arms" if self.model == "grip" else "grip"
        for name, model in _ONLY_OF.items():
            if model == other and getattr(self, name) != defaults[name]:
                hint = f"allowed with driver.model = {other!r}"
                raise InputError(f"driver.{name}", value=getattr(self, name), hint=hint)
        if not total and vars(self) != defaults:
            raise InputError("driver", "no share of any intent", allowed="a sum of 1", hint=", ".join(INTENTS))

    @property
    def holds(self) -> bool:
        """A driver moves the wheels: not where all have a grip of 0."""
        return not self.ideal and not (self.model == "grip" and self.grip[1] == 0.0)

    @property
    def shares(self) -> tuple[float, ...]:
        """Share of each of `INTENTS`."""
        return tuple(getattr(self, intent) for intent in INTENTS)


_ONLY_OF: Final[Mapping[str, DriverModel]] = {
    "grip": "grip", "arm_lag": "grip", "stiffness": "arms", "damping": "arms", "inertia": "arms",
    "assist_damping": "arms", "wheel_inertia": "arms", "wheel_damping": "arms", "trail": "arms", "boost": "arms",
}  # fmt: skip


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class PlantOptions(_Options):
    """All options of the plant, each of which may differ from the ideal plant.

    Raises `InputError` for a value outside what is allowed.

    Examples
    --------
    >>> PlantOptions().ideal
    True
    >>> PlantOptions(speed="profile", actuator=Actuator(lag=0.1)).ideal
    False
    """

    # The speed of the trigger, or v(t) of the scenario
    speed: Speed = declared("frozen", choices=get_args(Speed))
    actuator: Actuator = declared(Actuator)
    mismatch: Mismatch = declared(Mismatch)
    tyres: Tyres = declared(Tyres)
    sensors: Sensors = declared(Sensors)
    residuals: Residuals = declared(Residuals)
    driver: Driver = declared(Driver)

    def __post_init__(self) -> None:
        check_declared(self)
        if self.tyres.ideal and self.mismatch.mu != (1.0, 1.0):
            hint = "linear tyres have no friction coefficient; allowed with tyres.model = 'magic_formula'"
            raise InputError("mismatch.mu", value=self.mismatch.mu, hint=hint)

    def sampled(self, dt: float) -> "PlantOptions":
        """These options, with times rounded where they are multiples of the sample time dt [s] but for rounding."""
        actuator, sensors = self.actuator, self.sensors
        delay, late, period = (whole_multiple(t, dt) for t in (actuator.delay, sensors.delay, sensors.period))
        if (delay, late, period) == (actuator.delay, sensors.delay, sensors.period):
            return self
        actuator, sensors = dataclasses.replace(actuator, delay=delay), dataclasses.replace(sensors, delay=late)
        return dataclasses.replace(self, actuator=actuator, sensors=dataclasses.replace(sensors, period=period))

    @property
    def drives_exactly(self) -> bool:
        """Between samples the plant is linear with constant coefficients, and its steering angle constant."""
        return self.speed == "frozen" and self.actuator.ideal and self.tyres.ideal and not self.driver.holds
