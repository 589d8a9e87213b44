/* {{ title }}: see ldc_controller.h for what this code is and where it comes from. */
#include "ldc_controller.h"

#include <math.h>
#include <string.h>

#ifdef LDC_SINGLE
#define ABS fabsf
#define ARCTAN atanf
#define COS cosf
#define LOG logf
#define ROOT sqrtf
#define SIN sinf
#else
#define ABS fabs
#define ARCTAN atan
#define COS cos
#define LOG log
#define ROOT sqrt
#define SIN sin
#endif

#define LARGEST LDC_W(1.0e6) /* [rad] a command beyond it is none */

{% if columns %}
/* places of gains */
{% for name, at, unit in places %}
#define {{ name }} {{ at }} /* {{ unit }} */
{% endfor %}

#define TERMS {{ table|length }}

/* Coefficients of Chebyshev polynomials over log v, from LDC_V_MIN to LDC_V_MAX, a column for each gain. */
static const ldc_work table[TERMS][LDC_COLUMNS] = {
{% for row in table %}
    { {{ row }} }{{ "," if not loop.last }}
{% endfor %}
};

/* Gains at a speed, by the recurrence of Clenshaw. */
static void gains_at(ldc_work v, ldc_work gain[LDC_COLUMNS])
{
    const ldc_work z = ((LDC_W(2.0) * LOG(v / LDC_V_MIN)) / LDC_W({{ span }})) - LDC_W(1.0);
    int32_t k;
    int32_t n;
    for (k = 0; k < LDC_COLUMNS; k++) {
        ldc_work inner = LDC_W(0.0);
        ldc_work outer = LDC_W(0.0);
        for (n = TERMS - 1; n > 0; n--) {
            const ldc_work next = table[n][k] + ((LDC_W(2.0) * z * inner) - outer);
            outer = inner;
            inner = next;
        }
        gain[k] = table[0][k] + ((z * inner) - outer);
    }
}

{% endif %}
{% if clips %}
static ldc_work clip(ldc_work value, ldc_work low, ldc_work high)
{
    ldc_work result = (value < low) ? low : value;
    if (result > high) {
        result = high;
    }
    return result;
}

{% endif %}
{% if dots %}
static ldc_work dot(const ldc_work *a, const ldc_work *b, int32_t n)
{
    ldc_work sum = LDC_W(0.0);
    int32_t i;
    for (i = 0; i < n; i++) {
        sum += a[i] * b[i];
    }
    return sum;
}

