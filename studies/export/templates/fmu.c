/* The controller as a co-simulation slave of FMI 2.0: one ldc_step for each sample time. */
#include "ldc_controller.h"

#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#define EXPORT(type) __declspec(dllexport) type
#else
#define EXPORT(type) __attribute__((visibility("default"))) type
#endif

/* what is needed of fmi2TypesPlatform.h, default platform: c is an instance, r are value references */
typedef struct {
    ldc_inputs in;
    ldc_state state;
    ldc_outputs out;
} instance;
enum { OK = 0, ERROR = 3, CO_SIMULATION = 1 };

static const size_t real_inputs[] = {
{% for name, size, kind in fields if kind == "ldc_real" %}
    {% for i in range([size, 1]|max) %}offsetof(ldc_inputs, {{ name }}){{ " + %d * sizeof(ldc_real)" % i if size }}, {% endfor %}

{% endfor %}
};
static const size_t whole_inputs[] = { {% for name, size, kind in fields if kind == "int32_t" %}offsetof(ldc_inputs, {{ name }}), {% endfor %} };
static const size_t whole_outputs[] = {offsetof(ldc_outputs, phase), offsetof(ldc_outputs, side),
    offsetof(ldc_outputs, status), offsetof(ldc_outputs, iterations)};

#define COUNT(list) (sizeof(list) / sizeof((list)[0]))

EXPORT(const char *) fmi2GetTypesPlatform(void) { return "default"; }
EXPORT(const char *) fmi2GetVersion(void) { return "2.0"; }

EXPORT(void *) fmi2Instantiate(const char *name, int type, const char *guid, const char *resources, const void *callbacks,
    int visible, int logging)
{
    const int fits = (type == CO_SIMULATION) && (guid != NULL) && (strcmp(guid, "{{ guid }}") == 0);
    (void)name, (void)resources, (void)callbacks, (void)visible, (void)logging;
    return fits ? calloc(1u, sizeof(instance)) : NULL; /* zeros are what ldc_init leaves */
}

EXPORT(void) fmi2FreeInstance(void *c) { free(c); }

EXPORT(int) fmi2Reset(void *c)
{
    (void)memset(c, 0, sizeof(instance));
    return OK;
}

EXPORT(int) fmi2SetReal(void *c, const unsigned r[], size_t n, const double value[])
{
    for (size_t i = 0; i < n; i++) {
        if (r[i] >= COUNT(real_inputs)) { return ERROR; }
        *(ldc_real *)(void *)((char *)&((instance *)c)->in + real_inputs[r[i]]) = (ldc_real)value[i];
    }
    return OK;
}

EXPORT(int) fmi2GetReal(void *c, const unsigned r[], size_t n, double value[])
{
    instance *one = (instance *)c;
    for (size_t i = 0; i < n; i++) {
        if (r[i] > COUNT(real_inputs)) { return ERROR; }
        value[i] = (r[i] == COUNT(real_inputs)) ? (double)one->out.delta
            : (double)*(ldc_real *)(void *)((char *)&one->in + real_inputs[r[i]]);
    }
    return OK;
}

EXPORT(int) fmi2SetInteger(void *c, const unsigned r[], size_t n, const int value[])
{
    for (size_t i = 0; i < n; i++) {
        if (r[i] >= COUNT(whole_inputs)) { return ERROR; }
        *(int32_t *)(void *)((char *)&((instance *)c)->in + whole_inputs[r[i]]) = value[i];
    }
    return OK;
}

EXPORT(int) fmi2GetInteger(void *c, const unsigned r[], size_t n, int value[])
{
    instance *one = (instance *)c;
    for (size_t i = 0; i < n; i++) {
        if (r[i] >= (COUNT(whole_inputs) + COUNT(whole_outputs))) { return ERROR; }
        value[i] = (r[i] < COUNT(whole_inputs)) ? *(int32_t *)(void *)((char *)&one->in + whole_inputs[r[i]])
            : *(int32_t *)(void *)((char *)&one->out + whole_outputs[r[i] - COUNT(whole_inputs)]);
    }
    return OK;
}

EXPORT(int) fmi2DoStep(void *c, double now, double step, int no_set)
{
    instance *one = (instance *)c;
    (void)now, (void)no_set;
    if (!(((step / {{ dt }}) > 0.999) && ((step / {{ dt }}) < 1.001))) { return ERROR; } /* the sample time is fixed */
    (void)ldc_step(&one->in, &one->state, &one->out);
    return OK;
}

/* nothing to do */
EXPORT(int) fmi2SetDebugLogging(void *c, int on, size_t n, const char *const names[]) { (void)c, (void)on, (void)n, (void)names; return OK; }
EXPORT(int) fmi2SetupExperiment(void *c, int a, double b, double t, int d, double e) { (void)c, (void)a, (void)b, (void)t, (void)d, (void)e; return OK; }
{% for name in ["EnterInitializationMode", "ExitInitializationMode", "Terminate"] %}
EXPORT(int) fmi2{{ name }}(void *c) { (void)c; return OK; }
{% endfor %}
/* not there: the caller gets an error, whatever the arguments */
{% for name in ["CancelStep", "GetBoolean", "SetBoolean", "GetString", "SetString", "GetFMUstate", "SetFMUstate", "FreeFMUstate",
    "SerializedFMUstateSize", "SerializeFMUstate", "DeSerializeFMUstate", "GetDirectionalDerivative", "SetRealInputDerivatives",
    "GetRealOutputDerivatives", "GetStatus", "GetRealStatus", "GetIntegerStatus", "GetBooleanStatus", "GetStringStatus"] %}
EXPORT(int) fmi2{{ name }}(void *c) { (void)c; return ERROR; }
{% endfor %}
