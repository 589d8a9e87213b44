/* The controller as a co-simulation slave of FMI 2.0: one ldc_step for each sample time. */
#include "ldc_controller.h"

#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#define EXPORT(type) __declspec(dllexport) type
#else
#define EXPORT(type) __attribute__((visibility("default"))) type
#endif

/* what is needed of fmi2TypesPlatform.h and fmi2FunctionTypes.h: c is an instance, r are value references */
enum { OK = 0, ERROR = 3, CO_SIMULATION = 1 };
typedef struct {
    void (*log)(void *environment, const char *name, int status, const char *category, const char *message, ...);
    void *(*allocate)(size_t n, size_t size);
    void (*release)(void *memory);
    void (*finished)(void *environment, int status);
    void *environment;
} callbacks;
typedef struct {
    ldc_inputs in;
    ldc_state state;
    ldc_outputs out;
    callbacks host;
    char name[128];
} instance;

/* Tell the host the reason of an error. */
static int error(const callbacks *host, const char *name, const char *reason)
{
    if ((host != NULL) && (host->log != NULL)) { host->log(host->environment, name, ERROR, "logStatusError", reason); }
    return ERROR; /* no reason has a per cent sign: it is its own format, also for hosts that take no further arguments */
}

/* As modelDescription.xml says that an instance begins. */
static void restart(instance *c)
{
    ldc_init(&c->state);
    (void)memset(&c->in, 0, sizeof(c->in));
    (void)memset(&c->out, 0, sizeof(c->out));
    c->in.v = (ldc_real)20.0;
}

static int no_variable(const instance *c, const char *function, unsigned r)
{
    char reason[96];
    (void)snprintf(reason, sizeof(reason), "%s: value reference %u: no such variable", function, r);
    return error(&c->host, c->name, reason);
}

static const size_t real_inputs[] = {
{% for name, size, kind in fields if kind == "ldc_real" %}
    {% for i in range([size, 1]|max) %}offsetof(ldc_inputs, {{ name }}){{ " + %d * sizeof(ldc_real)" % i if size }}, {% endfor %}

{% endfor %}
};
static const size_t whole_inputs[] = { {% for name, size, kind in fields if kind == "int32_t" %}offsetof(ldc_inputs, {{ name }}), {% endfor %} };
static const size_t whole_outputs[] = {offsetof(ldc_outputs, phase), offsetof(ldc_outputs, side),
    offsetof(ldc_outputs, status), offsetof(ldc_outputs, iterations){{ ", offsetof(ldc_outputs, assist_state)" if driver }}};

#define COUNT(list) (sizeof(list) / sizeof((list)[0]))

EXPORT(const char *) fmi2GetTypesPlatform(void) { return "default"; }
EXPORT(const char *) fmi2GetVersion(void) { return "2.0"; }

EXPORT(void *) fmi2Instantiate(const char *name, int type, const char *guid, const char *resources, const callbacks *host,
    int visible, int logging)
{
    const char *own = (name != NULL) ? name : "";
    instance *c = NULL;
    (void)resources, (void)visible, (void)logging; /* errors are told in any case */
    if (type != CO_SIMULATION) {
        (void)error(host, own, "fmi2Instantiate: this FMU is for co-simulation only");
    } else if ((guid == NULL) || (strcmp(guid, "{{ guid }}") != 0)) {
        (void)error(host, own, "fmi2Instantiate: the GUID is not {{ guid }}: modelDescription.xml of another export");
    } else {
        c = calloc(1u, sizeof(instance));
        if (c == NULL) {
            (void)error(host, own, "fmi2Instantiate: no memory");
        } else {
            restart(c);
            (void)snprintf(c->name, sizeof(c->name), "%s", own);
            if (host != NULL) { c->host = *host; }
        }
    }
    return c;
}

EXPORT(void) fmi2FreeInstance(void *c) { free(c); }

EXPORT(int) fmi2Reset(void *c)
{
    restart((instance *)c);
    return OK;
}

