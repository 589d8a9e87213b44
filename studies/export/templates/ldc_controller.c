/* {{ title }}: see ldc_controller.h for what this code is and where it comes from. */
#include "ldc_controller.h"

#include <math.h>
#include <string.h>

{% for name, function in [("ABS", "fabs"), ("ARCTAN", "atan"), ("COS", "cos"), ("LOG", "log"), ("ROOT", "sqrt"), ("SIN", "sin")] %}
#define {{ name }}(x) (sizeof(ldc_work) == sizeof(float) ? (ldc_work){{ function }}f((float)(x)) : (ldc_work){{ function }}(x))
{% endfor %}
#define LARGEST LDC_W(1.0e6) /* [rad] a command beyond it is none */

{% if columns %}
/* places of gains */
{% for name, at, unit in places %}
#define {{ name }} {{ at }} /* {{ unit }} */
{% endfor %}
#define TERMS {{ terms }}

/* Coefficients of Chebyshev polynomials over log v, from LDC_V_MIN to LDC_V_MAX, a row for each gain. */
static const ldc_work table[LDC_COLUMNS][TERMS] = {
{% for row in table %}
    { {{ row }} }{{ "," if not loop.last }}
{% endfor %}
};
{% if pieces %}
#define PIECES {{ pieces|length }}
#define PIECE_TERMS {{ piece_terms }}
#define KINKED {{ kinked|length }}

/* Gains with kinks or steps over speed: their rows are 0 above and stand here, in pieces from knot to knot, each in
   polynomials over v: with two terms the gains are linear in between. */
static const int32_t kinked[KINKED] = { {{ kinked|join(", ") }} };
static const double knots[PIECES + 1] = { {{ knots|join(", ") }} }; /* [m/s] */
static const ldc_work pieces[PIECES][KINKED][PIECE_TERMS] = {
{% for piece in pieces %}
    {
{% for row in piece %}
        { {{ row }} }{{ "," if not loop.last }}
{% endfor %}
    }{{ "," if not loop.last }}
{% endfor %}
};
{% endif %}

/* A series at z in [-1, 1], by the recurrence of Clenshaw. */
static ldc_work series(const ldc_work *coefficients, int32_t terms, ldc_work z)
{
    ldc_work inner = LDC_W(0.0);
    ldc_work outer = LDC_W(0.0);
    for (int32_t n = terms - 1; n > 0; n--) {
        const ldc_work next = coefficients[n] + ((LDC_W(2.0) * z * inner) - outer);
        outer = inner;
        inner = next;
    }
    return coefficients[0] + ((z * inner) - outer);
}

/* Gains at a speed. */
static void gains_at(ldc_work v, ldc_work gain[LDC_COLUMNS])
{
    const ldc_work z = ((LDC_W(2.0) * LOG(v / LDC_V_MIN)) / LDC_W({{ span }})) - LDC_W(1.0);
    for (int32_t k = 0; k < LDC_COLUMNS; k++) { gain[k] = series(table[k], TERMS, z); }
{% if pieces %}
    {
        ldc_work within_piece;
        int32_t p = 0;
        for (int32_t i = 1; i < PIECES; i++) { p += ((double)v >= knots[i]) ? 1 : 0; }
        within_piece = (ldc_work)(((2.0 * ((double)v - knots[p])) / (knots[p + 1] - knots[p])) - 1.0);
        for (int32_t k = 0; k < KINKED; k++) { gain[kinked[k]] = series(pieces[p][k], PIECE_TERMS, within_piece); }
    }
{% endif %}
}

{% endif %}
{% if clips %}
static ldc_work clip(ldc_work value, ldc_work low, ldc_work high)
{
    const ldc_work result = (value < low) ? low : value;
    return (result > high) ? high : result;
}

{% endif %}
{% if dots %}
static ldc_work dot(const ldc_work *a, const ldc_work *b, int32_t n)
{
    ldc_work sum = LDC_W(0.0);
    for (int32_t i = 0; i < n; i++) { sum += a[i] * b[i]; }
    return sum;
}

{% endif %}
/* Whether a magnitude is at most a limit; by bits, as a compiler may assume that there is nothing but numbers
   (-ffast-math): in the order of IEEE 754 infinity and NaN are beyond every limit. */
static int32_t within(ldc_work value, ldc_work limit)
{
    const double number[2] = {(double)value, (double)limit};
    uint64_t bits[2];
    (void)memcpy(bits, number, sizeof(bits));
    return ((bits[0] & (UINT64_MAX >> 1)) <= bits[1]) ? 1 : 0;
}

{% if mpc or sqp %}
#define ROUNDING 1.0e-12

