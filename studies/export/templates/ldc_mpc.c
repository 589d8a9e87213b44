#define TOLERANCE 1.0e-12 /* [rad, or share of a limit] */
#define PER_MULTIPLIER 1.0e-16
#define STEP LDC_W({{ c.rate_step }}) /* [rad] largest change of the command in a sample */

static const int32_t start[LDC_M + 1] = { {{ mpc.start|join(", ") }}, LDC_N }; /* first sample of each free move */
{% if mpc.kinds %}
static const int32_t first_row[] = { {{ mpc.first|join(", ") }} }; /* of each kind of soft limit */
static const ldc_work root[] = { {{ mpc.root }} }; /* of their weights */
{% endif %}

/* M x for a square matrix, row by row. */
static void times(const ldc_work *M, const ldc_work *x, ldc_work result[LDC_STATES])
{
    for (int32_t i = 0; i < LDC_STATES; i++) { result[i] = dot(&M[LDC_STATES * i], x, LDC_STATES); }
}

{% if mpc.kinds or mpc.delay %}
/* One step of the plant from x in place; the accelerations after its start and at its end are kept. */
static void go_on(ldc_state *s, const ldc_work *g, ldc_work x[LDC_STATES], ldc_work u, const ldc_work r[2], int32_t sample)
{
    ldc_work free[LDC_STATES];
{% if mpc.kinds %}
    s->a[1][sample] = dot(&g[AT_A_Y], x, LDC_STATES) + (g[AT_A_Y + LDC_STATES] * u) + (g[AT_A_Y + LDC_STATES + 1] * r[0]);
{% endif %}
    times(&g[AT_A], x, free);
    for (int32_t i = 0; i < LDC_STATES; i++) {
        x[i] = free[i] + (g[AT_B + i] * u) + (g[AT_E_0 + i] * r[0]) + (g[AT_E_1 + i] * r[1]);
    }
{% if mpc.kinds %}
    s->a[0][sample + 1] = dot(&g[AT_A_Y], x, LDC_STATES) + (g[AT_A_Y + LDC_STATES] * u)
        + (g[AT_A_Y + LDC_STATES + 1] * r[1]);
{% endif %}
    (void)s;
    (void)sample;
}

{% endif %}
/* The plan without limits: backwards over the horizon for the feedforward, forwards for the state. */
static void plan(ldc_state *s, const ldc_work *g, const ldc_work x[LDC_STATES], const ldc_work r[LDC_N + 1])
{
    ldc_work costate[LDC_STATES] = {LDC_W(0.0)};
    ldc_work z[LDC_STATES];
    ldc_work next[LDC_STATES];
    for (int32_t j = LDC_N - 1; j >= 0; j--) {
        const ldc_work pushed = dot(&g[AT_B], costate, LDC_STATES);
        for (int32_t i = 0; i < LDC_STATES; i++) {
            next[i] = (g[AT_PD + i] * (r[j + 1] - r[j])) - (g[AT_K + i] * pushed);
            for (int32_t k = 0; k < LDC_STATES; k++) { next[i] += g[AT_A + (LDC_STATES * k) + i] * costate[k]; }
        }
        (void)memcpy(costate, next, sizeof(costate));
        s->U[j] = dot(&g[AT_BACK], costate, LDC_STATES);
    }
    for (int32_t i = 0; i < LDC_STATES; i++) { z[i] = x[i] - (g[AT_X_SS + i] * r[0]); }
    for (int32_t j = 0; j < LDC_N; j++) {
        const ldc_work u = s->U[j] - dot(&g[AT_K], z, LDC_STATES);
        times(&g[AT_A], z, next);
        for (int32_t i = 0; i < LDC_STATES; i++) { z[i] = next[i] + (g[AT_B + i] * u) + (g[AT_D + i] * (r[j + 1] - r[j])); }
        s->U[j] = u + (LDC_W(0.5) * g[AT_DELTA_SS] * (r[j] + r[j + 1]));
    }
}

