#ifdef LDC_SINGLE
#define ACCEPTED LDC_W(1.0e-5) /* violation of a limit that is rounding [rad, or share of a soft limit] */
#define PER_MULTIPLIER LDC_W(1.0e-6) /* and where multipliers are large */
#define ROUNDING LDC_W(1.0e-6)
#define DEPENDENT LDC_W(1.0e-5)
#else
#define ACCEPTED LDC_W(1.0e-10)
#define PER_MULTIPLIER LDC_W(1.0e-14)
#define ROUNDING LDC_W(1.0e-12)
#define DEPENDENT LDC_W(1.0e-12)
#endif

{% if mpc.kinds or mpc.delay %}
/* One step of the plant from x in place; with soft limits the acceleration after its start and at its end. */
static void go_on(ldc_state *s, ldc_work x[LDC_STATES], ldc_work u, const ldc_work r[2], int32_t sample)
{
    const ldc_work *g = s->gain;
    ldc_work after[LDC_STATES];
    int32_t i;
{% if mpc.kinds %}
    s->a[1][sample] = dot(&g[AT_A_Y], x, LDC_STATES) + (g[AT_A_Y + LDC_STATES] * u) + (g[AT_A_Y + LDC_STATES + 1] * r[0]);
{% else %}
    (void)sample;
{% endif %}
    for (i = 0; i < LDC_STATES; i++) {
        after[i] = dot(&g[AT_A + (LDC_STATES * i)], x, LDC_STATES) + (g[AT_B + i] * u) + (g[AT_E_0 + i] * r[0])
            + (g[AT_E_1 + i] * r[1]);
    }
    for (i = 0; i < LDC_STATES; i++) {
        x[i] = after[i];
    }
{% if mpc.kinds %}
    s->a[0][sample + 1] = dot(&g[AT_A_Y], x, LDC_STATES) + (g[AT_A_Y + LDC_STATES] * u)
        + (g[AT_A_Y + LDC_STATES + 1] * r[1]);
{% endif %}
}

{% endif %}
/* The plan without limits: backwards over the horizon for the feedforward, forwards for the state. */
static void plan(ldc_state *s, const ldc_work x[LDC_STATES], const ldc_work r[LDC_N + 1])
{
    const ldc_work *g = s->gain;
    ldc_work costate[LDC_STATES] = {LDC_W(0.0)};
    ldc_work next[LDC_STATES];
    ldc_work z[LDC_STATES];
    int32_t i;
    int32_t j;
    int32_t k;
    for (j = LDC_N - 1; j >= 0; j--) {
        const ldc_work pushed = dot(&g[AT_B], costate, LDC_STATES);
        for (i = 0; i < LDC_STATES; i++) {
            next[i] = (g[AT_PD + i] * (r[j + 1] - r[j])) - (g[AT_K + i] * pushed);
            for (k = 0; k < LDC_STATES; k++) {
                next[i] += g[AT_A + (LDC_STATES * k) + i] * costate[k];
            }
        }
        for (i = 0; i < LDC_STATES; i++) {
            costate[i] = next[i];
        }
        s->U[j] = dot(&g[AT_BACK], costate, LDC_STATES);
    }
    for (i = 0; i < LDC_STATES; i++) {
        z[i] = x[i] - (g[AT_X_SS + i] * r[0]);
    }
    for (j = 0; j < LDC_N; j++) {
        const ldc_work u = s->U[j] - dot(&g[AT_K], z, LDC_STATES);
        for (i = 0; i < LDC_STATES; i++) {
            next[i] = dot(&g[AT_A + (LDC_STATES * i)], z, LDC_STATES) + (g[AT_B + i] * u)
                + (g[AT_D + i] * (r[j + 1] - r[j]));
        }
        for (i = 0; i < LDC_STATES; i++) {
            z[i] = next[i];
        }
        s->U[j] = u + (LDC_W(0.5) * g[AT_DELTA_SS] * (r[j] + r[j + 1]));
    }
}

static const int32_t start[LDC_M + 1] = { {{ mpc.start }}, LDC_N }; /* first sample of each free move */

/* What corrections do to the commands; with blocks, commands of the plan become those of the best plan in blocks. */
static void moves(ldc_state *s)
{
    const ldc_work *g = s->gain;
    int32_t b;
    int32_t j;
    int32_t k;
{% if has.MOVES %}
    ldc_work best[LDC_M];
    for (b = 0; b < LDC_M; b++) {
        best[b] = dot(&g[AT_PROJECT + (LDC_N * b)], s->U, LDC_N);
    }
{% endif %}
    for (b = 0; b < LDC_M; b++) {
        for (j = start[b]; j < start[b + 1]; j++) {
{% if has.MOVES %}
            s->U[j] = best[b];
{% endif %}
            for (k = 0; k < LDC_M; k++) {
                s->G[j][k] = {% if has.MOVES %}g[AT_MOVES + (LDC_M * b) + k]{% else %}(k > j) ? LDC_W(0.0) : g[AT_IMPULSE + (j - k)]{% endif %};
            }
        }
    }
}