/* Solve (A A') part = part in place, A the n held normals, which are independent, by Cholesky's factors. */
static void gram(ldc_state *s, int32_t n, ldc_work part[LDC_VARIABLES])
{
    for (int32_t i = 0; i < n; i++) {
        for (int32_t j = 0; j <= i; j++) {
            const ldc_work both = dot(s->held[i], s->held[j], LDC_VARIABLES);
            const ldc_work inner = both - dot(s->factor[i], s->factor[j], j);
            const ldc_work least = ROUNDING * both;
            s->factor[i][j] = (j < i) ? (inner / s->factor[j][j]) : ROOT((inner > least) ? inner : least);
        }
        part[i] = (part[i] - dot(s->factor[i], part, i)) / s->factor[i][i];
    }
    for (int32_t i = n - 1; i >= 0; i--) {
        for (int32_t j = i + 1; j < n; j++) { part[i] -= s->factor[j][i] * part[j]; }
        part[i] /= s->factor[i][i];
    }
}

{% endif %}
{% if law == "mpc" %}
{% include "ldc_mpc.c" %}
{% elif sqp %}
{% include "ldc_predictive.c" %}
{% elif law == "pure_pursuit" %}
/* Weights of heading and yaw rate of the lane ahead in the lateral position of the goal point: cubics every 0.1 s. */
static void begin_pursuit(ldc_state *s)
{
    const ldc_work step = LDC_W({{ c.step }});
    const ldc_work far = LDC_W({{ c.T_lp }}) * s->v;
    s->reach = ((far < LDC_W({{ c.l_min }})) ? LDC_W({{ c.l_min }}) : far) - LDC_W({{ c.l_r }});
    for (int32_t j = 0; j < {{ points }}; j++) {
        s->of_heading[j] = LDC_W(0.0);
        s->of_yaw_rate[j] = LDC_W(0.0);
    }
    for (int32_t j = 0; j < ({{ points }} - 1); j++) {
        const ldc_work u = clip((s->reach / s->v / step) - (ldc_work)j, LDC_W(0.0), LDC_W(1.0));
        const ldc_work a = s->v * step * u;
        const ldc_work b = a * step * u;
        s->of_heading[j] += a * (LDC_W(1.0) + (u * u * ((LDC_W(0.5) * u) - LDC_W(1.0))));
        s->of_heading[j + 1] += a * u * u * (LDC_W(1.0) - (LDC_W(0.5) * u));
        s->of_yaw_rate[j] += b * (LDC_W(0.5) + (u * ((LDC_W(0.25) * u) - (LDC_W(2.0) / LDC_W(3.0)))));
        s->of_yaw_rate[j + 1] += b * u * ((LDC_W(0.25) * u) - (LDC_W(1.0) / LDC_W(3.0)));
    }
}