/* What corrections do to the commands; with blocks, commands of the plan become those of the best plan in blocks. */
static void moves(ldc_state *s, const ldc_work *g)
{
{% if has.moves %}
    ldc_work best[LDC_M];
    for (int32_t b = 0; b < LDC_M; b++) { best[b] = dot(&g[AT_PROJECT + (LDC_N * b)], s->U, LDC_N); }
{% endif %}
    for (int32_t b = 0; b < LDC_M; b++) {
        for (int32_t j = start[b]; j < start[b + 1]; j++) {
{% if has.moves %}
            s->U[j] = best[b];
            (void)memcpy(s->G[j], &g[AT_MOVES + (LDC_M * b)], sizeof(s->G[j]));
{% else %}
            for (int32_t k = 0; k < LDC_M; k++) { s->G[j][k] = (k > j) ? LDC_W(0.0) : g[AT_IMPULSE + (j - k)]; }
{% endif %}
        }
    }
}

/* Values y of the rows for the plan, their bounds, and what corrections do to them, C; 0 if no command is possible. */
static int32_t limits(ldc_state *s, const ldc_work *g, ldc_work x[LDC_STATES], const ldc_work r[LDC_N + 1])
{
    int32_t at = LDC_M;
    for (int32_t b = 0; b < LDC_M; b++) {
        s->y[b] = s->U[start[b]];
        s->high[b] = LDC_W({{ c.delta_max }});
        (void)memcpy(s->C[b], s->G[start[b]], sizeof(s->C[b]));
    }
    for (int32_t b = 1; b < LDC_M; b++) {
        s->y[at] = s->y[b] - s->y[b - 1];
        s->high[at] = STEP;
        for (int32_t k = 0; k < LDC_M; k++) { s->C[at][k] = s->C[b][k] - s->C[b - 1][k]; }
        at++;
    }
    for (int32_t j = at; j < LDC_ROWS; j++) { s->high[j] = LDC_W(1.0); } /* soft limits: shares of the limit */
    for (int32_t j = 0; j < LDC_ROWS; j++) { s->low[j] = -s->high[j]; }
    /* angle and rate of the first move are one row */
    s->low[0] = clip(s->sent[0] - STEP, s->low[0], LARGEST);
    s->high[0] = clip(s->sent[0] + STEP, -LARGEST, s->high[0]);
{% if mpc.kinds %}
    for (int32_t n = 0; n < 3; n++) { /* a at the end of a step, just after its start, and e_y */
        for (int32_t j = 0; j < LDC_N; j++) {
            for (int32_t k = 0; k < LDC_M; k++) {
                s->of_a[n][j][k] = LDC_W(0.0);
                for (int32_t i = 0; i <= j; i++) { s->of_a[n][j][k] += g[AT_RESPONSE + (LDC_N * n) + j - i] * s->G[i][k]; }
            }
        }
    }
    for (int32_t j = 0; j < LDC_N; j++) {
        go_on(s, g, x, s->U[j], &r[j], LDC_WINDOW + LDC_DELAY + j);
{% if "e_y" in mpc.kinds %}
        s->y[LDC_ROWS - LDC_N + j] = x[0] * LDC_W({{ c.e_y_scale }});
        for (int32_t k = 0; k < LDC_M; k++) { s->C[LDC_ROWS - LDC_N + j][k] = LDC_W({{ c.e_y_scale }}) * s->of_a[2][j][k]; }
{% endif %}
    }
{% for kind in mpc.kinds if kind != "e_y" %}
    for (int32_t n = 0; n < ({{ mpc.sides }} * LDC_N); n++) { /* {{ kind }}, {{ "just after each command, then " if mpc.sides > 1 }}at the end of each step */
        const int32_t side = (n / LDC_N) + {{ 2 - mpc.sides }};
        const int32_t j = n % LDC_N;
        const int32_t now = LDC_WINDOW + LDC_DELAY + j + side;
{% if kind == "jerk" %}
        /* a window before; the share by which it is rounded up */
        const ldc_work share = LDC_W({{ c.window_share }});
        const int32_t back = j + side - LDC_WINDOW - {{ "0" if c.window_share|float > 0 else "side" }};
        const ldc_work a_back = {% if c.window_share|float > 0 %}((LDC_W(1.0) - share) * s->a[1][now - LDC_WINDOW]) + (share * s->a[0][now - LDC_WINDOW + 1]){% else %}s->a[1 - side][now - LDC_WINDOW]{% endif %};
        s->y[at] = (s->a[1 - side][now] - a_back) * LDC_W({{ c.jerk_scale }});
        for (int32_t k = 0; k < LDC_M; k++) {
            const ldc_work of_back = (back < 0) ? LDC_W(0.0) : {% if c.window_share|float > 0 %}((LDC_W(1.0) - share) * s->of_a[1][back][k]) + (share * s->of_a[0][back][k]){% else %}s->of_a[1 - side][back][k]{% endif %};
            s->C[at][k] = LDC_W({{ c.jerk_scale }}) * (s->of_a[1 - side][j][k] - of_back);
        }
        (void)share;
{% else %}
        s->y[at] = s->a[1 - side][now] * LDC_W({{ c.a_y_scale }});
        for (int32_t k = 0; k < LDC_M; k++) { s->C[at][k] = LDC_W({{ c.a_y_scale }}) * s->of_a[1 - side][j][k]; }
{% endif %}
        at++;
    }
{% endfor %}
{% endif %}
    (void)g;
    (void)x;
    (void)r;
    return ((s->low[0] - s->high[0]) > ROUNDING) ? 0 : 1;
}

