"""FMUs of others for tests: linear systems in C under any names and units, and gains as their controllers."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal
from xml.sax.saxutils import quoteattr

import fmpy
import numpy as np

from fmu_export.native_build import build_library, host_platform

C = r"""
#include <stddef.h>
#include <string.h>
#if defined _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
/* reals: u from 0 on, y from 20, x0 from 40, a_min 60, b_max 61, law (integer) 62, mode (integer) 63 */
enum { N = %(n)d, M = %(m)d, P = %(p)d, PLACES = 64, START = %(place)d, SHOWN = %(shown)d };
static const double A[] = {%(A)s}, B[] = {%(B)s}, CC[] = {%(C)s}, D[] = {%(D)s};
typedef struct { double reals[PLACES], x[N + 1]; int integers[PLACES]; } unit;
static unit units[64];
static int used;

static void rates(const double *x, const double *u, double *dx)
{
    for (int i = 0; i < N; i++) {
        dx[i] = 0.0;
        for (int j = 0; j < N; j++) { dx[i] += A[i * N + j] * x[j]; }
        for (int j = 0; j < M; j++) { dx[i] += B[i * M + j] * u[j]; }
    }
}
static void put(unit *v)
{
    const double gain = v->integers[62] == 2 ? 1.0 / v->reals[60] : 1.0;
    for (int i = 0; i < P; i++) {
        double y = 0.0;
        for (int j = 0; j < N; j++) { y += CC[i * N + j] * v->x[j]; }
        for (int j = 0; j < M; j++) { y += gain * D[i * M + j] * v->reals[j]; }
        v->reals[20 + i] = y;
    }
    for (int i = 0; SHOWN && i < N; i++) { v->reals[START + i] = v->x[i]; }
    v->integers[63] = 2;
}
EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }
EXPORT void *fmi2Instantiate(const char *n, int t, const char *g, const char *r, void *c, int v, int l)
{
    unit *u = &units[used++ %% 64];
    const double start[] = {%(starts)s};
    (void)n; (void)t; (void)g; (void)r; (void)v; (void)l; (void)c;
    memset(u, 0, sizeof *u);
    memcpy(u->reals, start, sizeof start);
    u->integers[62] = %(law)d;
    return u;
}
EXPORT void fmi2FreeInstance(void *u) { (void)u; }
EXPORT int fmi2ExitInitializationMode(void *c)
{
    unit *v = c;
    for (int i = 0; i < N; i++) { v->x[i] = v->reals[START + i]; }
    put(v);
    return 0;
}
EXPORT int fmi2DoStep(void *c, double t, double h, int p)
{
    unit *v = c;
    double k[4][N + 1], x[N + 1];
    static const double at[] = {0.0, 0.5, 0.5, 1.0};
    (void)t; (void)p;
    for (int s = 0; s < 4; s++) {
        for (int i = 0; i < N; i++) { x[i] = v->x[i] + (s ? at[s] * h * k[s - 1][i] : 0.0); }
        rates(x, v->reals, k[s]);
    }
    for (int i = 0; i < N; i++) { v->x[i] += h / 6.0 * (k[0][i] + 2.0 * k[1][i] + 2.0 * k[2][i] + k[3][i]); }
    put(v);
    return 0;
}
EXPORT int fmi2SetReal(void *v, const unsigned *r, size_t n, const double *x)
{
    for (size_t i = 0; i < n; i++) { ((unit *)v)->reals[r[i]] = x[i]; }
    return 0;
}
EXPORT int fmi2GetReal(void *v, const unsigned *r, size_t n, double *x)
{
    for (size_t i = 0; i < n; i++) { x[i] = ((unit *)v)->reals[r[i]]; }
    return 0;
}
EXPORT int fmi2SetInteger(void *v, const unsigned *r, size_t n, const int *x)
{
    for (size_t i = 0; i < n; i++) { ((unit *)v)->integers[r[i]] = x[i]; }
    return 0;
}
EXPORT int fmi2GetInteger(void *v, const unsigned *r, size_t n, int *x)
{
    for (size_t i = 0; i < n; i++) { x[i] = ((unit *)v)->integers[r[i]]; }
    return 0;
}
#define GOOD(name) EXPORT int name(void *v); int name(void *v) { (void)v; return 0; }
"""
GOOD = """SetupExperiment EnterInitializationMode Terminate Reset SetDebugLogging GetBoolean SetBoolean GetString SetString
GetFMUstate SetFMUstate FreeFMUstate SerializedFMUstateSize SerializeFMUstate DeSerializeFMUstate CancelStep GetStatus
GetDirectionalDerivative SetRealInputDerivatives GetRealOutputDerivatives GetRealStatus GetIntegerStatus GetBooleanStatus
GetStringStatus"""

UNITS = {
    "m": 'm="1"',
    "m/s": 'm="1" s="-1"',
    "N": 'kg="1" m="1" s="-2"',
    "mm": 'm="1" factor="0.001"',
    "deg": 'rad="1" factor="0.017453292519943295"',
    "rad": 'rad="1"',
    "K": 'K="1"',
    "degC": 'K="1" offset="273.15"',
    "W": 'kg="1" m="2" s="-3"',
    "m3/s": 'm="3" s="-1"',
}
"""Units that FMUs define, by the attributes of their BaseUnit."""

Names = Sequence[tuple[str, str | None]]


def linear_fmu(
    path: Path,
    inputs: Names,
    outputs: Names,
    A: Any = (),
    B: Any = (),
    C_: Any = (),
    D: Any = (),
    x0: Sequence[float] = (),
    start: Mapping[str, float] | None = None,
    *,
    law: bool = False,
    starts: Sequence[str] = (),
    begins: Literal["parameter", "output", "local"] = "parameter",
) -> Path:
    """Write the FMU of x' = A x + B u, y = C x + D u; in- and outputs are (name, unit), `x0` becomes `starts` or x0[1], ...

    `begins`: those are parameters, locals with a start value, or it is the outputs, here y = x, that have one.
    With `law` it is a controller with an enumeration law, LC or IHC (its gain over a_min), a_min, b_max and a mode.
    """
    n, m, p = len(x0), len(inputs), len(outputs)
    sizes = {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m)}
    given = dict(zip("ABCD", (A, B, C_, D), strict=True))
    matrices = {k: np.zeros(s) if np.size(given[k]) == 0 else np.reshape(given[k], s) for k, s in sizes.items()}
    numbers = {k: ", ".join(map(repr, M.ravel().tolist())) or "0.0" for k, M in matrices.items()}
    reals = [0.0] * 64
    for i, (name, _) in enumerate(inputs):
        reals[i] = (start or {}).get(name, 0.0)
    place = 20 if begins == "output" else 40
    reals[place : place + n], reals[60:62] = list(map(float, x0)), [0.5, 1.0]
    source = C % {
        **numbers,
        "n": n,
        "m": m,
        "p": p,
        "starts": ", ".join(map(repr, reals)),
        "law": 1,
        "place": place,
        "shown": int(begins == "local"),
    }
    source += "\n".join(f"GOOD(fmi2{name})" for name in GOOD.split()) + "\n"
    rows = [_real(i, name, "input", unit, reals[i]) for i, (name, unit) in enumerate(inputs)]
    known = x0 if begins == "output" else [None] * p
    rows += [_real(20 + i, name, "output", unit, known[i]) for i, (name, unit) in enumerate(outputs)]
    named = [] if begins == "output" else starts or [f"x0[{i + 1}]" for i in range(n)]
    rows += [_real(40 + i, name, begins, None, x0[i]) for i, name in enumerate(named)]
    if law:
        rows += [_real(60, "a_min", "parameter", None, 0.5, 'min="0.01" '), _real(61, "b_max", "parameter", None, 1.0)]
        rows += [_enumeration(62, "law", "parameter", "Law", 'start="1" '), _enumeration(63, "mode", "output", "Mode")]
    described = _description(path.stem, rows, {unit for _, unit in (*inputs, *outputs) if unit is not None})
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", described)
        library = build_library({"linear.c": source.encode()}, "Linear", host_platform())
        archive.writestr(f"binaries/{fmpy.platform}/Linear{fmpy.sharedLibraryExtension}", library)
    return path


def _description(name: str, rows: Sequence[str], units: set[str]) -> str:
    unknowns = "".join(f'<Unknown index="{i}"/>' for i, row in enumerate(rows, 1) if 'causality="output"' in row)
    definitions = "".join(
        f"<Unit name={quoteattr(u)}><BaseUnit {UNITS[u]}/></Unit>" for u in sorted(units & UNITS.keys())
    )
    definitions += "".join(f"<Unit name={quoteattr(u)}/>" for u in sorted(units - UNITS.keys()))
    types = "".join(
        f'<SimpleType name="{kind}"><Enumeration>'
        + "".join(f'<Item name="{item}" value="{k}"/>' for k, item in enumerate(items, 1))
        + "</Enumeration></SimpleType>"
        for kind, items in (("Law", ("LC", "IHC")), ("Mode", ("idle", "stabilizing", "fault")))
    )
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="2.0" modelName={quoteattr(name)} '
        f'guid="{{{name}}}"><CoSimulation modelIdentifier="Linear" canHandleVariableCommunicationStepSize="true"/>'
        + (f"<UnitDefinitions>{definitions}</UnitDefinitions>" if units else "")
        + f"<TypeDefinitions>{types}</TypeDefinitions>"
        f'<DefaultExperiment stepSize="0.01" stopTime="2.0"/><ModelVariables>{"".join(rows)}</ModelVariables>'
        f"<ModelStructure><Outputs>{unknowns}</Outputs></ModelStructure></fmiModelDescription>"
    )


def _real(
    reference: int, name: str, causality: str, unit: str | None, start: float | None = None, more: str = ""
) -> str:
    about = (
        more + ("" if start is None else f'start="{start!r}" ') + ("" if unit is None else f"unit={quoteattr(unit)}")
    )
    variability = "fixed" if causality == "parameter" else "continuous"
    exact = "" if start is None or causality in ("parameter", "input") else 'initial="exact" '
    return _variable(reference, name, causality, variability, f"<Real {about}/>", exact)


def _enumeration(reference: int, name: str, causality: str, kind: str, more: str = "") -> str:
    variability = "fixed" if causality == "parameter" else "discrete"
    return _variable(reference, name, causality, variability, f'<Enumeration declaredType="{kind}" {more}/>')


def _variable(reference: int, name: str, causality: str, variability: str, declared: str, initial: str = "") -> str:
    return (
        f'<ScalarVariable name={quoteattr(name)} valueReference="{reference}" causality="{causality}" '
        f'{initial}variability="{variability}">{declared}</ScalarVariable>'
    )