{% endif %}
/* The command for state x, yaw rates r and headings h of the lane ahead; outward. */
static ldc_work law(ldc_state *s, const ldc_work x[4], const ldc_work r[], const ldc_work h[], uint32_t *status)
{
{% if law != "pure_pursuit" and not sqp %}
    const ldc_work *g = s->gain;
{% endif %}
{% if law == "linear" %}
    ldc_work delta = (g[AT_F_U] * s->sent[0]) + dot(&g[AT_F], x, 4) + dot(&g[AT_G_YAW_RATE], r, {{ points }});
{% if has.G_heading %}
    delta += dot(&g[AT_G_HEADING], h, {{ points }});
{% endif %}
{% if has.f_past %}
    delta += dot(&g[AT_F_PAST], &s->sent[1], {{ has.f_past }});
{% endif %}
{% if has.f_wheel and has.of_wheel %}
    if (s->steps > 0) {
        s->angle = (g[AT_OF_WHEEL] * s->angle) + dot(&g[AT_OF_WHEEL + 1], &s->sent[{{ c.whole }}], 2);
    }
    delta += g[AT_F_WHEEL] * s->angle;
{% elif has.f_wheel %}
    delta += g[AT_F_WHEEL] * s->wheel;
{% endif %}
{% if has.f_i %}
    delta += g[AT_F_I] * s->memory;
    {{ "if (s->yields == 0) { " if yields }}s->memory += LDC_DT * x[0];{{ " }" if yields }}
{% endif %}
{% elif law == "pid" %}
    const ldc_work e_p = x[0] + (g[AT_DISTANCE] * (x[2] - (g[AT_E_PSI_SS] * r[0])));
    const ldc_work wanted = (LDC_W({{ c.K_p }}) * e_p) + s->memory + (g[AT_DELTA_SS] * r[0])
        + (LDC_W({{ c.K_d }}) * (x[1] + (g[AT_DISTANCE] * x[3])));
    const ldc_work delta = clip(wanted, -LDC_W({{ c.delta_max }}), LDC_W({{ c.delta_max }}));
    s->memory += {{ "((s->yields != 0) ? LDC_W(0.0) : " if yields }}(LDC_DT * LDC_W({{ c.K_i }}) * e_p){{ ")" if yields }} + (LDC_W({{ c.share }}) * (delta - wanted));
{% elif law == "stanley" %}
    /* change of the lane's heading from the centre of gravity to the front axle */
    const ldc_work to_axle = LDC_W({{ c.l_f }}) * (r[0] / s->v);
    const ldc_work e_f = x[0] + (LDC_W({{ c.l_f }}) * (SIN(x[2]) - (LDC_W(0.5) * to_axle)));
    const ldc_work wanted = (g[AT_SLIP] * r[0]) - (x[2] - to_axle) - (LDC_W({{ c.k_d_steer }}) * (s->sent[0] - s->sent[1]))
        - ARCTAN((LDC_W({{ c.k }}) * e_f) / (LDC_W({{ c.k_soft }}) + s->v)) - (LDC_W({{ c.k_d_yaw }}) * x[3]);
    const ldc_work delta = clip(wanted, -LDC_W({{ c.delta_max }}), LDC_W({{ c.delta_max }}));
{% elif law == "pure_pursuit" %}
    const ldc_work sine = SIN(x[2]);
    const ldc_work cosine = COS(x[2]);
    const ldc_work along = s->reach + (LDC_W({{ c.l_r }}) * cosine);
    const ldc_work across = dot(s->of_heading, h, {{ points }}) + dot(s->of_yaw_rate, r, {{ points }}) - x[0]
        + (LDC_W({{ c.l_r }}) * sine);
    const ldc_work to_left = (cosine * across) - (sine * along);
    const ldc_work wanted = ARCTAN((LDC_W(2.0) * LDC_W({{ c.L }}) * to_left) / ((along * along) + (across * across)));
    const ldc_work delta = clip(wanted, -LDC_W({{ c.delta_max }}), LDC_W({{ c.delta_max }}));
{% elif law == "sliding_mode" %}
    const ldc_work most = LDC_DT * LDC_W({{ c.k_2 }}); /* change of the disturbance in a sample */
    const ldc_work half = LDC_W(0.5) * LDC_DT * LDC_W({{ c.k_1 }});
    const ldc_work about[4] = {x[0], x[1], x[2] - (g[AT_E_PSI_SS] * r[0]), x[3]};
    const ldc_work sliding = dot(&g[AT_C], about, 4);
    const ldc_work excess = clip(ABS(sliding) - (LDC_DT * most), LDC_W(0.0), LARGEST);
    const ldc_work root = ROOT((half * half) + excess) - half;
    const ldc_work y = (sliding < LDC_W(0.0)) ? -(root * root) : (root * root);
    const ldc_work u = s->memory - clip(sliding / LDC_DT, -most, most) + ((y - sliding) / LDC_DT);
    const ldc_work drift = dot(&g[AT_DRIFT], about, 4) + (g[AT_CD] * (r[1] - r[0]));
    const ldc_work hold = (g[AT_DELTA_SS] * (LDC_W(0.5) * (r[0] + r[1]))) - (drift / g[AT_CB]);
    const ldc_work delta = clip(hold + ((LDC_DT * u) / g[AT_CB]), -LDC_W({{ c.delta_max }}), LDC_W({{ c.delta_max }}));
    s->memory += clip(LDC_W(0.5) * ((((delta - hold) * g[AT_CB]) / LDC_DT) - s->memory), -most, most);
{% elif law == "mpc" %}
    const ldc_work delta = first_move(s, g, x, r, status);
{% elif sqp %}
    const ldc_work delta = first_move(s, x, r, status);
{% endif %}
    (void)h;
    (void)status;
    return delta;
}

