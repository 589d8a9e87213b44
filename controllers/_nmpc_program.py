"""What the nonlinear MPC evaluates, as three CasADi functions for a horizon N, with all numbers as inputs.

Unknowns are the commands U = (u_0 .. u_(N-1)) and, by multiple shooting, the states X = (x_1 .. x_N); the gaps
d_j = F(x_j, u_j) - x_(j+1) are zero at the solution. Written
with maps over the samples, so that the C code does not grow with N.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from controllers._nmpc_model import SIZE, sample, unpack


class Program(NamedTuple):
    """Functions of one horizon; X is (4, N), U (1, N), r (1, N+1) [rad/s], e_ref (1, N+1), u_ref (1, N) [rad]."""

    ahead: Any  # (x, u, r_0, r_1, c) -> (x after a sample, a_0, a_1) One sample with a command that is known
    # (x_0, guess, share, delta_prev, r, e_ref, u_ref, low, high, c) -> (U, X) Drive the model with commands guess, or,
    # with share = 1, the LQR, moved into the limits
    roll: Any
    # (X, U, x_0, r, e_ref, u_ref, c) -> (J, gap, a_0, a_1) Half the cost, sum of the absolute gaps, lateral
    # acceleration just after each command and at each sample's end
    value: Any
    # (X, U, x_0, r, e_ref, u_ref, c[, m_0, m_1, m_y]) -> (H, g, T, t, J_t, slope[, Y_0, Y_1, y_0, y_1]) The condensed
    # QP: Delta X = T' Delta U + t, Hessian H of the Lagrangian, gradient g, change J_t of the cost by t alone, largest
    # multiplier; T is (N, 4 N). With soft limits also the rows of a_0 and a_1 and their change by t, from multipliers m
    # of a_0, a_1 and e_y
    linearise: Any


def build(N: int, soft: bool) -> Program:
    """The functions for horizon N, not compiled."""
    import casadi as ca

    x, u, r_0, r_1, c = ca.SX.sym("x", 4), ca.SX.sym("u"), ca.SX.sym("r_0"), ca.SX.sym("r_1"), ca.SX.sym("c", SIZE)
    f, a_0, a_1 = sample(x, u, r_0, r_1, c)
    ahead = ca.Function("ahead", [x, u, r_0, r_1, c], [f, a_0, a_1])
    return Program(ahead, _roll(ca, N, x, u, r_0, r_1, c, f), *_plan(ca, N, x, u, r_0, r_1, c, f, a_0, a_1, soft))


def _roll(ca: Any, N: int, x: Any, u: Any, r_0: Any, r_1: Any, c: Any, f: Any) -> Any:
    step = ca.Function("sample_f", [x, u, r_0, r_1, c], [f])
    p = unpack(c)
    guess, share, e_ref, u_ref, low, high, previous = (
        ca.SX.sym(name) for name in ("guess", "share", "e_ref", "u_ref", "low", "high", "previous")
    )
    lqr = u_ref - ca.dot(p["K"], x - ca.vertcat(0, 0, e_ref, 0))
    wanted = ca.fmin(ca.fmax((1 - share) * guess + share * lqr, low), high)
    command = ca.fmin(ca.fmax(wanted, previous - p["rate_step"]), previous + p["rate_step"])
    state = ca.vertcat(x, previous)
    after = ca.vertcat(step(x, command, r_0, r_1, c), command)
    one = ca.Function("roll_one", [state, guess, share, r_0, r_1, e_ref, u_ref, low, high, c], [after])
    drive = one.mapaccum("roll_all", N)

    x_0, guess, delta_prev = ca.MX.sym("x_0", 4), ca.MX.sym("guess", 1, N), ca.MX.sym("delta_prev")
    share, r, e_ref, u_ref = (
        ca.MX.sym("share"),
        ca.MX.sym("r", 1, N + 1),
        ca.MX.sym("e_ref", 1, N + 1),
        ca.MX.sym("u", 1, N),
    )
    low, high, c = ca.MX.sym("low", 1, N), ca.MX.sym("high", 1, N), ca.MX.sym("c", SIZE)
    same = ca.MX.ones(1, N)
    path = drive(
        ca.vertcat(x_0, delta_prev), guess, share * same, r[:-1], r[1:], e_ref[:-1], u_ref, low, high,
        ca.repmat(c, 1, N),
    )  # fmt: skip
    return ca.Function(
        "roll", [x_0, guess, share, delta_prev, r, e_ref, u_ref, low, high, c], [path[4, :], path[:4, :]]
    )


def _plan(
    ca: Any, N: int, x: Any, u: Any, r_0: Any, r_1: Any, c: Any, f: Any, a_0: Any, a_1: Any, soft: bool
) -> tuple[Any, Any]:
    p = unpack(c)
    xu = ca.vertcat(x, u)
    e_ref, u_ref = ca.SX.sym("e_ref"), ca.SX.sym("u_ref")
    last = ca.SX.sym("last")  # 1 at the end of the horizon

    # the cost of x_(j+1) and u_j
    weight = (1 - last) * ca.diag(p["q"]) + last * ca.reshape(p["P"], 4, 4)
    after = ca.SX.sym("after", 4)
    off = after - ca.vertcat(0, 0, e_ref, 0)
    pull = ca.mtimes(weight, off)
    cost = 0.5 * ca.dot(off, pull) + 0.5 * p["r_delta"] * (u - u_ref) ** 2

    given = [x, u, after, r_0, r_1, e_ref, u_ref, last, c]
    names = ["x", "u", "after", "r_0", "r_1", "e_ref", "u_ref", "last", "c"]
    gap = f - after
    value_one = ca.Function("value_one", given, [cost, ca.norm_1(gap), a_0, a_1], names, ["J", "gap", "a_0", "a_1"])
    slopes_one = ca.Function(
        "slopes_one", given,
        [gap, ca.jacobian(f, x), ca.jacobian(f, u), pull, p["r_delta"] * (u - u_ref),
         ca.jacobian(a_0, x).T, ca.jacobian(a_0, u), ca.jacobian(a_1, x).T, ca.jacobian(a_1, u)],
    )  # fmt: skip
    shared = [8]
    values = value_one.map("value_all", "serial", N, shared, [0, 1])
    slopes = slopes_one.map("slopes_all", "serial", N, shared, [])

    # multipliers, backwards
    after_multiplier, A, pulled = ca.SX.sym("l", 4), ca.SX.sym("A", 4, 4), ca.SX.sym("pull", 4)
    back_one = ca.Function("back_one", [after_multiplier, A, pulled], [ca.mtimes(A.T, after_multiplier) + pulled])
    back = back_one.mapaccum("back_all", N)
    multiplier, m_0, m_1 = ca.SX.sym("l", 4), ca.SX.sym("m_0"), ca.SX.sym("m_1")
    lagrangian = ca.dot(multiplier, f) + m_0 * a_0 + m_1 * a_1
    curvature, _ = ca.hessian(lagrangian, xu)
    bend_one = ca.Function("bend_one", [x, u, r_0, r_1, c, multiplier, m_0, m_1], [ca.densify(curvature)])
    bends = bend_one.map("bend_all", "serial", N, [4], [])

    # condensing: rows of T are the states' sensitivities to one command
    T, t, B, d, e = ca.SX.sym("T", N, 4), ca.SX.sym("t", 4), ca.SX.sym("B", 4), ca.SX.sym("d", 4), ca.SX.sym("e", N)
    forward_one = ca.Function(
        "forward_one", [T, t, A, B, d, e],
        [ca.mtimes(T, A.T) + ca.mtimes(e, B.T), ca.mtimes(A, t) + d],
    )  # fmt: skip
    forward = forward_one.mapaccum("forward_all", N, 2)
    W, h = ca.SX.sym("W", 4, 4), ca.SX.sym("h", 4)
    weigh_one = ca.Function("weigh_one", [T, W, t, h], [ca.mtimes(T, W), ca.mtimes(W, t), ca.mtimes(T, h)])
    weigh = weigh_one.map("weigh_all", "serial", N, [], [])
    row_one = ca.Function("row_one", [T, h], [ca.mtimes(T, h)])
    rows = row_one.map("row_all", "serial", N, [], [])

    X, U, x_0 = ca.MX.sym("X", 4, N), ca.MX.sym("U", 1, N), ca.MX.sym("x_0", 4)
    r, e_ref, u_ref = ca.MX.sym("r", 1, N + 1), ca.MX.sym("e_ref", 1, N + 1), ca.MX.sym("u_ref", 1, N)
    c = ca.MX.sym("c", SIZE)
    pressed = [ca.MX.sym(name, 1, N) for name in ("m_0", "m_1", "m_y")]
    m_0, m_1, m_y = pressed if soft else [ca.MX.zeros(1, N)] * 3
    last = ca.MX(ca.horzcat(ca.DM.zeros(1, N - 1), 1))
    before = ca.horzcat(x_0, X[:, :-1])
    at = [before, U, X, r[:-1], r[1:], e_ref[1:], u_ref, last, c]
    names = ["X", "U", "x_0", "r", "e_ref", "u_ref", "c"]
    value = ca.Function("value", [X, U, x_0, r, e_ref, u_ref, c], list(values(*at)), names, ["J", "gap", "a_0", "a_1"])

    d, A, B, pull, push, a_0_x, a_0_u, a_1_x, a_1_u = slopes(*at)
    # gradient of the soft limits' terms on x_1 .. x_N: accelerations of the sample that starts there, and e_y
    here = a_0_x * ca.repmat(m_0, 4, 1) + a_1_x * ca.repmat(m_1, 4, 1)
    push_soft = ca.horzcat(here[:, 1:], ca.MX.zeros(4, 1)) + ca.vertcat(m_y, ca.MX.zeros(3, N))
    pulled = pull + push_soft
    flip = list(range(N - 1, -1, -1))
    A_next = ca.horzcat(A[:, 4:], ca.MX.zeros(4, 4))  # of the sample after
    reverse = [4 * k + i for k in flip for i in range(4)]
    multipliers = back(ca.MX.zeros(4), A_next[:, reverse], pulled[:, flip])[:, flip]
    L = bends(before, U, r[:-1], r[1:], c, multipliers, m_0, m_1)

    eye = ca.MX(ca.DM.eye(N))
    T, t = forward(ca.MX.zeros(N, 4), ca.MX.zeros(4), A, B, d, eye)
    q, P = ca.diag(unpack(c)["q"]), ca.reshape(unpack(c)["P"], 4, 4)
    columns = [k for j in range(1, N) for k in range(5 * j, 5 * j + 4)]
    W = L[:4, columns] + ca.repmat(q, 1, N - 1) if N > 1 else ca.MX.zeros(4, 0)
    W = ca.horzcat(W, P)
    cross = ca.horzcat(L[:4, [5 * j + 4 for j in range(1, N)]], ca.MX.zeros(4, 1))  # of x_j with u_j, j = 1 .. N
    TW, Wt, mixed = weigh(T, W, t, cross)  # mixed: column j-1 is Phi_j' cross_j, for u_j
    mixed = ca.horzcat(ca.MX.zeros(N, 1), mixed[:, : N - 1])
    H = ca.mtimes(TW, T.T) + mixed + mixed.T
    H += ca.diag(unpack(c)["r_delta"] + L[4, [5 * j + 4 for j in range(N)]].T)
    g = ca.mtimes(T, ca.reshape(pull + Wt, 4 * N, 1)) + push.T
    g += ca.vertcat(0, ca.sum1(cross * t)[: N - 1].T) if N > 1 else 0
    J_t = ca.dot(pull, t) + 0.5 * ca.dot(t, Wt)
    t_before = ca.horzcat(ca.MX.zeros(4, 1), t[:, :-1])
    T_before = ca.horzcat(ca.MX.zeros(N, 4), T[:, :-4])
    Y_0, Y_1 = rows(T_before, a_0_x) + ca.diag(a_0_u), rows(T_before, a_1_x) + ca.diag(a_1_u)
    y_0, y_1 = ca.sum1(a_0_x * t_before), ca.sum1(a_1_x * t_before)
    outputs = [H, g, T, t, J_t, ca.norm_inf(ca.vec(multipliers)), *([Y_0, Y_1, y_0, y_1] if soft else [])]
    linearise = ca.Function(
        "linearise", [X, U, x_0, r, e_ref, u_ref, c, *(pressed if soft else [])], [ca.densify(v) for v in outputs],
        [*names, *(["m_0", "m_1", "m_y"] if soft else [])],
        ["H", "g", "T", "t", "J_t", "slope", *(["Y_0", "Y_1", "y_0", "y_1"] if soft else [])],
    )  # fmt: skip
    return value, linearise
