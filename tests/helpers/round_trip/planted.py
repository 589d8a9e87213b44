"""Departures as signals whose samples reduce to the eight parameters exactly, residuals included.

With s = t/T, p the parabola over the distance and the samples at the times t_j of a clock of 10 Hz inside (0, T):

    y(t) = d_y p exp(k g(s)) / n,  n = sum(p^2 exp(k g)) / sum(p^2)

g is a smooth random mode that is 0 at both crossings. The normal n keeps d_y, the least-squares amplitude of the
parabola, whatever k is; the exponential keeps y > 0 and lets y cross the line where the parabola does. k is what makes
the sample deviation of y - d_y p equal sigma_y. It grows with k up to the limit where all of y stands in one sample;
beyond `LARGEST_EXPONENT` y is next to 0 over much of the event, so k stops there and sigma_y falls short.

    v(t) = v_mean + a_mean (t - T/2) + q h(s)

h is a smooth random mode less its own straight line over the samples, hence a_mean and the level stay, and q makes the
deviation sigma_v."""

import dataclasses

import numpy as np
import numpy.typing as npt

from ldctoolkit.departures import DepartureParameters

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

STEP = 0.1  # of the clock [s]

LARGEST_EXPONENT = 3.0
"""y is at least exp(-6) of what it would be with the largest mode value: no event falls apart of itself."""

_BISECTIONS = 50


@dataclasses.dataclass(frozen=True)
class Planted:
    """n departures as signals; rows are events, columns samples, `inside` tells which are there.

    Attributes
    ----------
    parameters : DepartureParameters
        What was asked for.
    first : (n,) [s]
        Time from the crossing outwards to the first sample, 0 to one step.
    inside : (n, L) bool
        Samples between the crossings.
    y, v, c : (n, L) [m], [m/s], [1/m]
        Outward; at ``first + j STEP``.
    slope : (n, 2) [m/s]
        Lateral speed at both crossings: positive, then negative.
    v_ends : (n, 2) [m/s]
        Speed at both crossings.
    reached : (n,) bool
        Whether the residual of y has the deviation sigma_y.
    """

    parameters: DepartureParameters
    first: FloatArray
    inside: BoolArray
    y: FloatArray
    v: FloatArray
    c: FloatArray
    slope: FloatArray
    v_ends: FloatArray
    reached: BoolArray


def plant(p: DepartureParameters, first: FloatArray, rng: np.random.Generator) -> Planted:
    """Signals of departures.

    Parameters
    ----------
    p : DepartureParameters
        n departures of at least four steps each.
    first : (n,) [s]
        Time from each crossing outwards to the clock's next sample, above 0 and up to one step.
    rng : numpy Generator
        Draws the modes of the residuals.
    """
    T = p.T[:, None]
    count = int(np.ceil(p.T.max() / STEP)) + 1
    t = first[:, None] + STEP * np.arange(count)
    inside = t < T
    t = np.where(inside, t, 0.5 * T)  # any time that does no harm
    s = t / T
    v, v_ends = _speeds(p, t, s, inside, rng)
    share = _share(t, v, v_ends, inside, p.T)
    parabola = np.where(inside, 4.0 * share * (1.0 - share), 0.0)
    angle = rng.uniform(0.0, 2.0 * np.pi, p.n)[:, None]
    mode = np.cos(angle) * np.sin(2.0 * np.pi * s) + np.sin(angle) * np.sin(3.0 * np.pi * s)
    exponent, reached = _exponents(p, parabola, mode, inside)
    y, normal = _tilted(p, parabola, mode, exponent)
    # the mode is 0 at the crossings: there y rises as the parabola does, divided by the normal
    rate = 4.0 * p.d_y / (p.v_mean * p.T) / normal
    slope = np.column_stack([rate * v_ends[:, 0], -rate * v_ends[:, 1]])
    c = np.where(inside, p.c_0[:, None] + p.dc[:, None] * s, 0.0)
    return Planted(p, first, inside, y, v, c, slope, v_ends, reached)