{% if mpc.kinds %}
/* What corrections do to an output that answers to a command k steps before by response[k]. */
static void respond(const ldc_state *s, const ldc_work response[LDC_N], ldc_work of[LDC_N][LDC_M])
{
    int32_t i;
    int32_t j;
    int32_t k;
    for (j = 0; j < LDC_N; j++) {
        for (k = 0; k < LDC_M; k++) {
            of[j][k] = LDC_W(0.0);
            for (i = 0; i <= j; i++) {
                of[j][k] += response[j - i] * s->G[i][k];
            }
        }
    }
}

{% endif %}
/* Values y of the rows for the plan, their bounds, and what corrections do to them, C; 0 if no command is possible. */
static int32_t limits(ldc_state *s, ldc_work x[LDC_STATES], const ldc_work r[LDC_N + 1])
{
    const ldc_work step = LDC_W({{ c.rate_step }});
    ldc_work gap;
    int32_t b;
    int32_t j;
    int32_t k;
{% if mpc.kinds %}
    int32_t at = (2 * LDC_M) - 1;
    int32_t side;
{% endif %}
    for (b = 0; b < LDC_M; b++) {
        s->y[b] = s->U[start[b]];
        s->high[b] = LDC_W({{ c.delta_max }});
        for (k = 0; k < LDC_M; k++) {
            s->C[b][k] = s->G[start[b]][k];
        }
    }
    for (j = LDC_M; j < ((2 * LDC_M) - 1); j++) {
        b = j - LDC_M + 1;
        s->y[j] = s->y[b] - s->y[b - 1];
        s->high[j] = step;
        for (k = 0; k < LDC_M; k++) {
            s->C[j][k] = s->C[b][k] - s->C[b - 1][k];
        }
    }
    for (j = (2 * LDC_M) - 1; j < LDC_ROWS; j++) {
        s->high[j] = LDC_W(1.0); /* soft limits: shares of the limit */
    }
    for (j = 0; j < LDC_ROWS; j++) {
        s->low[j] = -s->high[j];
    }
    /* angle and rate of the first move are one row */
    s->low[0] = clip(s->sent[0] - step, s->low[0], LARGEST);
    s->high[0] = clip(s->sent[0] + step, -LARGEST, s->high[0]);
    gap = s->low[0] - s->high[0];
    if (gap > LDC_W(0.0)) {
        if (s->sent[0] > LDC_W(0.0)) {
            s->high[0] = s->low[0];
        } else {
            s->low[0] = s->high[0];
        }
    }
{% if mpc.kinds %}
    for (j = 0; j < LDC_N; j++) {
        go_on(s, x, s->U[j], &r[j], LDC_WINDOW + LDC_DELAY + j);
{% if "e_y" in mpc.kinds %}
        s->y[LDC_ROWS - LDC_N + j] = x[0] * LDC_W({{ c.e_y_scale }});
{% endif %}
    }
    respond(s, &s->gain[AT_RESPONSE], s->of_a[0]);
    respond(s, &s->gain[AT_RESPONSE + LDC_N], s->of_a[1]);
    respond(s, &s->gain[AT_RESPONSE + (2 * LDC_N)], s->of_a[2]);
{% if "a_y" in mpc.kinds %}
    for (side = {{ 2 - mpc.sides }}; side < 2; side++) {
        for (j = 0; j < LDC_N; j++) {
            s->y[at] = s->a[1 - side][LDC_WINDOW + LDC_DELAY + j + side] * LDC_W({{ c.a_y_scale }});
            for (k = 0; k < LDC_M; k++) {
                s->C[at][k] = LDC_W({{ c.a_y_scale }}) * s->of_a[1 - side][j][k];
            }
            at++;
        }
    }
{% endif %}
{% if "jerk" in mpc.kinds %}
    for (side = {{ 2 - mpc.sides }}; side < 2; side++) {
        for (j = 0; j < LDC_N; j++) {
            const ldc_work share = LDC_W({{ c.window_share }}); /* by how much the window is rounded up */
            const int32_t now = LDC_WINDOW + LDC_DELAY + j + side;
            const int32_t past = (j + side) - LDC_WINDOW;
            const int32_t late = past - ((share > LDC_W(0.0)) ? 0 : side); /* sample of the plan a window before */
            ldc_work before = s->a[1 - side][now - LDC_WINDOW];
            if (share > LDC_W(0.0)) {
                before = ((LDC_W(1.0) - share) * s->a[1][now - LDC_WINDOW]) + (share * s->a[0][now - LDC_WINDOW + 1]);
            }
            s->y[at] = (s->a[1 - side][now] - before) * LDC_W({{ c.jerk_scale }});
            for (k = 0; k < LDC_M; k++) {
                ldc_work change = s->of_a[1 - side][j][k];
                if ((late >= 0) && (share > LDC_W(0.0))) {
                    change -= ((LDC_W(1.0) - share) * s->of_a[1][late][k]) + (share * s->of_a[0][late][k]);
                } else if (late >= 0) {
                    change -= s->of_a[1 - side][late][k];
                } else {
                    /* a window before, the plan had not begun */
                }
                s->C[at][k] = LDC_W({{ c.jerk_scale }}) * change;
            }
            at++;
        }
    }
{% endif %}
{% if "e_y" in mpc.kinds %}
    for (j = 0; j < LDC_N; j++) {
        for (k = 0; k < LDC_M; k++) {
            s->C[at + j][k] = LDC_W({{ c.e_y_scale }}) * s->of_a[2][j][k];
        }
    }
{% endif %}
{% else %}
    (void)x;
    (void)r;
{% endif %}
    return (gap > ROUNDING) ? 0 : 1;
}