{% if mpc.kinds %}
/* Kind of the soft limit of a row; -1 for a hard one. */
static int32_t kind_of(int32_t row)
{
    int32_t kind = -1;
    for (int32_t k = 0; k < {{ mpc.kinds|length }}; k++) { kind += (row >= first_row[k]) ? 1 : 0; }
    return kind;
}

{% endif %}
/* The normal of a bound: of row (the upper one), of -1 - row (the lower one), or, behind the rows, of a slack at 0. */
static void normal(const ldc_state *s, int32_t bound, ldc_work of[LDC_VARIABLES])
{
    const int32_t row = (bound < 0) ? (-1 - bound) : bound;
    for (int32_t k = 0; k < LDC_VARIABLES; k++) { of[k] = (row == (LDC_ROWS + k - LDC_M)) ? LDC_W(-1.0) : LDC_W(0.0); }
    if (row < LDC_ROWS) {
        for (int32_t k = 0; k < LDC_M; k++) { of[k] = (bound < 0) ? -s->C[row][k] : s->C[row][k]; }
{% if mpc.kinds %}
        if (kind_of(row) >= 0) { of[LDC_M + kind_of(row)] = LDC_W(-1.0) / root[kind_of(row)]; }
{% endif %}
    }
}

/* By how much variables w are beyond a bound. */
static ldc_work violation(const ldc_state *s, int32_t bound, const ldc_work of[LDC_VARIABLES], const ldc_work w[LDC_VARIABLES])
{
    ldc_work result = dot(of, w, LDC_VARIABLES);
    if (bound < 0) {
        result += s->low[-1 - bound] - s->y[-1 - bound];
    } else if (bound < LDC_ROWS) {
        result += s->y[bound] - s->high[bound];
    } else {
        /* a slack is at least 0 */
    }
    return result;
}

/* The bound that w violates most by more than is rounding; the number of all bounds if there is none. */
static int32_t worst_bound(const ldc_state *s, const ldc_work w[LDC_VARIABLES], int32_t n)
{
    ldc_work worst = TOLERANCE;
    int32_t result = LDC_ROWS + LDC_VARIABLES;
    for (int32_t i = 0; i < n; i++) { worst = clip(PER_MULTIPLIER * s->right[i], worst, LARGEST); }
    for (int32_t row = 0; row < (LDC_ROWS + LDC_VARIABLES - LDC_M); row++) {
        ldc_work above = LDC_W(0.0);
        ldc_work below = LDC_W(0.0);
        if (row >= LDC_ROWS) {
            above = -w[LDC_M + row - LDC_ROWS];
        } else {
            const ldc_work value = s->y[row] + dot(s->C[row], w, LDC_M);
            const ldc_work slack = {{ "(kind_of(row) < 0) ? LDC_W(0.0) : (w[LDC_M + kind_of(row)] / root[kind_of(row)])" if mpc.kinds else "LDC_W(0.0)" }};
            above = value - s->high[row] - slack;
            below = s->low[row] - slack - value;
        }
        if ((above > worst) || (below > worst)) {
            result = (above > below) ? row : (-1 - row);
            worst = (above > below) ? above : below;
        }
    }
    return result;
}

