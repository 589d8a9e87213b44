/*
{% for line in banner %}
 *{% if line %} {{ line }}{% endif %}

{% endfor %}
 */
#ifndef LDC_CONTROLLER_H
#define LDC_CONTROLLER_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* define LDC_USE_FLOAT for single precision */
#ifdef LDC_USE_FLOAT
typedef float ldc_real;
#else
typedef double ldc_real;
#endif
{% if mpc or sqp %}
/* inside, double in any case: in single precision the solver fails where in double it does not */
typedef double ldc_work;
#define LDC_W(x) (x)
{% else %}
#define LDC_W(x) ((ldc_real)(x))
typedef ldc_real ldc_work;
{% endif %}

#define LDC_DT LDC_W({{ dt }}) /* [s] call ldc_step so often */
#define LDC_V_MIN LDC_W({{ v_min }}) /* [m/s] speeds that gains are known for */
#define LDC_V_MAX LDC_W({{ v_max }})
#define LDC_MAX_INPUT LDC_W(1000.0) /* largest magnitude of any input */
#define LDC_MAX_CURVATURE LDC_W(1.0) /* [1/m] */
#define LDC_PREVIEW {{ times|length }} /* points of the lane ahead */
/* lookahead times of the lane [s] */
#define LDC_LOOKAHEAD {{ times|join(" ") }}
#define LDC_SENT {{ sent }} /* commands that are kept */
#define LDC_COLUMNS {{ columns }} /* gains scheduled over speed */
#ifndef LDC_HOLD_STEPS
#define LDC_HOLD_STEPS {{ hold }} /* {{ hold_time }} s: so many unusable steps in a row are held, the next one hands over */
#endif

#define LDC_ARMED 0 /* phase: no steering */
#define LDC_ACTIVE 1 /* phase: steering since the departure */
#define LDC_RELEASED 2 /* phase: the edge is back; steering goes on until engage is 0 */

{% if driver %}
#define LDC_ASSIST_ARMED 0 /* assist_state: no torque, as the phase is armed */
#define LDC_ASSIST_ACTIVE 1 /* the assist steers */
#define LDC_ASSIST_OVERRIDDEN 2 /* the driver overrides: authority falls to 0 */
#define LDC_ASSIST_RELEASED 3 /* the driver steers */
#define LDC_OVERRIDE_TORQUE LDC_W({{ driver.torque }}) /* [N m] a larger torque of the driver, */
#define LDC_OVERRIDE_STEPS {{ driver.over }} /* at so many samples in a row, overrides */
#define LDC_RETURN_STEPS {{ driver.calm }} /* samples in a row without it until the assist comes back; INT32_MAX: never */
#define LDC_RAMP_STEP {{ driver.share }} /* change of authority in a sample */

{% endif %}
#define LDC_OK 0u
#define LDC_INPUT 1u /* bit of status: an input is not finite or out of range; the command and the state are held */
#define LDC_HELD 2u /* the command was not finite: the one before is held */
#define LDC_SOLVER_FAILED 4u /* a command of the fallback */
#define LDC_BEYOND 8u /* the hard limits cannot be met: back as fast as the rate allows */
#define LDC_HANDED_OVER 16u /* steps were unusable for too long: armed, and no new departure until engage has been 0 */

/* Lengths in m, angles in rad, positive to the left (ISO 8855). */
typedef struct {
{% for name, size, kind in fields %}
    {{ kind }} {{ name }}{{ "[LDC_PREVIEW]" if size }}; /* {{ meaning[name] }} */
{% endfor %}
} ldc_inputs;

typedef struct {
    ldc_real delta; /* [rad] steering angle command; while armed the angle of the wheels, as last measured */
    int32_t phase;
    int32_t side; /* 1 left, -1 right, 0 armed */
    uint32_t status;
    int32_t iterations; /* of the solver in this step; 0 without one */
{% if driver %}
    int32_t assist_state;
    ldc_real authority; /* share of the assist's torque at this sample, 0 to 1; 0 while armed */
{% endif %}
} ldc_outputs;

{% if mpc %}
#define LDC_N {{ mpc.N }} /* horizon */
#define LDC_M {{ mpc.M }} /* free moves */
#define LDC_STATES {{ mpc.m }}
#define LDC_DELAY {{ mpc.delay }} /* samples until a command arrives */
#define LDC_WINDOW {{ mpc.window }} /* samples over which jerk is averaged */
#define LDC_ROWS {{ mpc.rows }} /* limits on angle, rate, and soft ones */
#define LDC_VARIABLES {{ mpc.M + mpc.kinds|length }} /* moves, and slacks of soft limits */
#define LDC_ITERATIONS {{ mpc.iterations }} /* bound: a step that needs more steers by the fallback */

{% endif %}
{% if sqp %}
#define LDC_N {{ sqp.N }} /* horizon */
#define LDC_M {{ sqp.M }} /* free moves */
#define LDC_Z {{ sqp.nz }} /* states of the prediction */
#define LDC_OWN {{ sqp.own }} /* states that the design adds */
#define LDC_DELAY {{ sqp.delay }} /* samples until a command arrives */
#define LDC_WINDOW {{ sqp.window }} /* samples over which jerk is averaged */
#define LDC_OUT {{ sqp.outputs }} /* numbers of a sample that soft limits look at */
#define LDC_OUTPUTS ((LDC_N * LDC_OUT) + (2 * LDC_WINDOW) + 1) /* and accelerations before */
#define LDC_KINDS {{ sqp.kinds }} /* soft limits of a sample */
#define LDC_SOFT (LDC_N * LDC_KINDS)
#define LDC_ROWS ((2 * LDC_M) + LDC_SOFT) /* limits of a quadratic program */
#define LDC_VARIABLES LDC_M
#define LDC_SQP_ITERATIONS {{ sqp.programs }} /* bound: quadratic programs of a step, */
#define LDC_QP_ITERATIONS {{ sqp.iterations }} /* iterations of each; a step that needs more steers by the fallback */
#define LDC_ITERATIONS (LDC_SQP_ITERATIONS * LDC_QP_ITERATIONS)

