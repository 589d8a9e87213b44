"""Small FMUs of FMI 2.0 and 3.0 for co-simulation, compiled from a body in C."""

import subprocess
import zipfile
from pathlib import Path

import fmpy
import fmpy.fmi2
import fmpy.fmi3

_COMMON = """
#include <math.h>
#include <stdlib.h>
#include <string.h>
typedef struct { double v[32]; } instance;
typedef void (*logger)(void);
static const double start[32] = {START};
static int behave(double *v, double t, double h) { (void)t, (void)h; BODY }
static int access(instance *c, const unsigned r[], size_t n, double out[], const double in[])
{
    for (size_t i = 0; i < n; i++) { if (out) { out[i] = c->v[r[i]]; } else { c->v[r[i]] = in[i]; } }
    return 0;
}
static void *fresh(void) { instance *c = calloc(1, sizeof *c); memcpy(c->v, start, sizeof start); return c; }
static int again(instance *c) { RESET; memcpy(c->v, start, sizeof start); return 0; }
"""
_TWO = """
void *fmi2Instantiate(const char *a, int b, const char *c, const char *d, const void *e, int f, int g)
{ (void)a, (void)b, (void)c, (void)d, (void)e, (void)f, (void)g; return INSTANCE; }
void fmi2FreeInstance(void *c) { free(c); }
int fmi2SetupExperiment(void *c, int a, double b, double t, int d, double e)
{ (void)c, (void)a, (void)b, (void)t, (void)d, (void)e; return 0; }
int fmi2EnterInitializationMode(void *c) { (void)c; return 0; }
int fmi2ExitInitializationMode(void *c) { (void)c; return 0; }
int fmi2Reset(void *c) { return again(c); }
int fmi2SetReal(void *c, const unsigned r[], size_t n, const double x[]) { return access(c, r, n, 0, x); }
int fmi2GetReal(void *c, const unsigned r[], size_t n, double x[]) { return access(c, r, n, x, 0); }
int fmi2SetInteger(void *c, const unsigned r[], size_t n, const int x[])
{ for (size_t i = 0; i < n; i++) { ((instance *)c)->v[r[i]] = x[i]; } return 0; }
int fmi2GetInteger(void *c, const unsigned r[], size_t n, int x[])
{ for (size_t i = 0; i < n; i++) { x[i] = (int)((instance *)c)->v[r[i]]; } return 0; }
int fmi2SetBoolean(void *c, const unsigned r[], size_t n, const int x[]) { return fmi2SetInteger(c, r, n, x); }
int fmi2DoStep(void *c, double t, double h, int a) { (void)a; return behave(((instance *)c)->v, t, h); }
"""
_THREE = """
#include <stdbool.h>
#include <stdint.h>
void *fmi3InstantiateCoSimulation(const char *a, const char *b, const char *c, bool d, bool e, bool f, bool g,
    const unsigned h[], size_t i, void *j, void *k, void *l)
{ (void)a, (void)b, (void)c, (void)d, (void)e, (void)f, (void)g, (void)h, (void)i, (void)j, (void)k, (void)l;
  return INSTANCE; }
void fmi3FreeInstance(void *c) { free(c); }
int fmi3EnterInitializationMode(void *c, bool a, double b, double t, bool d, double e)
{ (void)c, (void)a, (void)b, (void)t, (void)d, (void)e; return 0; }
int fmi3ExitInitializationMode(void *c) { (void)c; return 0; }
int fmi3Reset(void *c) { return again(c); }
int fmi3SetFloat64(void *c, const unsigned r[], size_t n, const double x[], size_t m)
{ (void)m; return access(c, r, n, 0, x); }
int fmi3GetFloat64(void *c, const unsigned r[], size_t n, double x[], size_t m)
{ (void)m; return access(c, r, n, x, 0); }
int fmi3SetInt32(void *c, const unsigned r[], size_t n, const int32_t x[], size_t m)
{ (void)m; for (size_t i = 0; i < n; i++) { ((instance *)c)->v[r[i]] = x[i]; } return 0; }
int fmi3GetInt32(void *c, const unsigned r[], size_t n, int32_t x[], size_t m)
{ (void)m; for (size_t i = 0; i < n; i++) { x[i] = (int32_t)((instance *)c)->v[r[i]]; } return 0; }
int fmi3SetBoolean(void *c, const unsigned r[], size_t n, const bool x[], size_t m)
{ (void)m; for (size_t i = 0; i < n; i++) { ((instance *)c)->v[r[i]] = x[i]; } return 0; }
int fmi3DoStep(void *c, double t, double h, bool a, bool *b, bool *d, bool *e, double *f)
{ (void)a; *b = *e = false; *f = t + h; int s = behave(((instance *)c)->v, t, h); *d = s == 9; return s == 9 ? 0 : s; }
"""

Variable = tuple[str, str, str, str]  # name, causality, type of FMI 2.0, further attributes


def build(
    path: Path,
    variables: list[Variable],
    body: str,
    *,
    version: str = "2.0",
    kind: str = "CoSimulation",
    flags: str = "",
    reset: str = "(void)0",
    instance: str = "fresh()",
    platform: str = "linux64",
) -> Path:
    """An FMU whose i-th variable is v[i] in `body`, which returns its status; 9 asks to end the simulation."""
    three = version.startswith("3")
    starts = {i: rest.split('start="')[1].split('"')[0] for i, (*_, rest) in enumerate(variables) if "start=" in rest}
    values = ", ".join(f"[{i}] = {'10'[x == 'false'] if x in ('true', 'false') else x}" for i, x in starts.items())
    text = _COMMON + (_THREE if three else _TWO)
    for key, value in {"{START}": f"{{{values or '0'}}}", "BODY": body, "RESET": reset, "INSTANCE": instance}.items():
        text = text.replace(key, value)
    kind_of_fmpy = fmpy.fmi3.FMU3Slave if three else fmpy.fmi2.FMU2Slave
    names = [name for name in dir(kind_of_fmpy) if name.startswith("fmi3" if three else "fmi2")]
    text += "".join(f"int {name}(void) {{ return 3; }}\n" for name in names if f"{name}(" not in text)
    path.parent.mkdir(parents=True, exist_ok=True)
    source, library = path.with_suffix(".c"), path.with_suffix(".so")
    source.write_text(text)
    subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-o", library, source, "-lm"], check=True)
    types = {"Real": "Float64", "Integer": "Int32"}
    rows = []
    for i, (name, causality, type_, rest) in enumerate(variables):
        variability = ' variability="fixed"' if causality == "parameter" else ""
        head = f'name="{name}" valueReference="{i}" causality="{causality}"{variability}'
        variability = variability or ("" if type_ == "Real" else ' variability="discrete"')
        head = f'name="{name}" valueReference="{i}" causality="{causality}"{variability}'
        if three:
            rows.append(f"<{types.get(type_, type_)} {head} {rest}/>")
        else:
            rows.append(f"<ScalarVariable {head}><{type_} {rest}/></ScalarVariable>")
    token = "instantiationToken" if three else "guid"
    xml = f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="{version}" modelName="m" {token}="{{1}}">
<{kind} modelIdentifier="m" canHandleVariableCommunicationStepSize="true" {flags}/>
<ModelVariables>{"".join(rows)}</ModelVariables><ModelStructure/></fmiModelDescription>"""
    folder = {"linux64": "x86_64-linux"}[platform] if three and platform == "linux64" else platform
    with zipfile.ZipFile(path, "w") as packed:
        packed.writestr("modelDescription.xml", xml)
        packed.write(library, f"binaries/{folder}/m{'.dll' if platform.startswith('win') else '.so'}")
    return path