/*
 * The smallest corrections that keep the limits, by the dual active set method of Goldfarb and Idnani (1983): hold the
 * bound that is violated most, let go of bounds whose multiplier would change its sign. 0 if it takes too long.
 */
static int32_t solve(ldc_state *s, ldc_work w[LDC_VARIABLES])
{
    ldc_work part[LDC_VARIABLES] = {LDC_W(0.0)};
    ldc_work to[LDC_VARIABLES] = {LDC_W(0.0)};
    ldc_work multiplier = LDC_W(0.0); /* of the bound that is being added */
    int32_t which[LDC_VARIABLES] = {0}; /* held bounds */
    int32_t adding = 0;
    int32_t bound = 0;
    int32_t n = 0; /* bounds held */
    for (int32_t i = 0; i < LDC_VARIABLES; i++) { w[i] = LDC_W(0.0); }
{% if mpc.kinds %}
    for (n = 0; n < {{ mpc.kinds|length }}; n++) { /* at first every slack is held at 0 */
        s->right[n] = root[n];
        which[n] = LDC_ROWS + n;
        normal(s, LDC_ROWS + n, s->held[n]);
    }
{% endif %}
    for (s->iterations = 1; s->iterations <= LDC_ITERATIONS; s->iterations++) {
        ldc_work along;
        ldc_work full;
        ldc_work step = LDC_W(0.0);
        int32_t first = -1; /* held bound whose multiplier is the first to be 0 */
        if (adding == 0) {
            bound = worst_bound(s, w, n);
            if (bound == (LDC_ROWS + LDC_VARIABLES)) { /* w once more, less what rounding left of the held bounds */
                for (int32_t i = 0; i < n; i++) { part[i] = violation(s, which[i], s->held[i], w); }
                gram(s, n, part);
                for (int32_t i = 0; i < n; i++) {
                    for (int32_t j = 0; j < LDC_VARIABLES; j++) { w[j] -= part[i] * s->held[i][j]; }
                }
                return 1;
            }
            normal(s, bound, to);
            multiplier = LDC_W(0.0);
            adding = 1;
        }
        for (int32_t i = 0; i < n; i++) { part[i] = dot(s->held[i], to, LDC_VARIABLES); }
        gram(s, n, part);
        along = dot(to, to, LDC_VARIABLES);
        full = along;
        for (int32_t i = 0; i < n; i++) {
            full -= part[i] * dot(s->held[i], to, LDC_VARIABLES);
            if ((part[i] > ROUNDING) && ((first < 0) || ((s->right[i] / part[i]) < step))) {
                step = s->right[i] / part[i];
                first = i;
            }
        }
        if ((full > (ROUNDING * along)) && (n < LDC_VARIABLES)) {
            const ldc_work excess = violation(s, bound, to, w); /* may be below 0 by rounding, after a shorter step */
            full = (excess > LDC_W(0.0)) ? (excess / full) : LDC_W(0.0);
        } else {
            full = LDC_W(-1.0);
        }
        if ((full >= LDC_W(0.0)) && ((first < 0) || (full <= step))) {
            step = full;
            adding = 0;
        } else if (first < 0) {
            return 0; /* no such plan */
        } else {
            /* a bound is let go first */
        }
        multiplier += step;
        for (int32_t j = 0; (j < LDC_VARIABLES) && (full >= LDC_W(0.0)); j++) {
            w[j] -= step * to[j];
            for (int32_t i = 0; i < n; i++) { w[j] += step * part[i] * s->held[i][j]; }
        }
        for (int32_t i = 0; i < n; i++) { s->right[i] -= step * part[i]; }
        if (adding == 0) {
            s->right[n] = multiplier;
            which[n] = bound;
            (void)memcpy(s->held[n], to, sizeof(to));
            n++;
        } else {
            n--;
            for (int32_t i = (first < 0) ? 0 : first; i < n; i++) {
                s->right[i] = s->right[i + 1];
                which[i] = which[i + 1];
                (void)memcpy(s->held[i], s->held[i + 1], sizeof(s->held[i]));
            }
        }
    }
    s->iterations = LDC_ITERATIONS;
    return 0;
}