{% endif %}
{% if law == "linear" %}
static ldc_work law(ldc_state *s, const ldc_work x[4], const ldc_work r[], const ldc_work h[], uint32_t *status)
{
    const ldc_work *g = s->gain;
    ldc_work delta = (g[AT_F_U] * s->sent[0]) + dot(&g[AT_F], x, 4);
    (void)status;
    delta += dot(&g[AT_G_YAW_RATE], r, {{ points }});
{% if has.G_heading %}
    delta += dot(&g[AT_G_HEADING], h, {{ points }});
{% else %}
    (void)h;
{% endif %}
{% if has.f_past %}
    delta += dot(&g[AT_F_PAST], &s->sent[1], {{ has.f_past }});
{% endif %}
{% if has.f_wheel and has.of_wheel %}
    if (s->steps > 0) {
        s->angle = (g[AT_OF_WHEEL] * s->angle) + (g[AT_OF_WHEEL + 1] * s->sent[{{ c.whole }}])
            + (g[AT_OF_WHEEL + 2] * s->sent[{{ c.whole + 1 }}]);
    }
    delta += g[AT_F_WHEEL] * s->angle;
{% elif has.f_wheel %}
    delta += g[AT_F_WHEEL] * s->wheel;
{% endif %}
{% if has.f_i %}
    delta += g[AT_F_I] * s->memory;
    s->memory += LDC_DT * x[0];
{% endif %}
    return delta;
}
{% elif law == "pid" %}
static ldc_work law(ldc_state *s, const ldc_work x[4], const ldc_work r[], const ldc_work h[], uint32_t *status)
{
    const ldc_work *g = s->gain;
    const ldc_work e_p = x[0] + (g[AT_DISTANCE] * (x[2] - (g[AT_E_PSI_SS] * r[0])));
    const ldc_work e_p_rate = x[1] + (g[AT_DISTANCE] * x[3]);
    const ldc_work wanted = (LDC_W({{ c.K_p }}) * e_p) + s->memory + (LDC_W({{ c.K_d }}) * e_p_rate)
        + (g[AT_DELTA_SS] * r[0]);
    const ldc_work delta = clip(wanted, -LDC_W({{ c.delta_max }}), LDC_W({{ c.delta_max }}));
    (void)h;
    (void)status;
    s->memory += (LDC_DT * LDC_W({{ c.K_i }}) * e_p) + (LDC_W({{ c.share }}) * (delta - wanted));
    return delta;
}
{% elif law == "stanley" %}
static ldc_work law(ldc_state *s, const ldc_work x[4], const ldc_work r[], const ldc_work h[], uint32_t *status)
{
    /* change of the lane's heading from the centre of gravity to the front axle */
    const ldc_work to_axle = LDC_W({{ c.l_f }}) * (r[0] / s->v);
    const ldc_work e_f = x[0] + (LDC_W({{ c.l_f }}) * (SIN(x[2]) - (LDC_W(0.5) * to_axle)));
    ldc_work wanted = (s->gain[AT_SLIP] * r[0]) - (x[2] - to_axle)
        - ARCTAN((LDC_W({{ c.k }}) * e_f) / (LDC_W({{ c.k_soft }}) + s->v)) - (LDC_W({{ c.k_d_yaw }}) * x[3]);
    (void)h;
    (void)status;
    if (s->steps > 0) {
        wanted -= LDC_W({{ c.k_d_steer }}) * (s->sent[0] - s->sent[1]);
    }
    return clip(wanted, -LDC_W({{ c.delta_max }}), LDC_W({{ c.delta_max }}));
}
{% elif law == "pure_pursuit" %}
/* Weights of heading and yaw rate of the lane ahead in the lateral position of the goal point: cubics every 0.1 s. */
static void begin_pursuit(ldc_state *s)
{
    const ldc_work step = LDC_W({{ c.step }});
    int32_t j;
    s->reach = LDC_W({{ c.T_lp }}) * s->v;
    s->reach = ((s->reach < LDC_W({{ c.l_min }})) ? LDC_W({{ c.l_min }}) : s->reach) - LDC_W({{ c.l_r }});
    for (j = 0; j < {{ points }}; j++) {
        s->of_heading[j] = LDC_W(0.0);
        s->of_yaw_rate[j] = LDC_W(0.0);
    }
    for (j = 0; j < ({{ points }} - 1); j++) {
        const ldc_work u = clip((s->reach / s->v / step) - (ldc_work)j, LDC_W(0.0), LDC_W(1.0));
        const ldc_work a = s->v * step * u;
        const ldc_work b = a * step * u;
        s->of_heading[j] += a * (LDC_W(1.0) + (u * u * ((LDC_W(0.5) * u) - LDC_W(1.0))));
        s->of_heading[j + 1] += a * u * u * (LDC_W(1.0) - (LDC_W(0.5) * u));
        s->of_yaw_rate[j] += b * (LDC_W(0.5) + (u * ((LDC_W(0.25) * u) - (LDC_W(2.0) / LDC_W(3.0)))));
        s->of_yaw_rate[j + 1] += b * u * ((LDC_W(0.25) * u) - (LDC_W(1.0) / LDC_W(3.0)));
    }
}

static ldc_work law(ldc_state *s, const ldc_work x[4], const ldc_work r[], const ldc_work h[], uint32_t *status)
{
    const ldc_work sine = SIN(x[2]);
    const ldc_work cosine = COS(x[2]);
    const ldc_work along = s->reach + (LDC_W({{ c.l_r }}) * cosine);
    const ldc_work across = dot(s->of_heading, h, {{ points }}) + dot(s->of_yaw_rate, r, {{ points }}) - x[0]
        + (LDC_W({{ c.l_r }}) * sine);
    const ldc_work to_left = (cosine * across) - (sine * along);
    const ldc_work wanted = ARCTAN((LDC_W(2.0) * LDC_W({{ c.L }}) * to_left) / ((along * along) + (across * across)));
    (void)status;
    return clip(wanted, -LDC_W({{ c.delta_max }}), LDC_W({{ c.delta_max }}));
}
{% elif law == "sliding_mode" %}
static ldc_work law(ldc_state *s, const ldc_work x[4], const ldc_work r[], const ldc_work h[], uint32_t *status)
{
    const ldc_work *g = s->gain;
    const ldc_work k_1 = LDC_W({{ c.k_1 }});
    const ldc_work most = LDC_DT * LDC_W({{ c.k_2 }}); /* change of the disturbance in a sample */
    const ldc_work about[4] = {x[0], x[1], x[2] - (g[AT_E_PSI_SS] * r[0]), x[3]};
    const ldc_work sliding = dot(&g[AT_C], about, 4);
    const ldc_work excess = ABS(sliding) - (LDC_DT * most);
    const ldc_work half = LDC_W(0.5) * LDC_DT * k_1;
    const ldc_work root = ROOT((half * half) + ((excess > LDC_W(0.0)) ? excess : LDC_W(0.0))) - half;
    const ldc_work y = (sliding < LDC_W(0.0)) ? -(root * root) : (root * root);
    const ldc_work u = s->memory - clip(sliding / LDC_DT, -most, most) + ((y - sliding) / LDC_DT);
    const ldc_work drift = dot(&g[AT_DRIFT], about, 4) + (g[AT_CD] * (r[1] - r[0]));
    const ldc_work hold = (g[AT_DELTA_SS] * (LDC_W(0.5) * (r[0] + r[1]))) - (drift / g[AT_CB]);
    const ldc_work delta = clip(hold + ((LDC_DT * u) / g[AT_CB]), -LDC_W({{ c.delta_max }}), LDC_W({{ c.delta_max }}));
    const ldc_work applied = ((delta - hold) * g[AT_CB]) / LDC_DT;
    (void)h;
    (void)status;
    s->memory += clip(LDC_W(0.5) * (applied - s->memory), -most, most);
    return delta;
}
{% elif law == "mpc" %}
{% include "ldc_mpc.c" %}
{% endif %}