EXPORT(int) fmi2SetReal(void *c, const unsigned r[], size_t n, const double value[])
{
    for (size_t i = 0; i < n; i++) {
        if (r[i] >= COUNT(real_inputs)) { return no_variable((instance *)c, "fmi2SetReal", r[i]); }
        *(ldc_real *)(void *)((char *)&((instance *)c)->in + real_inputs[r[i]]) = (ldc_real)value[i];
    }
    return OK;
}

EXPORT(int) fmi2GetReal(void *c, const unsigned r[], size_t n, double value[])
{
    instance *one = (instance *)c;
    for (size_t i = 0; i < n; i++) {
        if (r[i] > {{ "(COUNT(real_inputs) + 1u)" if driver else "COUNT(real_inputs)" }}) { return no_variable(one, "fmi2GetReal", r[i]); }
        value[i] = (r[i] == COUNT(real_inputs)) ? (double)one->out.delta
            : {{ "(r[i] > COUNT(real_inputs)) ? (double)one->out.authority : " if driver }}(double)*(ldc_real *)(void *)((char *)&one->in + real_inputs[r[i]]);
    }
    return OK;
}

EXPORT(int) fmi2SetInteger(void *c, const unsigned r[], size_t n, const int value[])
{
    for (size_t i = 0; i < n; i++) {
        if (r[i] >= COUNT(whole_inputs)) { return no_variable((instance *)c, "fmi2SetInteger", r[i]); }
        *(int32_t *)(void *)((char *)&((instance *)c)->in + whole_inputs[r[i]]) = value[i];
    }
    return OK;
}

EXPORT(int) fmi2GetInteger(void *c, const unsigned r[], size_t n, int value[])
{
    instance *one = (instance *)c;
    for (size_t i = 0; i < n; i++) {
        if (r[i] >= (COUNT(whole_inputs) + COUNT(whole_outputs))) { return no_variable(one, "fmi2GetInteger", r[i]); }
        value[i] = (r[i] < COUNT(whole_inputs)) ? *(int32_t *)(void *)((char *)&one->in + whole_inputs[r[i]])
            : *(int32_t *)(void *)((char *)&one->out + whole_outputs[r[i] - COUNT(whole_inputs)]);
    }
    return OK;
}

EXPORT(int) fmi2DoStep(void *c, double now, double step, int no_set)
{
    instance *one = (instance *)c;
    (void)now, (void)no_set;
    if (!(((step / {{ dt }}) > 0.999) && ((step / {{ dt }}) < 1.001))) {
        char reason[96];
        (void)snprintf(reason, sizeof(reason), "fmi2DoStep: a step of %g s; allowed: the sample time, {{ dt }} s", step);
        return error(&one->host, one->name, reason);
    }
    (void)ldc_step(&one->in, &one->state, &one->out);
    return OK;
}

/* nothing to do */
EXPORT(int) fmi2SetDebugLogging(void *c, int on, size_t n, const char *const names[]) { (void)c, (void)on, (void)n, (void)names; return OK; }
EXPORT(int) fmi2SetupExperiment(void *c, int a, double b, double t, int d, double e) { (void)c, (void)a, (void)b, (void)t, (void)d, (void)e; return OK; }
{% for name in ["EnterInitializationMode", "ExitInitializationMode", "Terminate"] %}
EXPORT(int) fmi2{{ name }}(void *c) { (void)c; return OK; }
{% endfor %}
/* not there: the caller gets an error and its reason, whatever the arguments */
{% for name in ["CancelStep", "GetBoolean", "SetBoolean", "GetString", "SetString", "GetFMUstate", "SetFMUstate", "FreeFMUstate",
    "SerializedFMUstateSize", "SerializeFMUstate", "DeSerializeFMUstate", "GetDirectionalDerivative", "SetRealInputDerivatives",
    "GetRealOutputDerivatives", "GetStatus", "GetRealStatus", "GetIntegerStatus", "GetBooleanStatus", "GetStringStatus"] %}
EXPORT(int) fmi2{{ name }}(const instance *c) { return error(&c->host, c->name, "fmi2{{ name }}: not supported"); }
{% endfor %}