def _speeds(
    p: DepartureParameters, t: FloatArray, s: FloatArray, inside: BoolArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    angle = rng.uniform(0.0, 2.0 * np.pi, p.n)[:, None]

    def mode(share: FloatArray) -> FloatArray:
        waves = np.cos(angle) * np.sin(2.0 * np.pi * share) + np.sin(angle) * np.cos(2.0 * np.pi * share)
        return np.asarray(waves + 0.5 * np.sin(angle + 1.0) * np.cos(3.0 * np.pi * share))

    number = inside.sum(axis=1)[:, None]
    tau = np.where(inside, t - 0.5 * p.T[:, None], 0.0)
    raw = np.where(inside, mode(s), 0.0)
    mean_tau, mean_raw = tau.sum(1, keepdims=True) / number, raw.sum(1, keepdims=True) / number
    centred = np.where(inside, tau - mean_tau, 0.0)
    trend = (centred * raw).sum(1, keepdims=True) / (centred**2).sum(1, keepdims=True)
    rest = np.where(inside, raw - mean_raw - trend * (tau - mean_tau), 0.0)
    size = np.sqrt((rest**2).sum(1, keepdims=True) / (number - 1))
    q = p.sigma_v[:, None] / size
    v = np.where(inside, p.v_mean[:, None] + p.a_mean[:, None] * tau + q * rest, 0.0)
    ends = np.broadcast_to([-0.5, 0.5], (p.n, 2)) * p.T[:, None]
    rest_ends = mode(np.broadcast_to([0.0, 1.0], (p.n, 2))) - mean_raw - trend * (ends - mean_tau)
    return v, p.v_mean[:, None] + p.a_mean[:, None] * ends + q * rest_ends


def _share(t: FloatArray, v: FloatArray, v_ends: FloatArray, inside: BoolArray, T: FloatArray) -> FloatArray:
    """Share of the distance at each sample, by the trapezoid rule with both crossings."""
    number = inside.sum(axis=1)
    row = np.arange(T.size)
    step = np.zeros(t.shape)
    step[:, 0] = 0.5 * (v_ends[:, 0] + v[:, 0]) * t[:, 0]
    step[:, 1:] = np.where(inside[:, 1:], 0.5 * (v[:, 1:] + v[:, :-1]) * STEP, 0.0)
    x = np.cumsum(step, axis=1)
    end = number - 1
    total = x[row, end] + 0.5 * (v[row, end] + v_ends[:, 1]) * (T - t[row, end])
    return np.asarray(x / total[:, None])


def _tilted(
    p: DepartureParameters, parabola: FloatArray, mode: FloatArray, exponent: FloatArray
) -> tuple[FloatArray, FloatArray]:
    tilt = np.exp(exponent[:, None] * mode)
    normal = (parabola**2 * tilt).sum(axis=1) / (parabola**2).sum(axis=1)
    return p.d_y[:, None] * parabola * tilt / normal[:, None], normal


def _exponents(
    p: DepartureParameters, parabola: FloatArray, mode: FloatArray, inside: BoolArray
) -> tuple[FloatArray, BoolArray]:
    """The exponent that gives each event its sigma_y, by bisection; and whether there is one."""

    def deviation(exponent: FloatArray) -> FloatArray:
        y, _ = _tilted(p, parabola, mode, exponent)
        rest = np.where(inside, y - p.d_y[:, None] * parabola, 0.0)
        number = inside.sum(axis=1)
        mean = rest.sum(axis=1) / number
        return np.asarray(np.sqrt((np.where(inside, rest - mean[:, None], 0.0) ** 2).sum(axis=1) / (number - 1)))

    low, high = np.zeros(p.n), np.full(p.n, LARGEST_EXPONENT)
    reached = deviation(high) >= p.sigma_y
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        below = deviation(middle) < p.sigma_y
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return high, reached