{% if barrier %}
/* The command of the law, moved into the interval that keeps the corridor. */
static ldc_work filtered(ldc_state *s, const ldc_work x[4], const ldc_work r[], const ldc_work h[], uint32_t *status)
{
    const ldc_work *g = s->gain;
    const ldc_work middle = dot(&g[AT_CENTRE], x, 4) + dot(&g[AT_CENTRE + 4], r, 2);
    ldc_work delta = law(s, x, &r[2], {{ "&h[2]" if heading else "h" }}, status);
    if (!((delta >= -LARGEST) && (delta <= LARGEST))) {
        delta = s->sent[0];
        *status |= LDC_HELD;
    }
    delta = clip(delta, middle - g[AT_HALF_WIDTH], middle + g[AT_HALF_WIDTH]);
    return clip(delta, -LDC_W({{ barrier }}), LDC_W({{ barrier }}));
}

{% endif %}
{% if filter %}
/* The state behind the camera's frames: a stationary Kalman filter on the nominal vehicle. */
static void estimate(ldc_state *s, const ldc_inputs *in, ldc_work x[4], ldc_work side)
{
    const ldc_work *g = s->gain;
    const ldc_work lane = side * in->v * in->curvature_seen;
    int32_t i;
    if (s->steps > 0) {
        ldc_work next[4];
        for (i = 0; i < 4; i++) {
            next[i] = dot(&g[AT_MODEL_A + (4 * i)], s->z, 4) + (g[AT_MODEL_B + i] * s->sent[{{ filter.known }}])
                + (g[AT_MODEL_B_OLD + i] * s->sent[{{ filter.known + 1 }}]) + (g[AT_MODEL_WHEEL + i] * s->wheel)
                + (g[AT_MODEL_E_0 + i] * s->lane) + (g[AT_MODEL_E_1 + i] * lane);
        }
        for (i = 0; i < 4; i++) {
            s->z[i] = next[i];
        }
    } else {
        for (i = 0; i < 4; i++) {
            s->z[i] = x[i];
        }
    }
    if ((s->steps == 0) || (in->frame_new != 0)) {
        const ldc_work gap_y = (side * in->frame_e_y) - s->z[0];
        const ldc_work gap_psi = (side * in->frame_e_psi) - s->z[2];
        for (i = 0; i < 4; i++) {
            s->z[i] += (g[AT_GAIN + (2 * i)] * gap_y) + (g[AT_GAIN + (2 * i) + 1] * gap_psi);
        }
    }
    s->lane = lane;
    for (i = 0; i < 4; i++) {
        x[i] = s->z[i];
    }
}

{% endif %}
static int32_t within(ldc_work value, ldc_work limit)
{
    return ((value >= -limit) && (value <= limit)) ? 1 : 0; /* 0 for what is not a number, too */
}

/* Whether every input is finite and in range. */
static int32_t usable(const ldc_inputs *in)
{
    const ldc_work most = LDC_MAX_INPUT;
    int32_t good = ((in->v >= LDC_V_MIN) && (in->v <= LDC_V_MAX)) ? 1 : 0;
    int32_t i;
    good &= within(in->e_y, most) & within(in->e_y_rate, most) & within(in->e_psi, most);
    good &= within(in->e_psi_rate, most) & within(in->wheel, most);
    good &= within(in->line_left, most) & within(in->line_right, most);
{% if ahead %}
    good &= within(in->line_rate, most);
{% endif %}
    for (i = 0; i < LDC_PREVIEW; i++) {
        good &= within(in->curvature[i], LDC_MAX_CURVATURE);
{% if heading %}
        good &= within(in->heading[i], most);
{% endif %}
    }
{% if filter %}
    good &= within(in->frame_e_y, most) & within(in->frame_e_psi, most);
    good &= within(in->curvature_seen, LDC_MAX_CURVATURE);
{% endif %}
    return good;
}

