{# The SQP method of _nmpc_solver, and a dual active set method for its quadratic programs. #}
#define STEP_NEWTON 1.0e-5 /* [rad] the error after a full Newton step is the square of it, up to a factor */
#define STEP_LINEAR 1.0e-7 /* [rad] after a step with another Hessian */
#define STEP_LAST 1.0e-6 /* [rad] where the merit cannot fall any more */
#define GAP 1.0e-6
#define PRIMAL 1.0e-10
#define ACTIVE 1.0e-8 /* [rad] a limit this close is active */
#define BOUNDLESS 1.0e20
#define FINITE 1.0e300
#define LANE(j) (s->p[LDC_DELAY + (j)])
#define COLUMN (&s->gain[AT_COLUMNS])
#define STEADY (&s->gain[AT_STEADY])

/* The formulation as functions of a sample, see ldc_predictions.c. */
{% for name in sqp.functions %}
int {{ name }}(const double **arg, double **res, int *iw, double *w, int mem);
{% endfor %}
#define CALL(function, in, out) ((void)function((const double *[])in, (double *[])out, NULL, s->w, 0))
#define LIST(...) {__VA_ARGS__}

static const int32_t move_of[LDC_N] = { {{ sqp.move_of|join(", ") }} }; /* the free move of each sample */
static const int32_t first[LDC_M + 1] = { {{ sqp.first|join(", ") }}, LDC_N }; /* the first sample of each free move; the end */
/* own states at the departure: constant, weights of state and steering angle */
static const double initially[LDC_OWN + 1][6] = { {{ sqp.initial }}{0.0} };
/* soft rows: sums of outputs of the horizon, and of accelerations of the samples before it */
static const int32_t output_of[LDC_SOFT + 1][{{ sqp.terms }}] = { {{ sqp.output_of }}{0} };
static const double share_of[LDC_SOFT + 1][{{ sqp.terms }}] = { {{ sqp.share_of }}{0.0} };

{% if sqp.nonlinear %}
/* Steady cornering of the nonlinear bicycle at yaw rate r: the steering angle; its heading error into e_psi. */
static double cornering(const double *c, double r, double *e_psi)
{
    /* c: C_af, C_ar, l_f, l_r, m, I_z, mu, v */
    const double load = {{ sqp.shape }} * c[6] * c[4] * {{ sqp.gravity }} / (2.0 * (c[2] + c[3]));
    const double share = clip(c[7] * r / (c[6] * {{ sqp.gravity }}), -{{ sqp.saturated }}, {{ sqp.saturated }});
    const double v_y = (c[3] * r) - (c[7] * tan(load * c[2] / c[1] * tan(asin(share) / {{ sqp.shape }})));
    const double heading = atan((v_y + (c[2] * r)) / c[7]);
    double turned = share;
    double delta = 0.0;
    for (int32_t i = 0; i < 7; i++) { /* the front force is turned by delta */
        delta = heading + (load * c[3] / c[0] * tan(asin(turned) / {{ sqp.shape }}));
        turned = clip(share / cos(delta), -{{ sqp.turned }}, {{ sqp.turned }});
    }
    *e_psi = -atan(v_y / c[7]);
    return delta;
}

{% endif %}
/* Steady cornering at yaw rate r: the steering angle; the states into z. */
static double reference(const ldc_state *s, double r, double z[LDC_Z])
{
    double delta;
    for (int32_t i = 0; i < {{ sqp.nx }}; i++) { z[i] = r * STEADY[i]; }
    delta = {{ "cornering(COLUMN, r, &z[2])" if sqp.nonlinear else "r * STEADY[%d]" % sqp.nx }};
{% for place in sqp.angles %}
    z[{{ place }}] = delta;
{% endfor %}
    return delta;
}

/* z after a sample, in place; accelerations just after its command and at its end. */
static void predict(ldc_state *s, double z[LDC_Z], double u, const double *p, double a[2])
{
    double next[LDC_Z];
    CALL(ldc_predict, LIST(z, &u, p, COLUMN), LIST(next, &a[0], &a[1]));
    (void)memcpy(z, next, sizeof(next));
}

/* A soft row of outputs. */
static double combined(int32_t row, const double out[LDC_OUTPUTS])
{
    double sum = 0.0;
    for (int32_t k = 0; k < {{ sqp.terms }}; k++) { sum += share_of[row][k] * out[output_of[row][k]]; }
    return sum;
}

/* What soft limits cost at rows. */
static double penalty(const ldc_state *s, const double row[LDC_SOFT + 1])
{
    double sum = 0.0;
    for (int32_t i = 0; i < LDC_SOFT; i++) {
        const double beyond_high = clip(row[i] - s->soft[1][i], 0.0, BOUNDLESS);
        const double v = clip(s->soft[0][i] - row[i], beyond_high, BOUNDLESS);
        sum += (s->soft[2][i] * v) + (0.5 * s->soft[3][i] * v * v);
    }
    return sum;
}

/* Cost with penalties, gaps and soft rows of the trial. */
static void measure(ldc_state *s)
{
    ldc_plan *at = &s->trial;
    double one = 0.0;
    double gap = 0.0;
    at->gap = 0.0;
    CALL(ldc_end, LIST(at->Z[LDC_N], LANE(LDC_N - 1), COLUMN), LIST(&at->merit, NULL, NULL));
    for (int32_t j = 0; j < LDC_N; j++) {
        CALL(ldc_value_one, LIST(at->Z[j], &at->U[j], at->Z[j + 1], LANE(j), COLUMN), LIST(&one, &gap, &s->out[LDC_OUT * j]));
        at->merit += one;
        at->gap += gap;
    }
    for (int32_t i = 0; i < LDC_SOFT; i++) { at->row[i] = combined(i, s->out); }
    at->merit += penalty(s, at->row);
}

/* Drive the model with the commands guess, or those of the LQR (lqr = 1), moved into the limits: the trial. */
static void drive(ldc_state *s, double lqr)
{
    double state[2][LDC_Z + 1];
    (void)memcpy(s->trial.Z[0], s->now.Z[0], sizeof(s->now.Z[0]));
    (void)memcpy(state[0], s->now.Z[0], sizeof(s->now.Z[0]));
    state[0][LDC_Z] = s->sent[0];
    for (int32_t j = 0; j < LDC_N; j++) {
        CALL(ldc_roll_one, LIST(state[j % 2], &s->guess[j], &lqr, LANE(j), &s->bound[0][j], &s->bound[1][j], &s->bound[2][j],
            &s->bound[3][j], COLUMN), LIST(state[(j + 1) % 2]));
        (void)memcpy(s->trial.Z[j + 1], state[(j + 1) % 2], sizeof(s->trial.Z[0]));
        s->trial.U[j] = state[(j + 1) % 2][LDC_Z];
    }
    measure(s);
    s->trial.gap = 0.0;
}

/* The same, each move held. */
static void drive_held(ldc_state *s)
{
{% if sqp.blocks %}
    double command = s->sent[0];
    for (int32_t b = 0; b < LDC_M; b++) {
        double low = s->guess[first[b]];
        double high = BOUNDLESS;
        for (int32_t j = first[b]; j < first[b + 1]; j++) { low = clip(s->bound[0][j], low, BOUNDLESS); }
        for (int32_t j = first[b]; j < first[b + 1]; j++) { high = clip(s->bound[1][j], -BOUNDLESS, high); }
        command = clip(clip(low, -BOUNDLESS, high), command + s->bound[2][first[b]], command + s->bound[3][first[b]]);
        for (int32_t j = first[b]; j < first[b + 1]; j++) { s->guess[j] = command; }
    }
{% endif %}
    drive(s, 0.0);
}

/* To the condensed problem, the cost of a sample: curvature W (its columns `stride` apart) and slope h on T w + t. */
static void weigh(ldc_state *s, const double *W, int32_t stride, const double h[LDC_Z])
{
    double of[LDC_Z];
    for (int32_t i = 0; i < LDC_Z; i++) {
        of[i] = h[i] + dot(&W[stride * i], s->t, LDC_Z); /* W is symmetric */
        s->J_t += 0.5 * s->t[i] * (h[i] + of[i]);
    }
    for (int32_t b = 0; b < LDC_M; b++) { s->g[b] += dot(s->T[b], of, LDC_Z); }
    for (int32_t b = 0; b < LDC_M; b++) {
        for (int32_t i = 0; i < LDC_Z; i++) { of[i] = dot(&W[stride * i], s->T[b], LDC_Z); }
        for (int32_t k = 0; k < LDC_M; k++) { s->H[b][k] += dot(s->T[k], of, LDC_Z); }
    }
}

/* x = A x + of, A by columns. */
static void forward(const double *A, const double of[LDC_Z], double x[LDC_Z])
{
    double next[LDC_Z];
    for (int32_t i = 0; i < LDC_Z; i++) {
        next[i] = of[i];
        for (int32_t k = 0; k < LDC_Z; k++) { next[i] += A[(LDC_Z * k) + i] * x[k]; }
    }
    (void)memcpy(x, next, sizeof(next));
}

/* Condense the problem at the plan to the moves w: cost w'Hw/2 + g'w + J_t, outputs Y w + y. */
static void linearise(ldc_state *s)
{
    static const double nothing[LDC_Z] = {0.0};
    const ldc_plan *at = &s->now;
    double bend[(LDC_Z + 1) * (LDC_Z + 1)];
    double end[LDC_Z * LDC_Z];
    const double *cross = &bend[(LDC_Z + 1) * LDC_Z];
    (void)memset(s->H, 0, sizeof(s->H));
    (void)memset(s->g, 0, sizeof(s->g));
    (void)memset(s->T, 0, sizeof(s->T));
    (void)memset(s->t, 0, sizeof(s->t));
    s->J_t = 0.0;
    s->slope = 0.0;
    CALL(ldc_end, LIST(at->Z[LDC_N], LANE(LDC_N - 1), COLUMN), LIST(NULL, s->l[LDC_N], end));
    for (int32_t j = LDC_N - 1; j >= 0; j--) { /* multipliers of the gaps, backwards */
        CALL(ldc_slopes_one, LIST(at->Z[j], &at->U[j], at->Z[j + 1], LANE(j), COLUMN),
            LIST(s->gap[j], s->A[j], s->B[j], s->pull[j], &s->push[j], s->of_z[j], s->of_u[j]));
        for (int32_t i = 0; i < LDC_Z; i++) {
            s->slope = clip(ABS(s->l[j + 1][i]), s->slope, FINITE);
            s->l[j][i] = dot(&s->A[j][LDC_Z * i], s->l[j + 1], LDC_Z) + s->pull[j][i];
            for (int32_t k = 0; k < LDC_OUT; k++) { s->l[j][i] += s->of_z[j][(LDC_Z * k) + i] * s->m[(LDC_OUT * j) + k]; }
        }
    }
    for (int32_t j = 0; j < LDC_N; j++) {
        const int32_t b = move_of[j];
        CALL(ldc_bend_one, LIST(at->Z[j], &at->U[j], LANE(j), COLUMN, s->l[j + 1], &s->m[LDC_OUT * j]), LIST(bend));
        weigh(s, bend, LDC_Z + 1, s->pull[j]);
        for (int32_t k = 0; k < LDC_M; k++) {
            const double mixed = dot(s->T[k], cross, LDC_Z);
            s->H[k][b] += mixed;
            s->H[b][k] += mixed;
        }
        s->H[b][b] += cross[LDC_Z];
        s->g[b] += s->push[j] + dot(cross, s->t, LDC_Z);
        for (int32_t k = 0; k < LDC_OUT; k++) {
            double *Y = s->Y[(LDC_OUT * j) + k];
            for (int32_t i = 0; i < LDC_M; i++) { Y[i] = dot(&s->of_z[j][LDC_Z * k], s->T[i], LDC_Z); }
            Y[b] += s->of_u[j][k];
            s->y[(LDC_OUT * j) + k] = dot(&s->of_z[j][LDC_Z * k], s->t, LDC_Z);
        }
        for (int32_t k = 0; k < LDC_M; k++) { forward(s->A[j], (k == b) ? s->B[j] : nothing, s->T[k]); }
        forward(s->A[j], s->gap[j], s->t);
    }
    weigh(s, end, LDC_Z, s->l[LDC_N]);
}

/* The full step of commands and states as the trial. */
static void lift(ldc_state *s, const double w[LDC_M])
{
    double change[LDC_Z] = {0.0};
    for (int32_t j = 0; j < LDC_N; j++) {
        double of[LDC_Z];
        for (int32_t i = 0; i < LDC_Z; i++) { of[i] = s->gap[j][i] + (s->B[j][i] * w[move_of[j]]); }
        forward(s->A[j], of, change);
        for (int32_t i = 0; i < LDC_Z; i++) { s->trial.Z[j + 1][i] = s->now.Z[j + 1][i] + change[i]; }
        s->trial.U[j] = s->now.U[j] + w[move_of[j]];
    }
    measure(s);
}

/* Values of the rows for moves w: the moves, their changes, soft rows. */
static void rows_of(ldc_state *s, const double w[LDC_M], double value[LDC_ROWS])
{
    for (int32_t b = 0; b < LDC_M; b++) {
        value[b] = w[b];
        value[LDC_M + b] = w[b] - ((b > 0) ? w[b - 1] : 0.0);
    }
    for (int32_t i = 0; i < (LDC_N * LDC_OUT); i++) { s->turn[i] = dot(s->Y[i], w, LDC_M); }
    for (int32_t i = 0; i < LDC_SOFT; i++) { value[(2 * LDC_M) + i] = combined(i, s->turn); }
}

/* The normal of the upper (side 1) or lower (-1) bound of a row. */
static void normal(const ldc_state *s, int32_t row, double side, double of[LDC_M])
{
    const int32_t soft = row - (2 * LDC_M);
    (void)memset(of, 0, LDC_M * sizeof(double));
    if (soft < 0) { of[row % LDC_M] = side; }
    if ((soft < 0) && (row > LDC_M)) { of[(row % LDC_M) - 1] = -side; }
    for (int32_t n = 0; (n < {{ sqp.terms }}) && (soft >= 0); n++) {
        const double *Y = s->Y[(output_of[soft][n] < (LDC_N * LDC_OUT)) ? output_of[soft][n] : (LDC_N * LDC_OUT)];
        for (int32_t k = 0; k < LDC_M; k++) { of[k] += side * share_of[soft][n] * Y[k]; }
    }
}

/* x = L^-1 x, or, back, L'^-1 x, L the factor of the Hessian. */
static void substitute(const ldc_state *s, double x[LDC_M], int32_t back)
{
    for (int32_t i = 0; i < LDC_M; i++) {
        const int32_t n = (back != 0) ? (LDC_M - 1 - i) : i;
        if (back == 0) { x[n] -= dot(s->L[n], x, n); }
        for (int32_t k = n + 1; (k < LDC_M) && (back != 0); k++) { x[n] -= s->L[k][n] * x[k]; }
        x[n] /= s->L[n][n];
    }
}

/* Factor the Hessian H with what yielding soft rows add, and transform the n held normals; 0 if it is not convex. */
static int32_t factorise(ldc_state *s, double H[LDC_M][LDC_M], int32_t n)
{
    double of[LDC_M];
    (void)memcpy(s->L, H, sizeof(s->L));
    for (int32_t i = 2 * LDC_M; i < LDC_ROWS; i++) {
        if ((s->holds[i] / 2) != 0) {
            normal(s, i, 1.0, of);
            for (int32_t k = 0; k < LDC_M; k++) {
                for (int32_t j = 0; j <= k; j++) { s->L[k][j] += s->limit[3][i] * of[k] * of[j]; }
            }
        }
    }
    for (int32_t i = 0; i < LDC_M; i++) {
        for (int32_t j = 0; j <= i; j++) {
            const double rest = s->L[i][j] - dot(s->L[i], s->L[j], j);
            if ((i == j) && (rest <= 0.0)) { return 0; }
            s->L[i][j] = (i == j) ? ROOT(rest) : (rest / s->L[j][j]);
        }
    }
    for (int32_t i = 0; i < n; i++) {
        normal(s, s->which[i], (double)s->holds[s->which[i]], s->held[i]);
        substitute(s, s->held[i], 0);
    }
    return 1;
}

/* How far a row is beyond its upper (side 1) or lower (-1) bound. */
static double excess(const ldc_state *s, int32_t row, int32_t side)
{
    return (side > 0) ? (s->value[row] - s->limit[1][row]) : (s->limit[0][row] - s->value[row]);
}

/*
 * The moves w that minimise w'Hw/2 + g'w and the penalties of soft rows, by the dual active set method of Goldfarb and
 * Idnani (1983): hold the bound that is violated most, let go of bounds whose multiplier would change its sign. A soft
 * row whose multiplier reaches its linear weight yields: its quadratic weight is a part of the Hessian until the
 * multiplier is back there. 1 if solved, 0 if H is not convex, -1 if it takes too long or nothing meets the bounds.
 */
static int32_t solve(ldc_state *s, double H[LDC_M][LDC_M], double w[LDC_M])
{
    double part[LDC_M] = {0.0};
    double along[LDC_M];
    double to[LDC_M];
    double multiplier = 0.0;
    int32_t row = LDC_ROWS;
    int32_t side = 0;
    int32_t n = 0;
    (void)memset(s->holds, 0, sizeof(s->holds));
    if (factorise(s, H, 0) == 0) { return 0; }
    for (int32_t k = 0; k < LDC_M; k++) { w[k] = -s->g[k]; }
    substitute(s, w, 0);
    substitute(s, w, 1);
    rows_of(s, w, s->value);
    for (int32_t iteration = 0; iteration < LDC_QP_ITERATIONS; iteration++) {
        double step = BOUNDLESS;
        double full;
        int32_t lets_go = -1; /* the held normal that comes first to 0, or to its linear weight */
        int32_t back = -1; /* the yielding row that is held again */
        int32_t yields = 0; /* the new row does, rather than be held: then there need not be room for one more */
        s->iterations++;
        if (row == LDC_ROWS) {
            double worst = PRIMAL;
            for (int32_t i = 0; i < (2 * LDC_ROWS); i++) {
                const int32_t sign = 1 - (2 * (i % 2));
                if ((s->holds[i / 2] == 0) && (excess(s, i / 2, sign) > worst)) {
                    row = i / 2;
                    side = sign;
                    worst = excess(s, row, side);
                }
            }
            multiplier = 0.0;
        }
        if (row == LDC_ROWS) {
            for (int32_t i = 0; i < LDC_ROWS; i++) { /* multipliers, with the sign of the bound */
                const int32_t sign = s->holds[i] / 2;
                s->press[i] = (double)sign * (s->limit[2][i] + (s->limit[3][i] * excess(s, i, sign)));
            }
            for (int32_t i = 0; i < n; i++) { s->press[s->which[i]] = s->right[i] * (double)s->holds[s->which[i]]; }
            return 1;
        }
        normal(s, row, (double)side, along);
        substitute(s, along, 0);
        for (int32_t i = 0; i < n; i++) { part[i] = dot(s->held[i], along, LDC_M); }
        gram(s, n, part);
        for (int32_t k = 0; k < LDC_M; k++) {
            to[k] = -along[k];
            for (int32_t i = 0; i < n; i++) { to[k] += part[i] * s->held[i][k]; }
        }
        full = dot(to, to, LDC_M);
        if ((n == LDC_M) || (full <= (ROUNDING * dot(along, along, LDC_M)))) { /* depends on what is held */
            full = 0.0;
            (void)memset(to, 0, sizeof(to));
        } else {
            step = excess(s, row, side) / full;
        }
        substitute(s, to, 1);
        rows_of(s, to, s->rate);
        if ((multiplier + step) > s->limit[2][row]) { /* it yields on the way */
            const double give = 1.0 / s->limit[3][row];
            step = (excess(s, row, side) + (give * (s->limit[2][row] - multiplier))) / (full + give);
            yields = 1;
        }
        for (int32_t i = 0; i < n; i++) {
            const double ahead = (part[i] > 0.0) ? s->right[i] : (s->limit[2][s->which[i]] - s->right[i]);
            if ((ABS(part[i]) > ROUNDING) && (ahead < (step * ABS(part[i])))) {
                step = ahead / ABS(part[i]);
                lets_go = i;
            }
        }
        for (int32_t i = 2 * LDC_M; i < LDC_ROWS; i++) {
            const int32_t sign = s->holds[i] / 2;
            const double rate = -(double)sign * s->rate[i];
            if ((sign != 0) && (n < LDC_M) && ((s->limit[3][i] * rate) > ROUNDING) && (excess(s, i, sign) < (step * rate))) {
                step = excess(s, i, sign) / rate;
                back = i;
            }
        }
        if (step >= BOUNDLESS) { return -1; } /* no such plan */
        step = clip(step, 0.0, BOUNDLESS);
        multiplier += step;
        for (int32_t k = 0; k < LDC_M; k++) { w[k] += step * to[k]; }
        for (int32_t i = 0; i < LDC_ROWS; i++) { s->value[i] += step * s->rate[i]; }
        for (int32_t i = 0; i < n; i++) { s->right[i] -= step * part[i]; }
        if (back >= 0) {
            s->holds[back] /= 2;
            s->right[n] = s->limit[2][back];
            s->which[n] = back;
            n++;
        } else if (lets_go >= 0) {
            const int32_t gone = s->which[lets_go];
            s->holds[gone] = (part[lets_go] > 0.0) ? 0 : (2 * s->holds[gone]);
            n--;
            for (int32_t i = lets_go; i < n; i++) {
                s->right[i] = s->right[i + 1];
                s->which[i] = s->which[i + 1];
            }
        } else {
            s->holds[row] = (yields != 0) ? (2 * side) : side;
            if (yields == 0) {
                s->right[n] = multiplier;
                s->which[n] = row;
                n++;
            }
            row = LDC_ROWS;
        }
        if (factorise(s, H, n) == 0) { return -1; }
    }
    return -1;
}

/* Two numbers turned by an angle, given by its tangent and cosine. */
static void rotate(double *a, double *b, double t, double cosine)
{
    const double before = *a;
    *a = cosine * (before - (t * *b));
    *b = cosine * ((t * before) + *b);
}

/* The eigenvalues of the stiffened Hessian, by Jacobi's rotations: 1 if they are positive; 2 if not, and turned round. */
static int32_t turn_round(ldc_state *s)
{
    double (*D)[LDC_M] = s->L;
    double (*V)[LDC_M] = s->factor;
    double largest = 0.0;
    double least = BOUNDLESS;
    (void)memcpy(s->L, s->stiff, sizeof(s->L));
    for (int32_t k = 0; k < (LDC_M * LDC_M); k++) { V[k / LDC_M][k % LDC_M] = ((k / LDC_M) == (k % LDC_M)) ? 1.0 : 0.0; }
    for (int32_t pair = 0; pair < (20 * LDC_M * LDC_M); pair++) { /* 20 rounds */
        const int32_t i = (pair / LDC_M) % LDC_M;
        const int32_t j = pair % LDC_M;
        if ((i < j) && (ABS(D[i][j]) > (1.0e-17 * (ABS(D[i][i]) + ABS(D[j][j]))))) {
            const double theta = (D[j][j] - D[i][i]) / (2.0 * D[i][j]);
            const double t = ((theta < 0.0) ? -1.0 : 1.0) / (ABS(theta) + ROOT((theta * theta) + 1.0));
            const double cosine = 1.0 / ROOT((t * t) + 1.0);
            for (int32_t k = 0; k < LDC_M; k++) { rotate(&D[k][i], &D[k][j], t, cosine); }
            for (int32_t k = 0; k < LDC_M; k++) { rotate(&D[i][k], &D[j][k], t, cosine); }
            for (int32_t k = 0; k < LDC_M; k++) { rotate(&V[k][i], &V[k][j], t, cosine); }
        }
    }
    for (int32_t i = 0; i < LDC_M; i++) {
        largest = clip(ABS(D[i][i]), largest, FINITE);
        least = clip(D[i][i], -FINITE, least);
    }
    if (least > (1.0e-8 * largest)) { return 1; }
    (void)memset(s->stiff, 0, sizeof(s->stiff));
    for (int32_t n = 0; n < LDC_M; n++) {
        const double value = clip(ABS(D[n][n]), 1.0e-8 * largest, FINITE);
        for (int32_t k = 0; k < (LDC_M * LDC_M); k++) { s->stiff[k / LDC_M][k % LDC_M] += value * V[k / LDC_M][n] * V[k % LDC_M][n]; }
    }
    return 2;
}

/* Moves w of the quadratic program at the plan: 0 if unsolved, 1 for Newton's step, 2 with another Hessian. */
static int32_t direction(ldc_state *s, double w[LDC_M])
{
    int32_t result = 1;
    int32_t good = 1;
    double shift = 0.0;
    linearise(s);
    for (int32_t b = 0; b < LDC_M; b++) {
        const int32_t j = first[b];
        const double turn = s->now.U[j] - ((j > 0) ? s->now.U[j - 1] : s->sent[0]);
        for (int32_t k = 0; k < 2; k++) {
            s->limit[k][b] = s->bound[k][j] - s->now.U[j];
            s->limit[k][LDC_M + b] = s->bound[2 + k][j] - turn;
            s->limit[2][b + (LDC_M * k)] = FINITE; /* never yields */
        }
        for (int32_t i = j + 1; i < first[b + 1]; i++) { /* a held move meets the limits of all its samples */
            s->limit[0][b] = clip(s->bound[0][i] - s->now.U[i], s->limit[0][b], FINITE);
            s->limit[1][b] = clip(s->bound[1][i] - s->now.U[i], -FINITE, s->limit[1][b]);
        }
        good &= ((s->limit[0][b] - s->limit[1][b]) <= PRIMAL) ? 1 : 0;
        good &= ((s->limit[0][LDC_M + b] - s->limit[1][LDC_M + b]) <= PRIMAL) ? 1 : 0;
        good &= within(s->g[b], FINITE);
        for (int32_t k = 0; k < LDC_M; k++) {
            good &= within(s->H[b][k], FINITE);
            shift = clip(ABS(s->H[b][k]), shift, FINITE);
        }
    }
    if (good == 0) { return 0; }
    for (int32_t i = 0; i < LDC_SOFT; i++) {
        for (int32_t k = 0; k < 4; k++) { s->limit[k][(2 * LDC_M) + i] = s->soft[k][i]; }
        for (int32_t k = 0; k < 2; k++) { s->limit[k][(2 * LDC_M) + i] -= s->now.row[i] + combined(i, s->y); }
    }
    good = solve(s, s->H, w);
    if (good == 0) { /* stiffen rows that are active here and were so before, which changes no solution on them */
        (void)memcpy(s->stiff, s->H, sizeof(s->stiff));
        for (int32_t i = 0; i < (2 * LDC_M); i++) {
            double of[LDC_M];
            const double closer = (ABS(s->limit[0][i]) < ABS(s->limit[1][i])) ? s->limit[0][i] : s->limit[1][i];
            normal(s, i, ((s->press[i] != 0.0) && (ABS(closer) <= ACTIVE)) ? 1.0 : 0.0, of);
            for (int32_t j = 0; j < (LDC_M * LDC_M); j++) {
                s->stiff[j / LDC_M][j % LDC_M] += shift * of[j / LDC_M] * of[j % LDC_M];
            }
        }
        result = turn_round(s);
        good = solve(s, s->stiff, w);
    }
    (void)memset(s->m, 0, sizeof(s->m));
    for (int32_t i = 0; i < LDC_SOFT; i++) {
        for (int32_t k = 0; k < {{ sqp.terms }}; k++) { s->m[output_of[i][k]] += share_of[i][k] * s->press[(2 * LDC_M) + i]; }
    }
    for (int32_t b = 0; b < LDC_M; b++) { good = (within(w[b], FINITE) != 0) ? good : 0; }
    return (good > 0) ? result : 0;
}

/* By how much the quadratic model changes the merit. */
static double pull_of(const ldc_state *s, const double w[LDC_M])
{
    double row[LDC_SOFT + 1];
    double sum = s->J_t + dot(s->g, w, LDC_M);
    for (int32_t b = 0; b < LDC_M; b++) { sum += 0.5 * w[b] * dot(s->H[b], w, LDC_M); }
    for (int32_t i = 0; i < LDC_SOFT; i++) { row[i] = s->now.row[i] + combined(i, s->y) + s->value[(2 * LDC_M) + i]; }
    return sum + (penalty(s, row) - penalty(s, s->now.row));
}

/* The better of the LQR and the last plan becomes the plan. */
static void begin_plan(ldc_state *s)
{
    drive(s, 1.0);
{% if sqp.blocks %}
    (void)memcpy(s->guess, s->trial.U, sizeof(s->guess));
    drive_held(s);
{% endif %}
    s->now = s->trial;
    if (s->has_plan != 0) {
        for (int32_t j = 0; j < LDC_N; j++) { s->guess[j] = s->plan[(j < (LDC_N - 1)) ? (j + 1) : j]; }
        drive_held(s);
        if ((s->trial.merit <= s->now.merit) || (within(s->now.merit, FINITE) == 0)) { s->now = s->trial; }
    }
}

/* Sequential quadratic programming: 1 if solved. */
static int32_t optimise(ldc_state *s)
{
    double w[LDC_M] = {0.0};
    double recent[4];
    double step = BOUNDLESS;
    int32_t blind = {{ 3 if sqp.kinds else 0 }};
    begin_plan(s);
    (void)memset(s->m, 0, sizeof(s->m));
    (void)memset(s->press, 0, sizeof(s->press));
    for (int32_t k = 0; k < 4; k++) { recent[k] = s->now.merit; }
    for (int32_t iteration = 0; iteration < LDC_SQP_ITERATIONS; iteration++) {
        const int32_t found = direction(s, w);
        const double nu = (2.0 * s->slope) + 1.0e-6;
        const double before = s->now.merit + (nu * s->now.gap);
        const double drop = clip((nu * s->now.gap) - pull_of(s, w), 0.0, FINITE);
        double high = before;
        double length = 1.0;
        int32_t good;
        if (found == 0) { return 0; }
        step = 0.0;
        for (int32_t b = 0; b < LDC_M; b++) { step = clip(ABS(w[b]), step, FINITE); }
        lift(s, w);
{% if sqp.quadratic %}
        if (found == 1) { /* the quadratic program was the whole problem */
            s->now = s->trial;
            return 1;
        }
{% endif %}
        /* for some iterations the merit may come back to what it was, so that rows that bend do not shorten the step */
        for (int32_t k = 0; (k < 4) && (iteration < 15); k++) { high = clip(recent[k], high, FINITE); }
        high += (1.0e-12 * (1.0 + ABS(before))) - (1.0e-4 * drop);
        good = ((s->trial.merit + (nu * s->trial.gap)) <= high) ? 1 : 0;
        if ((good != 0) && (s->trial.gap <= GAP) && (step <= ((found == 1) ? STEP_NEWTON : STEP_LINEAR))) {
            s->now = s->trial;
            return 1;
        }
        for (int32_t k = 0; (k < 12) && (good == 0); k++) { /* shorter, driven by the model */
            for (int32_t j = 0; j < LDC_N; j++) { s->guess[j] = s->now.U[j] + (length * w[move_of[j]]); }
            drive(s, 0.0);
            good = (s->trial.merit < (before - (1.0e-4 * length * drop))) ? 1 : 0;
            length *= 0.5;
        }
        if ((good == 0) && (s->now.gap > 0.0)) { /* the same commands without gaps */
            (void)memcpy(s->guess, s->now.U, sizeof(s->guess));
            drive(s, 0.0);
        } else if (good == 0) { /* the merit cannot fall: rounding, or soft rows whose bend the program has not seen */
            if ((step <= STEP_LAST) || (blind == 0)) { return (step <= STEP_LAST) ? 1 : 0; }
            blind--;
            lift(s, w);
        } else {
            /* a better plan */
        }
        s->now = s->trial;
        recent[iteration % 4] = s->now.merit + (nu * s->now.gap);
    }
    return {{ "1" if sqp.most else "((step <= STEP_LAST) && (s->now.gap <= GAP)) ? 1 : 0" }};
}

/* Take the prediction to where the next command steers; accelerations of the last samples, before and after each. */
static void go_ahead(ldc_state *s, const double x[4])
{
    double a[2];
    double z[LDC_Z];
    double *before = &s->out[LDC_N * LDC_OUT]; /* from LDC_DELAY on they are what soft rows look back on */
    double past[2][LDC_WINDOW + LDC_DELAY + 1];
    for (int32_t i = 0; i < LDC_OWN; i++) {
        const double begin = initially[i][0] + dot(&initially[i][1], x, 4) + (initially[i][5] * s->sent[0]);
        s->own[i] = (s->steps == 0) ? begin : s->own[i];
    }
{% if sqp.wheel %}
    s->own[{{ sqp.wheel - 4 }}] = s->wheel;
{% endif %}
    z[LDC_Z - 1] = s->sent[LDC_DELAY]; /* where the command before is a state, it is the last */
    (void)memcpy(z, x, 4u * sizeof(double));
    (void)memcpy(&z[4], s->own, LDC_OWN * sizeof(double));
    (void)memcpy(s->now.Z[0], z, sizeof(z));
    predict(s, z, s->sent[LDC_DELAY], s->p[0], a);
    for (int32_t k = 0; k < 2; k++) {
        for (int32_t j = 0; j < LDC_WINDOW; j++) { past[k][j] = (s->steps == 0) ? a[0] : s->past[k][j]; }
    }
    past[0][LDC_WINDOW] = a[0];
    past[1][LDC_WINDOW + LDC_DELAY] = a[0];
    for (int32_t j = 0; j < LDC_DELAY; j++) {
        predict(s, s->now.Z[0], s->sent[LDC_DELAY - 1 - j], s->p[j], a);
        past[1][LDC_WINDOW + j] = a[0];
        past[0][LDC_WINDOW + j + 1] = a[1];
        if (j == 0) { (void)memcpy(s->own, &s->now.Z[0][4], LDC_OWN * sizeof(double)); }
    }
    for (int32_t k = 0; k < 2; k++) { (void)memcpy(s->past[k], &past[k][1], sizeof(s->past[k])); }
    (void)memcpy(before, &past[0][LDC_DELAY], (LDC_WINDOW + 1) * sizeof(double));
    (void)memcpy(&before[LDC_WINDOW + 1], &past[1][LDC_DELAY], LDC_WINDOW * sizeof(double));
}

/* First command of the best plan; the fallback where there is none. */
static ldc_work first_move(ldc_state *s, const double x[4], const double seen[], uint32_t *status)
{
    double r[LDC_DELAY + LDC_N + 1]; /* yaw rate of the lane from the moment of the state on */
    double reach[2] = {s->sent[0], s->sent[0]};
    double room[LDC_Z];
    double delta;
    for (int32_t j = 0; j < (LDC_DELAY + LDC_N + 1); j++) {
{% if sqp.age %}
        const double behind = clip((double)j - {{ sqp.age }}, -LARGEST, 0.0); /* straight before now */
        r[j] = seen[j + 2] + (behind * (seen[1] - seen[0]));
{% else %}
        r[j] = seen[j];
{% endif %}
    }
    for (int32_t j = 0; j < (LDC_DELAY + LDC_N); j++) {
        double *p = s->p[j]; /* yaw rate at both ends, index, steering angle, reference states at both ends */
        p[0] = r[j];
        p[1] = r[j + 1];
        p[2] = (double)(j - LDC_DELAY);
        p[3] = reference(s, 0.5 * (r[j] + r[j + 1]), room);
        (void)reference(s, r[j], &p[4]);
        (void)reference(s, r[j + 1], &p[4 + LDC_Z]);
    }
    go_ahead(s, x);
    s->iterations = 0;
    for (int32_t j = 0; j < LDC_N; j++) {
        double of[4][LDC_KINDS + 1];
        CALL(ldc_limit, LIST(LANE(j), COLUMN), LIST(&s->bound[0][j], &s->bound[1][j], &s->bound[2][j], &s->bound[3][j],
            of[0], of[1], of[2], of[3]));
        for (int32_t k = 0; k < 4; k++) {
            s->bound[k][j] = clip(s->bound[k][j], -BOUNDLESS, BOUNDLESS);
            for (int32_t i = 0; i < LDC_KINDS; i++) { /* what costs nothing is no limit */
                const double free = (k == 0) ? -BOUNDLESS : ((k == 1) ? BOUNDLESS : 1.0);
                s->soft[k][(LDC_N * i) + j] = (of[3][i] <= 0.0) ? free : clip(of[k][i], -BOUNDLESS, BOUNDLESS);
            }
        }
        reach[0] += s->bound[2][j];
        reach[1] += s->bound[3][j];
        if ((j == 0) && ((s->bound[1][0] < reach[0]) || (s->bound[0][0] > reach[1]))) { *status |= LDC_BEYOND; }
        /* where the command before is so far out that none meets both limits: what the rate can reach */
        s->bound[0][j] = clip(s->bound[0][j], -BOUNDLESS * 100.0, reach[1]);
        s->bound[1][j] = clip(s->bound[1][j], reach[0], BOUNDLESS * 100.0);
    }
    s->has_plan = optimise(s);
    for (int32_t j = 0; j < LDC_N; j++) {
        s->has_plan &= within(s->now.U[j], FINITE);
        for (int32_t k = 0; k < 4; k++) { s->has_plan &= within(s->bound[k][j], FINITE); }
    }
    delta = s->now.U[0];
    if (s->has_plan != 0) {
        (void)memcpy(s->plan, s->now.U, sizeof(s->plan));
    } else {
        delta = LANE(0)[3];
        for (int32_t i = 0; i < LDC_Z; i++) { delta -= COLUMN[{{ sqp.nc }} - LDC_Z + i] * (s->now.Z[0][i] - LANE(0)[4 + i]); }
        if (within(delta, FINITE) == 0) { delta = 0.0; }
        *status = (*status & ~LDC_BEYOND) | LDC_SOLVER_FAILED;
    }
    delta = clip(delta, s->bound[0][0], s->bound[1][0]);
    delta = clip(delta, s->sent[0] + s->bound[2][0], s->sent[0] + s->bound[3][0]);
{% if not sqp.delay %}
    {
        double a[2];
        (void)memcpy(room, s->now.Z[0], sizeof(room));
        predict(s, room, delta, s->p[0], a);
        s->past[1][LDC_WINDOW - 1] = a[0];
        (void)memcpy(s->own, &room[4], LDC_OWN * sizeof(double));
    }
{% endif %}
    return delta;
}