{% if filter %}
/* The state behind the camera's frames, into x: a stationary Kalman filter on the nominal vehicle. */
static void estimate(ldc_state *s, const ldc_inputs *in, ldc_work side, ldc_work x[4])
{
    const ldc_work *g = s->gain;
    const ldc_work lane = side * in->v * in->curvature_seen;
    for (int32_t i = 0; (i < 4) && (s->steps > 0); i++) {
        x[i] = dot(&g[AT_MODEL_A + (4 * i)], s->z, 4) + (g[AT_MODEL_B + i] * s->sent[{{ filter.known }}])
            + (g[AT_MODEL_B_OLD + i] * s->sent[{{ filter.known + 1 }}]) + (g[AT_MODEL_WHEEL + i] * s->wheel)
            + (g[AT_MODEL_E_0 + i] * s->lane) + (g[AT_MODEL_E_1 + i] * lane);
    }
    if ((s->steps == 0) || (in->frame_new != 0)) {
        const ldc_work gap[2] = {(side * in->frame_e_y) - x[0], (side * in->frame_e_psi) - x[2]};
        for (int32_t i = 0; i < 4; i++) { x[i] += dot(&g[AT_GAIN + (2 * i)], gap, 2); }
    }
    for (int32_t i = 0; i < 4; i++) { s->z[i] = x[i]; }
    s->lane = lane;
}

{% endif %}
/* Whether every input is finite and in range. */
static int32_t usable(const ldc_inputs *in)
{
    int32_t good = ((within(in->v, LDC_V_MAX) != 0) && (in->v >= LDC_V_MIN)) ? 1 : 0;
{% for name, size, kind in fields if kind == "ldc_real" %}
{% set limit = "LDC_MAX_CURVATURE" if name.startswith("curvature") else "LDC_MAX_INPUT" %}
{% if size %}
    for (int32_t i = 0; i < LDC_PREVIEW; i++) { good &= within(in->{{ name }}[i], {{ limit }}); }
{% else %}
    good &= within(in->{{ name }}, {{ limit }});
{% endif %}
{% endfor %}
    return good;
}

/* How far the edge of a side is beyond the line{% if ahead %}, in {{ ahead }} s{% endif %}. */
static ldc_work beyond(const ldc_inputs *in, int32_t side)
{
    const ldc_work line = (side > 0) ? in->line_left : in->line_right;
    return line{% if ahead %} + (LDC_W({{ ahead }}) * (ldc_work)side * in->line_rate){% endif %};
}

/* Take over: gains for the speed, every earlier command the angle of the wheels. */
static void take_over(ldc_state *s, const ldc_inputs *in, int32_t side)
{
    (void)memset(s, 0, sizeof(*s));
    s->phase = LDC_ACTIVE;
    s->side = side;
{% if driver %}
    s->assist_state = LDC_ASSIST_ACTIVE;
    s->authority = 1.0;
{% endif %}
    s->measured = in->wheel;
    s->v = in->v;
    s->angle = (ldc_work)side * in->wheel;
    for (int32_t i = 0; i < LDC_SENT; i++) { s->sent[i] = s->angle; }
{% if columns %}
    gains_at(s->v, s->gain);
{% endif %}
{% if law == "pure_pursuit" %}
    begin_pursuit(s);
{% endif %}
}

void ldc_init(ldc_state *state)
{
    (void)memset(state, 0, sizeof(*state)); /* LDC_ARMED is 0 */
}

{% if driver %}
/* Whether the driver overrides at this sample: the authority moves over the sample before, then the state changes. */
static void yield_to_driver(ldc_state *s, ldc_work torque)
{
    const int32_t pulls = (within(torque, LDC_OVERRIDE_TORQUE) == 0) ? 1 : 0;
    const int32_t active = (s->assist_state == LDC_ASSIST_ACTIVE) ? 1 : 0;
    const double now = s->authority + ((active != 0) ? LDC_RAMP_STEP : -LDC_RAMP_STEP);
    s->authority = (now > (1.0 - 1.0e-9)) ? 1.0 : ((now > 1.0e-9) ? now : 0.0);
    if (within(torque, LDC_MAX_INPUT) != 0) { /* otherwise the count is held */
        s->count = (pulls != active) ? 0 : (s->count + ((s->count < (INT32_MAX - 1)) ? 1 : 0));
        if ((active != 0) && (s->count >= LDC_OVERRIDE_STEPS)) { s->assist_state = LDC_ASSIST_OVERRIDDEN; }
        if ((s->assist_state == LDC_ASSIST_OVERRIDDEN) && (s->authority <= 0.0)) {
            s->assist_state = LDC_ASSIST_RELEASED;
            s->count = 1 - pulls;
        }
        if ((s->assist_state == LDC_ASSIST_RELEASED) && (s->count >= LDC_RETURN_STEPS)) {
            s->assist_state = LDC_ASSIST_ACTIVE;
            s->count = 0;
        }
    }
}

