/* Repeats the check without Python: cc -std=c99 main.c ldc_controller.c -lm && ./a.out < test_vectors.csv */
#include "ldc_controller.h"

#include <stdio.h>
#include <stdlib.h>

/* The next field of the line; test_vectors.csv has one column for each number of ldc_inputs, then what is expected. */
static double field(int *last)
{
    char text[64];
    size_t n = 0;
    int c = getchar();
    while ((c != ',') && (c != '\n') && (c != EOF) && (n + 1u < sizeof text)) {
        text[n] = (char)c;
        n++;
        c = getchar();
    }
    text[n] = '\0';
    *last = (c == EOF) ? 1 : 0;
    return strtod(text, NULL);
}

int main(void)
{
    static ldc_state state;
    ldc_inputs in;
    ldc_outputs out;
    double worst = 0.0;
    long rows = 0;
    long wrong = 0;
    int last = 0;
    int i;
    int c = getchar();
    while ((c != '\n') && (c != EOF)) {
        c = getchar(); /* names of the columns */
    }
    for (;;) {
        double expected;
        const double begins = field(&last); /* 1 in the first row of a departure */
        if (last != 0) {
            break;
        }
        if (begins > 0.0) {
            ldc_init(&state);
        }
{% for name, size, kind in fields %}
{% if size > 1 %}
        for (i = 0; i < {{ size }}; i++) {
            in.{{ name }}[i] = ({{ kind }})field(&last);
        }
{% else %}
        in.{{ name }} = ({{ kind }})field(&last);
{% endif %}
{% endfor %}
        (void)ldc_step(&in, &state, &out);
        expected = field(&last);
        if (expected - (double)out.delta > worst) {
            worst = expected - (double)out.delta;
        } else if ((double)out.delta - expected > worst) {
            worst = (double)out.delta - expected;
        }
        wrong += (out.phase != (int32_t)field(&last)) ? 1 : 0;
        rows++;
    }
    (void)i;
    printf("%ld steps, largest difference %.2g rad, %ld phases differ\n", rows, worst, wrong);
    return ((rows > 0) && (worst <= (sizeof(ldc_real) < 8u ? {{ float_bound }} : {{ bound }})) && (wrong == 0)) ? 0 : 1;
}