{% if mpc.kinds %}
static const ldc_work root[LDC_KINDS] = { {{ mpc.root }} }; /* of the weights of soft limits */

/* Kind of the soft limit of a row; -1 for a hard one. */
static int32_t kind_of(int32_t row)
{
    int32_t kind = -1;
    int32_t k;
    static const int32_t first[LDC_KINDS] = { {{ mpc.first }} };
    for (k = 0; k < LDC_KINDS; k++) {
        if (row >= first[k]) {
            kind = k;
        }
    }
    return kind;
}

{% endif %}
/* The normal of row (at its upper bound), of -1 - row (at its lower one), or of a slack at 0 behind the rows. */
static void normal(const ldc_state *s, int32_t row, ldc_work of[LDC_VARIABLES])
{
    const int32_t place = (row < 0) ? (-1 - row) : row;
    int32_t k;
    for (k = 0; k < LDC_VARIABLES; k++) {
        of[k] = LDC_W(0.0);
    }
    if (place < LDC_ROWS) {
        for (k = 0; k < LDC_M; k++) {
            of[k] = (row < 0) ? -s->C[place][k] : s->C[place][k];
        }
{% if mpc.kinds %}
        k = kind_of(place);
        if (k >= 0) {
            of[LDC_M + k] = LDC_W(-1.0) / root[k];
        }
    } else {
        of[LDC_M + (place - LDC_ROWS)] = LDC_W(-1.0);
{% endif %}
    }
}

/* The bound that variables w violate most, as `normal` takes it, and by how much. */
static ldc_work most_violated(const ldc_state *s, const ldc_work w[LDC_VARIABLES], int32_t *which)
{
    ldc_work worst = LDC_W(0.0);
    int32_t j;
    for (j = 0; j < LDC_ROWS; j++) {
        const ldc_work value = s->y[j] + dot(s->C[j], w, LDC_M);
        ldc_work slack = LDC_W(0.0);
{% if mpc.kinds %}
        const int32_t kind = kind_of(j);
        if (kind >= 0) {
            slack = w[LDC_M + kind] / root[kind];
        }
{% endif %}
        if ((value - s->high[j] - slack) > worst) {
            worst = value - s->high[j] - slack;
            *which = j;
        }
        if ((s->low[j] - slack - value) > worst) {
            worst = s->low[j] - slack - value;
            *which = -1 - j;
        }
    }
    for (j = LDC_M; j < LDC_VARIABLES; j++) {
        if (-w[j] > worst) {
            worst = -w[j];
            *which = LDC_ROWS + (j - LDC_M);
        }
    }
    return worst;
}