/* First command of the best plan; the fallback where there is none. */
static ldc_work first_move(ldc_state *s, const ldc_work *g, const ldc_work x[4], const ldc_work seen[], uint32_t *status)
{
    ldc_work r[LDC_DELAY + LDC_N + 1]; /* yaw rate of the lane from the moment of the state on */
    ldc_work now[LDC_STATES] = {x[0], x[1], x[2], x[3]};
    ldc_work w[LDC_VARIABLES];
    ldc_work delta;
    for (int32_t j = 0; j < (LDC_DELAY + LDC_N + 1); j++) {
{% if mpc.age %}
        const ldc_work behind = clip((ldc_work)j - LDC_W({{ mpc.age }}), -LARGEST, LDC_W(0.0)); /* straight before now */
        r[j] = seen[j + 2] + (behind * (seen[1] - seen[0]));
{% else %}
        r[j] = seen[j];
{% endif %}
    }
    for (int32_t j = 4; j < LDC_STATES; j++) { now[j] = s->sent[LDC_DELAY]; }
{% if mpc.lagging %}
    now[4] = s->angle;
{% endif %}
{% if mpc.window %}
    const ldc_work a_free = dot(&g[AT_A_Y], now, LDC_STATES) + (g[AT_A_Y + LDC_STATES + 1] * r[0]); /* without a command */
    s->a[0][LDC_WINDOW] = a_free + (g[AT_A_Y + LDC_STATES] * s->sent[LDC_DELAY]);
    for (int32_t j = 0; j < LDC_WINDOW; j++) {
        s->a[0][j] = (s->steps == 0) ? s->a[0][LDC_WINDOW] : s->past[0][j];
        s->a[1][j] = (s->steps == 0) ? s->a[0][LDC_WINDOW] : s->past[1][j];
    }
{% endif %}
{% if mpc.lagging %}
    s->angle = dot(&g[AT_A + (LDC_STATES * 4) + 4], &now[4], LDC_STATES - 4); /* a sample later, with the command below */
{% endif %}
{% if mpc.delay %}
    for (int32_t j = 0; j < LDC_DELAY; j++) { go_on(s, g, now, s->sent[LDC_DELAY - 1 - j], &r[j], LDC_WINDOW + j); }
{% endif %}
    plan(s, g, now, &r[LDC_DELAY]);
    moves(s, g);
    s->iterations = 0;
    if (limits(s, g, now, &r[LDC_DELAY]) == 0) {
        delta = s->sent[0] + ((s->sent[0] > LDC_W(0.0)) ? -STEP : STEP);
        *status |= LDC_BEYOND;
    } else if (solve(s, w) != 0) {
        delta = clip(s->y[0] + dot(s->C[0], w, LDC_M), s->low[0], s->high[0]);
    } else {
        delta = clip(s->y[0], -LDC_W({{ c.delta_max }}), LDC_W({{ c.delta_max }}));
        delta = s->sent[0] + clip(delta - s->sent[0], -STEP, STEP);
        *status |= LDC_SOLVER_FAILED;
    }
{% if mpc.lagging %}
    s->angle += g[AT_B + 4] * {{ "s->sent[LDC_DELAY - 1]" if mpc.delay else "delta" }};
{% endif %}
{% if mpc.window %}
    s->a[1][LDC_WINDOW] = a_free + (g[AT_A_Y + LDC_STATES] * {{ "s->sent[LDC_DELAY - 1]" if mpc.delay else "delta" }});
    for (int32_t j = 0; j < LDC_WINDOW; j++) {
        s->past[0][j] = s->a[0][j + 1];
        s->past[1][j] = s->a[1][j + 1];
    }
{% endif %}
    return delta;
}
