/* Repeats the check without Python: cc -std=c99 main.c ldc_controller.c -lm && ./a.out < test_vectors.csv */
#include "ldc_controller.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#ifdef LDC_USE_FLOAT
#define BOUND {{ float_bound }} /* [rad] */
#else
#define BOUND {{ bound }}
#endif

/* The next number of the line; NaN at the end of the table. */
static double field(void)
{
    char text[64];
    size_t n = 0;
    int c = getchar();
    while ((c != ',') && (c != '\n') && (c != EOF) && ((n + 1u) < sizeof(text))) {
        text[n++] = (char)c;
        c = getchar();
    }
    text[n] = '\0';
    return (n > 0u) ? strtod(text, NULL) : (double)NAN;
}

int main(void)
{
    static ldc_state state;
    ldc_inputs in;
    ldc_outputs out;
    double worst = 0.0;
    double begins;
    long rows = 0;
    long wrong = 0;
    long beyond = 0;
    while (getchar() != '\n') { } /* names of the columns: begins, those of ldc_inputs, delta, phase */
    for (begins = field(); !isnan(begins); begins = field()) { /* 1 in the first row of a departure */
        if (begins > 0.0) { ldc_init(&state); }
{% for name, size, kind in fields %}
{% if size %}
        for (int i = 0; i < {{ size }}; i++) { in.{{ name }}[i] = ({{ kind }})field(); }
{% else %}
        in.{{ name }} = ({{ kind }})field();
{% endif %}
{% endfor %}
        (void)ldc_step(&in, &state, &out);
        const double difference = fabs(field() - (double)out.delta);
        beyond += (difference <= BOUND) ? 0 : 1; /* also where it is not a number */
        worst = fmax(worst, difference);
        wrong += (out.phase != (int32_t)field()) ? 1 : 0;
        rows++;
    }
    printf("%ld steps, largest difference %.2g rad, %ld phases differ\n", rows, worst, wrong);
    return ((rows > 0) && (beyond == 0) && (wrong == 0)) ? 0 : 1;
}