/* Multipliers of the n held normals whose sum is nearest to `to`, by Cholesky's factors; 0 if they depend on others. */
static int32_t nearest(ldc_state *s, int32_t n, const ldc_work to[LDC_VARIABLES], ldc_work part[LDC_VARIABLES])
{
    int32_t good = 1;
    int32_t i;
    int32_t j;
    for (i = 0; i < n; i++) {
        ldc_work rest = dot(s->held[i], to, LDC_VARIABLES);
        for (j = 0; j <= i; j++) {
            const ldc_work both = dot(s->held[i], s->held[j], LDC_VARIABLES);
            const ldc_work inner = both - dot(s->factor[i], s->factor[j], j);
            if (j < i) {
                s->factor[i][j] = inner / s->factor[j][j];
            } else if (inner > (DEPENDENT * both)) {
                s->factor[i][i] = ROOT(inner);
            } else {
                s->factor[i][i] = LDC_W(1.0);
                good = 0;
            }
        }
        rest -= dot(s->factor[i], part, i);
        part[i] = rest / s->factor[i][i];
    }
    for (i = n - 1; i >= 0; i--) {
        for (j = i + 1; j < n; j++) {
            part[i] -= s->factor[j][i] * part[j];
        }
        part[i] /= s->factor[i][i];
    }
    return good;
}

/*
 * The smallest corrections that keep the limits, by the dual active set method of Goldfarb and Idnani (1983): hold the
 * bound that is violated most, let go of bounds whose multiplier would change its sign. 0 if it takes too long.
 */
static int32_t solve(ldc_state *s, ldc_work w[LDC_VARIABLES])
{
    ldc_work part[LDC_VARIABLES];
    ldc_work to[LDC_VARIABLES];
    ldc_work multiplier = LDC_W(0.0); /* of the bound that is being added */
    int32_t which = 0;
    int32_t adding = 0;
    int32_t state = -1; /* 1 solved, 0 failed */
    int32_t n = 0; /* bounds held */
    int32_t i;
    int32_t j;
    for (i = 0; i < LDC_VARIABLES; i++) {
        w[i] = LDC_W(0.0);
    }
{% if mpc.kinds %}
    for (n = 0; n < LDC_KINDS; n++) {
        s->row[n] = LDC_ROWS + n; /* every slack at 0 */
        s->right[n] = root[n];
        normal(s, s->row[n], s->held[n]);
    }
{% endif %}
    for (s->iterations = 0; (s->iterations < LDC_ITERATIONS) && (state < 0); s->iterations++) {
        ldc_work excess;
        ldc_work full;
        ldc_work shortest = LDC_W(-1.0); /* step at which the multiplier of a held bound is 0 */
        int32_t first = -1;
        if (adding == 0) {
            ldc_work accepted = ACCEPTED;
            for (i = 0; i < n; i++) {
                accepted = clip(PER_MULTIPLIER * s->right[i], accepted, LARGEST);
            }
            if (most_violated(s, w, &which) <= accepted) {
                state = 1;
            }
            normal(s, which, to);
            multiplier = LDC_W(0.0);
            adding = 1;
        }
        if (state < 0) {
            const int32_t place = (which < 0) ? (-1 - which) : which;
            ldc_work along;
            excess = dot(to, w, LDC_VARIABLES);
            if (place < LDC_ROWS) {
                excess += (which < 0) ? (s->low[place] - s->y[place]) : (s->y[place] - s->high[place]);
            }
            if (nearest(s, n, to, part) == 0) {
                state = 0;
            }
            along = dot(to, to, LDC_VARIABLES);
            full = along;
            for (i = 0; i < n; i++) {
                full -= part[i] * dot(s->held[i], to, LDC_VARIABLES);
                if (part[i] > ROUNDING) {
                    const ldc_work step = s->right[i] / part[i];
                    if ((first < 0) || (step < shortest)) {
                        shortest = step;
                        first = i;
                    }
                }
            }
            full = ((full > (DEPENDENT * along)) && (n < LDC_VARIABLES)) ? (excess / full) : LDC_W(-1.0);
            if ((full < LDC_W(0.0)) && (first < 0)) {
                state = 0; /* no such plan */
            }
            if (state < 0) {
                const int32_t whole = ((first < 0) || ((full >= LDC_W(0.0)) && (full <= shortest))) ? 1 : 0;
                const ldc_work step = (whole != 0) ? full : shortest;
                multiplier += step;
                if (full >= LDC_W(0.0)) {
                    for (j = 0; j < LDC_VARIABLES; j++) {
                        w[j] -= step * to[j];
                    }
                }
                for (i = 0; i < n; i++) {
                    s->right[i] -= step * part[i];
                    for (j = 0; (j < LDC_VARIABLES) && (full >= LDC_W(0.0)); j++) {
                        w[j] += step * part[i] * s->held[i][j];
                    }
                }
                if (whole != 0) {
                    s->row[n] = which;
                    s->right[n] = multiplier;
                    for (j = 0; j < LDC_VARIABLES; j++) {
                        s->held[n][j] = to[j];
                    }
                    n++;
                    adding = 0;
                } else {
                    n--;
                    for (i = first; i < n; i++) {
                        s->row[i] = s->row[i + 1];
                        s->right[i] = s->right[i + 1];
                        normal(s, s->row[i], s->held[i]);
                    }
                }
            }
        }
    }
    return (state > 0) ? 1 : 0;
}

