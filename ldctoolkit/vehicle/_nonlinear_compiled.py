"""The nonlinear plant for compiled loops. Generated: do not edit.

Made by ``python tools/compile_nonlinear.py`` from `nonlinear_dynamics` of `tools/nonlinear_plant.py`, operation by
operation. The compiler takes a while to import: callers import this module where they call it.
"""

import math

import numba


@numba.njit(error_model="numpy")
def nonlinear_rhs(
    e_y_rate: float,
    e_psi: float,
    e_psi_rate: float,
    delta: float,
    r: float,
    v: float,
    dv: float,
    C_af: float,
    C_ar: float,
    l_f: float,
    l_r: float,
    m: float,
    I_z: float,
    mu: float,
    shape: float,
) -> tuple[float, float, float]:
    """Accelerations of the lane errors and lateral acceleration, of `nonlinear_dynamics`: same order, same units.

    Returns
    -------
    tuple of three floats
        e_y_acceleration [m/s^2], e_psi_acceleration [rad/s^2], a_y [m/s^2].
    """
    w0 = math.sin(e_psi)
    w1 = dv * w0
    w2 = math.cos(e_psi)
    w3 = v * w2
    w4 = w3 * e_psi_rate
    w5 = w1 + w4
    w6 = 2.0 * mu
    w7 = 9.81 * m
    w8 = l_f + l_r
    w9 = 2.0 * w8
    w10 = w7 / w9
    w11 = w10 * l_r
    w12 = w6 * w11
    w13 = v * w0
    w14 = e_y_rate - w13
    w15 = w14 / w2
    w16 = e_psi_rate + r
    w17 = l_f * w16
    w18 = w15 + w17
    w19 = w18 / v
    w20 = math.atan(w19)
    w21 = delta - w20
    w22 = C_af * w21
    w23 = shape * mu
    w24 = w23 * w11
    w25 = w22 / w24
    w26 = math.atan(w25)
    w27 = shape * w26
    w28 = math.sin(w27)
    w29 = w12 * w28
    w30 = math.cos(delta)
    w31 = w29 * w30
    w32 = 2.0 * mu
    w33 = w10 * l_f
    w34 = w32 * w33
    w35 = l_r * w16
    w36 = w15 - w35
    w37 = w36 / v
    w38 = math.atan(w37)
    w39 = C_ar * w38
    w40 = shape * mu
    w41 = w40 * w33
    w42 = w39 / w41
    w43 = -w42
    w44 = math.atan(w43)
    w45 = shape * w44
    w46 = math.sin(w45)
    w47 = w34 * w46
    w48 = w31 + w47
    w49 = w48 / m
    w50 = v * w16
    w51 = w49 - w50
    w52 = w51 * w2
    w53 = w5 + w52
    w54 = w15 * w0
    w55 = w54 * e_psi_rate
    w56 = w53 - w55
    w57 = l_f * w31
    w58 = l_r * w47
    w59 = w57 - w58
    w60 = w59 / I_z
    return w56, w60, w49
