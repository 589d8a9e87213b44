/* Many instances in one call, for the check in the closed loop. */
#include "ldc_controller.h"

#include <time.h>

int32_t ldc_size(int32_t of_state);
void ldc_batch(int32_t n, const ldc_inputs *in, ldc_state *state, ldc_outputs *out, double *seconds);

int32_t ldc_size(int32_t of_state) { return (int32_t)((of_state != 0) ? sizeof(ldc_state) : sizeof(ldc_inputs)); }

void ldc_batch(int32_t n, const ldc_inputs *in, ldc_state *state, ldc_outputs *out, double *seconds)
{
    struct timespec a = {0, 0};
    struct timespec b = {0, 0};
    for (int32_t i = 0; i < n; i++) {
        if (seconds != NULL) { (void)clock_gettime(CLOCK_MONOTONIC, &a); }
        (void)ldc_step(&in[i], &state[i], &out[i]);
        if (seconds != NULL) {
            (void)clock_gettime(CLOCK_MONOTONIC, &b);
            seconds[i] = (double)(b.tv_sec - a.tv_sec) + (1.0e-9 * (double)(b.tv_nsec - a.tv_nsec));
        }
    }
}