static ldc_work law(ldc_state *s, const ldc_work x[4], const ldc_work r_seen[], const ldc_work h[], uint32_t *status)
{
    const ldc_work step = LDC_W({{ c.rate_step }});
    ldc_work r[LDC_DELAY + LDC_N + 1]; /* yaw rate of the lane from the moment of the state on */
    ldc_work now[LDC_STATES] = {x[0], x[1], x[2], x[3]};
    ldc_work w[LDC_VARIABLES];
    ldc_work delta;
    int32_t j;
{% if mpc.lagging %}
    const ldc_work angle = s->angle;
{% endif %}
{% if mpc.window %}
    ldc_work a_free; /* acceleration now without a command */
{% endif %}
    (void)h;
    for (j = 0; j < (LDC_DELAY + LDC_N + 1); j++) {
{% if mpc.age %}
        const ldc_work behind = (ldc_work)j - LDC_W({{ mpc.age }}); /* a straight line before now */
        r[j] = r_seen[j + 2] + (((behind < LDC_W(0.0)) ? behind : LDC_W(0.0)) * (r_seen[1] - r_seen[0]));
{% else %}
        r[j] = r_seen[j];
{% endif %}
    }
    for (j = 4; j < LDC_STATES; j++) {
        now[j] = s->sent[LDC_DELAY];
    }
{% if mpc.lagging %}
    now[4] = angle;
{% endif %}
{% if mpc.window %}
    a_free = dot(&s->gain[AT_A_Y], now, LDC_STATES) + (s->gain[AT_A_Y + LDC_STATES + 1] * r[0]);
    s->a[0][LDC_WINDOW] = a_free + (s->gain[AT_A_Y + LDC_STATES] * s->sent[LDC_DELAY]);
    if (s->steps == 0) {
        for (j = 0; j < LDC_WINDOW; j++) {
            s->past[0][j] = s->a[0][LDC_WINDOW];
            s->past[1][j] = s->a[0][LDC_WINDOW];
        }
    }
    for (j = 0; j < LDC_WINDOW; j++) {
        s->a[0][j] = s->past[0][j];
        s->a[1][j] = s->past[1][j];
    }
{% endif %}
{% if mpc.delay %}
    for (j = 0; j < LDC_DELAY; j++) {
        go_on(s, now, s->sent[LDC_DELAY - 1 - j], &r[j], LDC_WINDOW + j);
    }
{% endif %}
    plan(s, now, &r[LDC_DELAY]);
    moves(s);
    s->iterations = 0;
    if (limits(s, now, &r[LDC_DELAY]) == 0) {
        delta = (s->sent[0] > LDC_W(0.0)) ? (s->sent[0] - step) : (s->sent[0] + step);
        *status |= LDC_BEYOND;
    } else if (solve(s, w) != 0) {
        delta = clip(s->y[0] + dot(s->C[0], w, LDC_M), s->low[0], s->high[0]);
    } else {
        delta = clip(s->y[0], LDC_W(-{{ c.delta_max }}), LDC_W({{ c.delta_max }}));
        delta = s->sent[0] + clip(delta - s->sent[0], -step, step);
        *status |= LDC_SOLVER_FAILED;
    }
{% if mpc.lagging %}
    s->angle = (s->gain[AT_A + (LDC_STATES * 4) + 4] * angle) + (s->gain[AT_B + 4] * {{ "s->sent[LDC_DELAY - 1]" if mpc.delay else "delta" }});
{% if mpc.m > 5 %}
    s->angle += s->gain[AT_A + (LDC_STATES * 4) + 5] * s->sent[LDC_DELAY];
{% endif %}
{% endif %}
{% if mpc.window %}
    for (j = 0; j < (LDC_WINDOW - 1); j++) {
        s->past[0][j] = s->a[0][j + 1];
        s->past[1][j] = s->a[1][j + 1];
    }
    s->past[0][LDC_WINDOW - 1] = s->a[0][LDC_WINDOW];
    s->past[1][LDC_WINDOW - 1] = a_free
        + (s->gain[AT_A_Y + LDC_STATES] * {{ "s->sent[LDC_DELAY - 1]" if mpc.delay else "delta" }});
{% endif %}
    return delta;
}