/* A plan: commands, states, soft rows, cost with penalties, sum of the gaps. */
typedef struct {
    double U[LDC_N];
    double Z[LDC_N + 1][LDC_Z];
    double row[LDC_SOFT + 1];
    double merit;
    double gap;
} ldc_plan;

{% endif %}
/* One instance for each controller; set by ldc_init, then only by ldc_step. */
typedef struct {
    int32_t phase;
    int32_t side;
    int32_t outside; /* the edge has been beyond the line */
    int32_t steps; /* 0 at the departure, then {{ "up to %d" % (whole + 1) if yields else 1 }} */
    int32_t unusable; /* steps in a row with LDC_INPUT or LDC_HELD while steering */
    int32_t handed_over; /* 1 from LDC_HANDED_OVER on until engage is 0 */
{% if driver %}
    int32_t assist_state;
    int32_t count; /* samples in a row beyond LDC_OVERRIDE_TORQUE while active, not beyond it since the release */
    double authority; /* in double in any case: a ramp ends in the same sample */
{% endif %}
    ldc_work measured; /* [rad] last usable angle of the wheels */
    ldc_work output; /* [rad] last command */
    ldc_work v; /* [m/s] speed of the departure */
{% if yields %}
    int32_t yields; /* the assist did not follow the commands: the integral stays */
{% endif %}
{% if columns %}
    ldc_work gain[LDC_COLUMNS]; /* at that speed */
{% endif %}
    ldc_work sent[LDC_SENT]; /* [rad] commands, the latest first; outward, as all that follows */
    ldc_work memory; /* integral, or disturbance */
    ldc_work angle; /* [rad] of the wheels, as predicted from commands */
    ldc_work wheel; /* [rad] of the step before */
    ldc_work z[4]; /* estimate of the filter */
    ldc_work lane; /* [rad/s] yaw rate of the lane of the step before, as the filter knows it */
{% if law == "pure_pursuit" %}
    ldc_work reach; /* [m] to the goal point along the lane */
    ldc_work of_heading[LDC_PREVIEW];
    ldc_work of_yaw_rate[LDC_PREVIEW];
{% endif %}
{% if mpc %}
    int32_t iterations;
    ldc_work past[2][LDC_WINDOW + 1]; /* [m/s^2] accelerations before and after each sample */
    ldc_work U[LDC_N]; /* from here on room to work in */
    ldc_work G[LDC_N][LDC_M];
    ldc_work of_a[3][LDC_N][LDC_M];
    ldc_work a[2][LDC_WINDOW + LDC_DELAY + LDC_N + 1];
    ldc_work C[LDC_ROWS][LDC_M];
    ldc_work y[LDC_ROWS];
    ldc_work low[LDC_ROWS];
    ldc_work high[LDC_ROWS];
    ldc_work held[LDC_VARIABLES][LDC_VARIABLES];
    ldc_work factor[LDC_VARIABLES][LDC_VARIABLES];
    ldc_work right[LDC_VARIABLES];
{% endif %}
{% if sqp %}
    int32_t iterations;
    int32_t has_plan;
    double plan[LDC_N];
    double past[2][LDC_WINDOW]; /* [m/s^2] accelerations before and after each sample */
    double own[LDC_OWN + 1];
    double p[LDC_DELAY + LDC_N][4 + (2 * LDC_Z)]; /* from here on room to work in */
    double bound[4][LDC_N];
    double soft[4][LDC_SOFT + 1];
    double guess[LDC_N];
    ldc_plan now;
    ldc_plan trial;
    double gap[LDC_N][LDC_Z];
    double A[LDC_N][LDC_Z * LDC_Z];
    double B[LDC_N][LDC_Z];
    double pull[LDC_N][LDC_Z];
    double push[LDC_N];
    double of_z[LDC_N][(LDC_Z * LDC_OUT) + 1];
    double of_u[LDC_N][LDC_OUT + 1];
    double l[LDC_N + 1][LDC_Z];
    double slope;
    double T[LDC_M][LDC_Z];
    double t[LDC_Z];
    double H[LDC_M][LDC_M];
    double stiff[LDC_M][LDC_M];
    double g[LDC_M];
    double J_t;
    double Y[(LDC_N * LDC_OUT) + 1][LDC_M];
    double y[LDC_OUTPUTS];
    double m[LDC_OUTPUTS];
    double out[LDC_OUTPUTS];
    double turn[LDC_OUTPUTS];
    double limit[4][LDC_ROWS];
    double value[LDC_ROWS];
    double rate[LDC_ROWS];
    double press[LDC_ROWS];
    int32_t holds[LDC_ROWS]; /* 1 or -1: at a bound, 2 or -2: yielding */
    int32_t which[LDC_M + 1];
    double right[LDC_M + 1];
    double held[LDC_M][LDC_M];
    double factor[LDC_M][LDC_M];
    double L[LDC_M][LDC_M];
    double w[{{ sqp.work }}];
{% endif %}
} ldc_state;

void ldc_init(ldc_state *state);

/* One sample; returns the status. */
uint32_t ldc_step(const ldc_inputs *in, ldc_state *state, ldc_outputs *out);

#ifdef __cplusplus
}
#endif

#endif
