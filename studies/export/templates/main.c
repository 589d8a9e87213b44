/* Repeats the check without Python: cc -std=c99 main.c {{ sources }} -lm && ./a.out < test_vectors.csv */
#include "ldc_controller.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef LDC_USE_FLOAT
#define BOUND {{ float_bound }} /* [rad] */
#else
#define BOUND {{ bound }}
#endif
#define FIELDS {{ numbers + (5 if driver else 3) }} /* begins, those of ldc_inputs, delta, phase{{ ", assist_state, authority" if driver }} */

/* The numbers of a line, with commas between them; how many there are, 0 where there is anything else. */
static int read_row(const char *line, double row[FIELDS])
{
    const char *at = line;
    int n = 0;
    while ((n < FIELDS) && (strpbrk(line, "nNiI") == NULL)) { /* no nan, no inf */
        char *end;
        row[n] = strtod(at, &end);
        if (end == at) { return 0; }
        n++;
        if (*end != ',') { return (strspn(end, "\r\n") == strlen(end)) ? n : 0; }
        at = end + 1;
    }
    return 0;
}

int main(void)
{
    static ldc_state state;
    static char line[40 * FIELDS]; /* also long enough for the names of the columns */
    ldc_inputs in;
    ldc_outputs out;
    double row[FIELDS];
    double worst = 0.0;
    long rows = 0;
    long wrong = 0;
    long beyond = 0;
    long unread = (fgets(line, (int)sizeof(line), stdin) != NULL) ? 0 : 1;
    ldc_init(&state);
    while (fgets(line, (int)sizeof(line), stdin) != NULL) {
        const double *next = &row[1];
        if (read_row(line, row) != FIELDS) {
            unread++;
        } else {
            if (row[0] > 0.0) { ldc_init(&state); } /* 1 in the first row of a departure */
{% for name, size, kind in fields %}
{% if size %}
            for (int i = 0; i < {{ size }}; i++) { in.{{ name }}[i] = ({{ kind }})*next++; }
{% else %}
            in.{{ name }} = ({{ kind }})*next++;
{% endif %}
{% endfor %}
            (void)ldc_step(&in, &state, &out);
            const double difference = fabs(next[0] - (double)out.delta);
            beyond += (difference > BOUND) ? 1 : 0;
            worst = fmax(worst, difference);
            wrong += (out.phase != (int32_t)next[1]){{ " || (out.assist_state != (int32_t)next[2]) || !(fabs((double)out.authority - next[3]) < 1.0e-6)" if driver }} ? 1 : 0;
            rows++;
        }
    }
    printf("%ld steps, largest difference %.2g rad, %ld phases{{ ", states or authorities of the assist" if driver }} differ\n", rows, worst, wrong);
    if (unread > 0) { printf("%ld rows are not %d numbers\n", unread, FIELDS); }
    return ((rows > 0) && (unread == 0) && (beyond == 0) && (wrong == 0)) ? 0 : 1;
}