{% endif %}
/* A command while steering, outward. */
static ldc_work steer(ldc_state *s, const ldc_inputs *in, uint32_t *status)
{
    const ldc_work side = (ldc_work)s->side;
    ldc_work x[4] = {side * in->e_y, side * in->e_y_rate, side * in->e_psi, side * in->e_psi_rate};
    ldc_work r[LDC_PREVIEW]; /* yaw rate of the lane */
    ldc_work h[LDC_PREVIEW] = {LDC_W(0.0)}; /* change of its heading */
    ldc_work delta;
    for (int32_t i = 0; i < LDC_PREVIEW; i++) {
        r[i] = side * in->v * in->curvature[i];
{% if heading %}
        h[i] = side * in->heading[i];
{% endif %}
    }
{% if filter %}
    estimate(s, in, side, x);
{% endif %}
    s->wheel = side * in->wheel;
{% if yields %}
    s->yields = {{ "((s->steps > %d) && (within(s->sent[%d], LDC_W(%s)) == 0)) ? 1 : 0" % (whole, whole, delta_max) if delta_max else 0 }};
{% if driver %}
    if ((s->assist_state != LDC_ASSIST_ACTIVE) || (s->authority < 1.0) || (in->assist_saturated != 0)) { s->yields = 1; }
{% endif %}
{% endif %}
    delta = law(s, x, {{ "&r[2], &h[2]" if barrier else "r, h" }}, status);
    if (within(delta, LARGEST) == 0) {
        delta = s->sent[0];
        *status |= LDC_HELD;
    }
{% if barrier %}
    { /* into the interval that keeps the corridor, then into the limit of the angle */
        const ldc_work *g = s->gain;
        const ldc_work middle = dot(&g[AT_CENTRE], x, 4) + dot(&g[AT_CENTRE + 4], r, 2);
        delta = clip(delta, middle - g[AT_HALF_WIDTH], middle + g[AT_HALF_WIDTH]);
        delta = clip(delta, -LDC_W({{ barrier }}), LDC_W({{ barrier }}));
    }
{% endif %}
    for (int32_t i = LDC_SENT - 1; i > 0; i--) { s->sent[i] = s->sent[i - 1]; }
    s->sent[0] = delta;
    s->steps {{ "+= (s->steps > %d) ? 0 : 1" % whole if yields else "= 1" }};
    return delta;
}

uint32_t ldc_step(const ldc_inputs *in, ldc_state *state, ldc_outputs *out)
{
    ldc_state *s = state;
    uint32_t status = LDC_OK;
    int32_t iterations = 0;
    if (within(in->wheel, LDC_MAX_INPUT) != 0) { s->measured = in->wheel; }
    if (in->engage == 0) {
        s->phase = LDC_ARMED;
        s->handed_over = 0;
    }
{% if driver %}
    if (s->phase != LDC_ARMED) { yield_to_driver(s, in->driver_torque); } /* not in the step that takes over */
{% endif %}
    if (usable(in) == 0) {
        status = LDC_INPUT;
    } else {
        if ((s->phase == LDC_ARMED) && (in->engage != 0) && (s->handed_over == 0)) {
            const int32_t side = (beyond(in, 1) >= beyond(in, -1)) ? 1 : -1;
            if (beyond(in, side) > LDC_W({{ y_s }})) { take_over(s, in, side); }
        }
        if (s->phase != LDC_ARMED) {
            const ldc_work line = (s->side > 0) ? in->line_left : in->line_right;
            s->output = (ldc_work)s->side * steer(s, in, &status);
{% if mpc or sqp %}
            iterations = s->iterations;
{% endif %}
            if (line >= LDC_W(0.0)) { s->outside = 1; }
            if ((line < LDC_W(0.0)) && ((s->outside != 0) || (beyond(in, s->side) <= LDC_W({{ y_s }})))) {
                s->phase = LDC_RELEASED; /* back from beyond the line, or from what would have led there */
            }
        }
    }
    s->unusable = ((status & (LDC_INPUT | LDC_HELD)) != 0u) ? (s->unusable + 1) : 0;
    if ((s->phase != LDC_ARMED) && (s->unusable > LDC_HOLD_STEPS)) {
        s->phase = LDC_ARMED;
        s->handed_over = 1;
    }
    if (s->phase == LDC_ARMED) {
        s->side = 0;
        s->unusable = 0;
        s->output = s->measured;
    }
    if (s->handed_over != 0) { status |= LDC_HANDED_OVER; }
    out->delta = (ldc_real)s->output;
    out->phase = s->phase;
    out->side = s->side;
    out->status = status;
    out->iterations = iterations;
{% if driver %}
    out->assist_state = (s->phase == LDC_ARMED) ? LDC_ASSIST_ARMED : s->assist_state;
    out->authority = (s->phase == LDC_ARMED) ? (ldc_real)0.0 : (ldc_real)s->authority;
{% endif %}
    return status;
}