/* How far the edge of a side is beyond the line{% if ahead %}, in {{ ahead }} s{% endif %}. */
static ldc_work beyond(const ldc_inputs *in, int32_t side)
{
    const ldc_work line = (side > 0) ? in->line_left : in->line_right;
{% if ahead %}
    return line + (LDC_W({{ ahead }}) * ((side > 0) ? in->line_rate : -in->line_rate));
{% else %}
    return line;
{% endif %}
}

/* Take over: gains for the speed, every earlier command the angle of the wheels. */
static void take_over(ldc_state *s, const ldc_inputs *in, int32_t side)
{
    const ldc_work wheel = (ldc_work)side * in->wheel;
    int32_t i;
    s->phase = LDC_ACTIVE;
    s->side = side;
    s->v = in->v;
{% if columns %}
    gains_at(in->v, s->gain);
{% endif %}
    for (i = 0; i < LDC_SENT; i++) {
        s->sent[i] = wheel;
    }
    s->memory = LDC_W(0.0);
    s->angle = wheel;
    s->outside = 0;
    s->steps = 0;
{% if law == "pure_pursuit" %}
    begin_pursuit(s);
{% endif %}
}

void ldc_init(ldc_state *state)
{
    (void)memset(state, 0, sizeof(*state));
    state->phase = LDC_ARMED;
}

/* A command while steering, outward. */
static ldc_work steer(ldc_state *s, const ldc_inputs *in, uint32_t *status)
{
    const ldc_work side = (ldc_work)s->side;
    ldc_work x[4] = {side * in->e_y, side * in->e_y_rate, side * in->e_psi, side * in->e_psi_rate};
    ldc_work r[LDC_PREVIEW];
{% if heading %}
    ldc_work h[LDC_PREVIEW];
{% else %}
    const ldc_work h[1] = {LDC_W(0.0)};
{% endif %}
    ldc_work delta;
    int32_t i;
    for (i = 0; i < LDC_PREVIEW; i++) {
        r[i] = side * in->v * in->curvature[i]; /* yaw rate of the lane */
{% if heading %}
        h[i] = side * in->heading[i];
{% endif %}
    }
{% if filter %}
    estimate(s, in, x, side);
{% endif %}
    s->wheel = side * in->wheel;
    delta = {{ "filtered" if barrier else "law" }}(s, x, r, h, status);
    if (!within(delta, LARGEST)) {
        delta = s->sent[0];
        *status |= LDC_HELD;
    }
    for (i = LDC_SENT - 1; i > 0; i--) {
        s->sent[i] = s->sent[i - 1];
    }
    s->sent[0] = delta;
    s->steps = (s->steps < 2) ? (s->steps + 1) : 2;
    return delta;
}

uint32_t ldc_step(const ldc_inputs *in, ldc_state *state, ldc_outputs *out)
{
    ldc_state *s = state;
    uint32_t status = LDC_OK;
    out->iterations = 0;
    if (usable(in) == 0) {
        status = LDC_INPUT;
    } else {
        if (in->engage == 0) {
            s->phase = LDC_ARMED;
            s->side = 0;
        } else if (s->phase == LDC_ARMED) {
            const ldc_work left = beyond(in, 1);
            const ldc_work right = beyond(in, -1);
            const ldc_work deepest = (left >= right) ? left : right;
            if (deepest > LDC_W({{ y_s }})) {
                take_over(s, in, (left >= right) ? 1 : -1);
            }
        } else {
            /* steering goes on */
        }
        if (s->phase == LDC_ARMED) {
            s->output = in->wheel;
        } else {
            const ldc_work line = (s->side > 0) ? in->line_left : in->line_right;
            s->output = (ldc_work)s->side * steer(s, in, &status);
{% if law == "mpc" %}
            out->iterations = s->iterations;
{% endif %}
            if (line >= LDC_W(0.0)) {
                s->outside = 1;
            } else if ((s->outside != 0) || (beyond(in, s->side) <= LDC_W({{ y_s }}))) {
                s->phase = LDC_RELEASED; /* back from beyond the line, or from what would have led there */
            } else {
                /* on its way to the line */
            }
        }
    }
    out->delta = (ldc_real)s->output;
    out->phase = s->phase;
    out->side = s->side;
    out->status = status;
    return status;
}
