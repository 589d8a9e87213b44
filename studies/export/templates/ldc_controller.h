/*
{% for line in banner %}
 *{% if line %} {{ line }}{% endif %}

{% endfor %}
 */
#ifndef LDC_CONTROLLER_H
#define LDC_CONTROLLER_H

#include <stdint.h>

/* define LDC_USE_FLOAT for single precision */
#ifdef LDC_USE_FLOAT
typedef float ldc_real;
#else
typedef double ldc_real;
#endif
{% if mpc and mpc.kinds %}
/* inside, double in any case: multipliers of soft limits are too large for single precision */
typedef double ldc_work;
#define LDC_W(x) (x)
{% else %}
#ifdef LDC_USE_FLOAT
#define LDC_SINGLE
#define LDC_W(x) (x##f)
#else
#define LDC_W(x) (x)
#endif
typedef ldc_real ldc_work;
{% endif %}

#define LDC_DT LDC_W({{ dt }}) /* [s] call ldc_step so often */
#define LDC_V_MIN LDC_W({{ v_min }}) /* [m/s] speeds that gains are known for */
#define LDC_V_MAX LDC_W({{ v_max }})
#define LDC_MAX_INPUT LDC_W(1000.0) /* largest magnitude of any input */
#define LDC_MAX_CURVATURE LDC_W(1.0) /* [1/m] */
#define LDC_PREVIEW {{ times|length }} /* points of the lane ahead, at the times below */
#define LDC_SENT {{ sent }} /* commands that are kept */
#define LDC_COLUMNS {{ columns }} /* gains scheduled over speed */

/* phases */
#define LDC_ARMED 0 /* no steering */
#define LDC_ACTIVE 1 /* steering since the departure */
#define LDC_RELEASED 2 /* the edge is back; steering goes on until engage is 0 */

/* bits of status */
#define LDC_OK 0u
#define LDC_INPUT 1u /* an input is not finite or out of range: output and state are held */
#define LDC_HELD 2u /* the command was not finite: the one before is held */
#define LDC_SOLVER_FAILED 4u /* a command of the fallback */
#define LDC_BEYOND 8u /* the hard limits cannot be met: back as fast as the rate allows */

/* Lengths in m, angles in rad, positive to the left (ISO 8855). */
typedef struct {
    ldc_real e_y; /* [m] offset of the centre of gravity from the lane's centre */
    ldc_real e_y_rate; /* [m/s] its rate */
    ldc_real e_psi; /* [rad] heading against the lane */
    ldc_real e_psi_rate; /* [rad/s] its rate */
    ldc_real v; /* [m/s] speed */
    ldc_real wheel; /* [rad] steering angle of the wheels at the moment of the state */
    ldc_real line_left; /* [m] left edge beyond the left line, negative inside the lane */
    ldc_real line_right; /* [m] right edge beyond the right line */
{% if ahead %}
    ldc_real line_rate; /* [m/s] lateral velocity, of the trigger by time to line crossing */
{% endif %}
    ldc_real curvature[LDC_PREVIEW]; /* [1/m] of the lane, in {{ times_text }} s */
{% if heading %}
    ldc_real heading[LDC_PREVIEW]; /* [rad] change of the lane's heading from now until then */
{% endif %}
{% if filter %}
    /* the state above is read at the departure only: the filter starts from it */
    ldc_real frame_e_y; /* [m] offset in the latest frame of the camera */
    ldc_real frame_e_psi; /* [rad] heading in it */
    ldc_real curvature_seen; /* [1/m] of the lane {{ age }} s ago, where the frame was taken */
    int32_t frame_new; /* 1 if no earlier step had this frame */
{% endif %}
    int32_t engage; /* 1: steer if a departure requires it; 0: hand over */
} ldc_inputs;

typedef struct {
    ldc_real delta; /* [rad] steering angle command; while armed the angle of the wheels */
    int32_t phase;
    int32_t side; /* 1 left, -1 right, 0 armed */
    uint32_t status;
    int32_t iterations; /* of the solver in this step; 0 without one */
} ldc_outputs;

{% if law == "mpc" %}
#define LDC_N {{ mpc.N }} /* horizon */
#define LDC_M {{ mpc.M }} /* free moves */
#define LDC_STATES {{ mpc.m }}
#define LDC_DELAY {{ mpc.delay }} /* samples until a command arrives */
#define LDC_WINDOW {{ mpc.window }} /* samples over which jerk is averaged */
#define LDC_KINDS {{ mpc.kinds|length }} /* of soft limits */
#define LDC_ROWS {{ mpc.rows }}
#define LDC_VARIABLES (LDC_M + LDC_KINDS)
#define LDC_ITERATIONS {{ mpc.iterations }} /* bound: a step that needs more steers by the fallback */

{% endif %}
/* One instance for each controller; set by ldc_init, then only by ldc_step. */
typedef struct {
{% if columns %}
    ldc_work gain[LDC_COLUMNS]; /* at the speed of the departure */
{% endif %}
    ldc_work v; /* [m/s] that speed */
    ldc_work output; /* [rad] last output */
    ldc_work sent[LDC_SENT]; /* [rad] commands, the latest first; outward */
    ldc_work memory; /* integral, or disturbance */
    ldc_work angle; /* [rad] of the wheels, as predicted from commands */
    ldc_work wheel; /* [rad] of the step before */
    ldc_work z[4]; /* estimate of the filter */
    ldc_work lane; /* [rad/s] yaw rate of the lane of the step before, as the filter knows it */
    int32_t phase;
    int32_t side;
    int32_t outside; /* the edge has been beyond the line */
    int32_t steps; /* since the departure, up to 2 */
{% if law == "pure_pursuit" %}
    ldc_work reach; /* [m] to the goal point along the lane */
    ldc_work of_heading[LDC_PREVIEW];
    ldc_work of_yaw_rate[LDC_PREVIEW];
{% endif %}
{% if law == "mpc" %}
{% if mpc.window %}
    ldc_work past[2][LDC_WINDOW]; /* [m/s^2] accelerations before and after each sample */
{% endif %}
    /* room to work in */
    ldc_work U[LDC_N];
    ldc_work G[LDC_N][LDC_M];
{% if mpc.kinds %}
    ldc_work of_a[3][LDC_N][LDC_M];
    ldc_work a[2][LDC_WINDOW + LDC_DELAY + LDC_N + 1];
{% endif %}
    ldc_work C[LDC_ROWS][LDC_M];
    ldc_work y[LDC_ROWS];
    ldc_work low[LDC_ROWS];
    ldc_work high[LDC_ROWS];
    ldc_work held[LDC_VARIABLES][LDC_VARIABLES];
    ldc_work factor[LDC_VARIABLES][LDC_VARIABLES];
    ldc_work right[LDC_VARIABLES];
    int32_t row[LDC_VARIABLES];
    int32_t iterations;
{% endif %}
} ldc_state;

void ldc_init(ldc_state *state);

/* One sample; returns the status. */
uint32_t ldc_step(const ldc_inputs *in, ldc_state *state, ldc_outputs *out);

#endif
