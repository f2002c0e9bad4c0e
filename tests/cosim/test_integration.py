"""FMUs for model exchange, stepped: against closed forms, with events of all kinds, failures, and through the commands."""

import math
import re
import zipfile

import fmpy
import numpy as np
import pytest

from cosim.errors import UserError
from cosim.integration import MOST_STEPS, TOLERANCE
from cosim.master import simulate
from cosim.results import SimulationError
from cosim.scenario import load_scenario
from cosim.scenario_system import build_system
from cosim.ssp import write
from cosim.structure import Component, Signal, SystemStructure, Wire
from fmu_export.native_build import build_library, host_platform

INTEGRATORS, BALL, CLOCK, STIFF, DISCARDS, NOT_FINITE, SAWTOOTH, ENDS, ENDLESS, FAILS, OSCILLATOR, DRIFTS = range(12)

C = rb"""
#include <math.h>
#include <stddef.h>
#include <string.h>
#define EXPORT __attribute__((visibility("default")))
enum { MADE, INITIALIZING, EVENT, CONTINUOUS };
enum { INTEGRATORS, BALL, CLOCK, STIFF, DISCARDS, NOT_FINITE, SAWTOOTH, ENDS, ENDLESS, FAILS, OSCILLATOR, DRIFTS };
typedef struct { double x[2], u, period, e, y[2], t, last; int kind, mode, events; } unit;
typedef struct { int again, end, nominals, values, next; double time; } event;
static unit units[8];
static int used;
/* What is called in a mode that FMI 2.0 does not allow it in is an error (3). */
#define IN(allowed) do { if (!(allowed)) { return 3; } } while (0)
EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }
EXPORT void *fmi2Instantiate(const char *n, int t, const char *g, const char *r, const void *c, int v, int l)
{
    unit *m = &units[used++ % 8];
    (void)n; (void)g; (void)r; (void)c; (void)v; (void)l;
    memset(m, 0, sizeof *m);
    return t == 0 ? m : NULL;
}
EXPORT void fmi2FreeInstance(void *v) { (void)v; }
EXPORT int fmi2SetupExperiment(void *v, int d, double tolerance, double start, int s, double stop)
{
    unit *m = v;
    (void)s; (void)stop;
    IN(d && tolerance == 1e-9);
    m->t = m->last = start;
    return 0;
}
EXPORT int fmi2SetInteger(void *v, const unsigned *r, size_t n, const int *x)
{
    unit *m = v;
    (void)r;
    IN(n == 1 && m->mode == MADE);
    m->kind = x[0];
    return 0;
}
EXPORT int fmi2SetReal(void *v, const unsigned *r, size_t n, const double *x)
{
    unit *m = v;
    double *const places[] = { &m->x[0], &m->x[1], &m->u, &m->period, &m->e };
    IN(m->mode != CONTINUOUS);
    for (size_t i = 0; i < n; i++) { *places[r[i]] = x[i]; }
    return 0;
}
EXPORT int fmi2GetReal(void *v, const unsigned *r, size_t n, double *x)
{
    unit *m = v;
    const double values[] = { m->x[0], m->x[1], m->u, m->period, m->e, m->x[0], m->x[1], m->events, m->u };
    for (size_t i = 0; i < n; i++) { x[i] = values[r[i]]; }
    return 0;
}
EXPORT int fmi2EnterInitializationMode(void *v) { ((unit *)v)->mode = INITIALIZING; return 0; }
EXPORT int fmi2ExitInitializationMode(void *v) { ((unit *)v)->mode = EVENT; return 0; }
EXPORT int fmi2EnterEventMode(void *v)
{
    unit *m = v;
    IN(m->mode == CONTINUOUS);
    m->mode = EVENT;
    return 0;
}
EXPORT int fmi2EnterContinuousTimeMode(void *v)
{
    unit *m = v;
    IN(m->mode == EVENT);
    m->mode = CONTINUOUS;
    return 0;
}
static double due(const unit *m) { return (m->events + 1) * m->period; }
EXPORT int fmi2NewDiscreteStates(void *v, event *e)
{
    unit *m = v;
    IN(m->mode == EVENT);
    memset(e, 0, sizeof *e);
    m->last = m->t;
    if (m->kind == BALL && m->x[0] <= 0.0 && m->x[1] < 0.0) {
        m->x[1] *= -m->e;
        m->events++;
        e->values = e->again = 1;
    }
    if (m->kind == CLOCK) {
        if (m->t >= due(m)) { m->events++; e->again = 1; }
        e->next = 1;
        e->time = due(m);
    }
    if (m->kind == SAWTOOTH && m->x[0] > 0.5) {
        m->x[0] -= 0.5;
        m->events++;
        e->values = 1;
    }
    if (m->kind == ENDLESS) { e->next = 1; e->time = m->t; }
    return 0;
}
EXPORT int fmi2SetTime(void *v, double t)
{
    unit *m = v;
    IN(m->mode != INITIALIZING && t >= m->last);
    m->t = t;
    return 0;
}
EXPORT int fmi2SetContinuousStates(void *v, const double *x, size_t n)
{
    unit *m = v;
    IN(m->mode == CONTINUOUS && n == 2);
    memcpy(m->x, x, sizeof m->x);
    return 0;
}
EXPORT int fmi2GetContinuousStates(void *v, double *x, size_t n) { (void)n; memcpy(x, ((unit *)v)->x, 16); return 0; }
EXPORT int fmi2GetNominalsOfContinuousStates(void *v, double *x, size_t n)
{
    (void)v; (void)n;
    x[0] = 1.0;
    x[1] = NAN;
    return 0;
}
EXPORT int fmi2GetDerivatives(void *v, double *d, size_t n)
{
    unit *m = v;
    IN(m->mode == CONTINUOUS && n == 2);
    d[0] = m->x[1];
    d[1] = m->u;
    switch (m->kind) {
    case BALL: d[1] = -9.81; break;
    case CLOCK: d[0] = m->events; d[1] = 0.0; break;
    case STIFF: d[0] = -1e8 * (m->x[0] - cos(m->t)) - sin(m->t); d[1] = 0.0; break;
    case OSCILLATOR: d[1] = -1e4 * m->x[0]; break;
    case DISCARDS: case NOT_FINITE: case SAWTOOTH: case FAILS: d[0] = 1.0; d[1] = 0.0; break;
    default: break;
    }
    if (m->x[0] > 0.5) {
        if (m->kind == DISCARDS) { return 2; }
        if (m->kind == FAILS) { return 3; }
        if (m->kind == NOT_FINITE) { d[1] = NAN; }
    }
    return 0;
}
EXPORT int fmi2GetEventIndicators(void *v, double *z, size_t n)
{
    unit *m = v;
    IN(m->mode == CONTINUOUS && n == 1);
    z[0] = m->kind == BALL ? m->x[0] : 1.0;
    return 0;
}
EXPORT int fmi2CompletedIntegratorStep(void *v, int no, int *enter, int *end)
{
    unit *m = v;
    (void)no;
    IN(m->mode == CONTINUOUS);
    *enter = m->kind == SAWTOOTH && m->x[0] > 0.5;
    *end = m->kind == ENDS && m->t > 0.5;
    return 0;
}
#define GOOD(name) EXPORT int name(void *v); int name(void *v) { (void)v; return 0; }
"""
GOOD = """Terminate Reset SetDebugLogging GetInteger GetBoolean SetBoolean GetString SetString GetFMUstate SetFMUstate
FreeFMUstate SerializedFMUstateSize SerializeFMUstate DeSerializeFMUstate GetDirectionalDerivative"""


@pytest.fixture(scope="module")
def library():
    source = C + "\n".join(f"GOOD(fmi2{name})" for name in GOOD.split()).encode() + b"\n"
    return build_library({"model.c": source}, "Model", host_platform())


@pytest.fixture(scope="module")
def model(library, tmp_path_factory):
    """Make a component of the FMU: a kind and start values; without states it is a clock that counts its events."""

    def real(reference, name, about, kind):
        return f'<ScalarVariable name="{name}" valueReference="{reference}" {kind}><Real {about}/></ScalarVariable>'

    start = 'causality="parameter" variability="fixed"'
    names = ("x_0", "v_0", "u", "period", "restitution")
    variables = [real(i, n, 'start="0"', start if n != "u" else 'causality="input"') for i, n in enumerate(names)]
    variables += [real(5, "x", "", 'causality="output"'), real(6, "v", "", 'causality="output"')]
    variables += [real(5, "der(x)", 'derivative="6"', ""), real(6, "der(v)", 'derivative="7"', "")]
    variables += [real(7, "events", "", 'causality="output" variability="discrete"')]
    variables += [real(8, "u_now", "", 'causality="output"')]
    variables += [f'<ScalarVariable name="kind" valueReference="0" {start}><Integer start="0"/></ScalarVariable>']
    folder = tmp_path_factory.mktemp("model exchange")

    def make(kind, *, states=True, **start):
        path = folder / ("Model.fmu" if states else "Stateless.fmu")
        derivatives = '<Derivatives><Unknown index="8"/><Unknown index="9"/></Derivatives>' if states else ""
        if not path.exists():
            text = (
                '<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="2.0" modelName="m" guid="{m}" '
                f'numberOfEventIndicators="{int(states)}"><ModelExchange modelIdentifier="Model"/>'
                f"<ModelVariables>{''.join(variables)}</ModelVariables><ModelStructure><Outputs>"
                + "".join(f'<Unknown index="{i}"/>' for i in (6, 7, 10, 11))
                + f"</Outputs>{derivatives}</ModelStructure></fmiModelDescription>"
            )
            with zipfile.ZipFile(path, "w") as archive:
                archive.writestr("modelDescription.xml", text)
                archive.writestr(f"binaries/{fmpy.platform}/Model{fmpy.sharedLibraryExtension}", library)
        return Component("a", path, {"kind": kind, **start})

    return make


def run(component, step, duration, *signals, **options):
    return simulate(SystemStructure([component], [], signals), step, duration, **options)


def test_under_a_held_input_it_is_the_closed_form(model):
    result = run(model(INTEGRATORS, x_0=0.3, v_0=-1.0), 0.1, 2.0, Signal("a.u", lambda t: math.cos(5.0 * t)))
    x, v = 0.3, -1.0
    for k, (time, *found) in enumerate(zip(result.time, result.signals["a.x"], result.signals["a.v"], strict=True)):
        np.testing.assert_allclose(found, [x, v], rtol=1e-13, atol=1e-14)
        u = math.cos(5.0 * time)
        x, v = x + 0.1 * v + 0.005 * u, v + 0.1 * u
        assert k == 0 or result.signals["a.u_now"][k] == math.cos(5.0 * result.time[k - 1])
    assert result.metadata["engine"] == "fmpy"
    assert result.metadata["integrated"] == {"a": TOLERANCE}


def bounced(time, e):
    """Return height, speed and bounces of a ball dropped from 1 m at rest."""
    g, fall = 9.81, math.sqrt(2.0 / 9.81)
    if time < fall:
        return 1.0 - 0.5 * g * time**2, -g * time, 0
    time, speed, count = time - fall, e * g * fall, 1
    while time >= 2.0 * speed / g:
        time, speed, count = time - 2.0 * speed / g, e * speed, count + 1
    return speed * time - 0.5 * g * time**2, speed - g * time, count


@pytest.mark.parametrize("step", [1e-3, 0.02, 0.3])
def test_a_ball_bounces_at_its_times(model, step):
    result = run(model(BALL, x_0=1.0, restitution=0.8), step, 2.4)
    expected = np.array([bounced(t, 0.8) for t in result.time])
    np.testing.assert_allclose(result.signals["a.x"], expected[:, 0], atol=1e-9)
    np.testing.assert_allclose(result.signals["a.v"], expected[:, 1], atol=1e-9)
    assert result.signals["a.events"].tolist() == expected[:, 2].tolist()
    assert expected[-1, 2] == 4


@pytest.mark.parametrize("step", [0.01, 0.05])
def test_time_events_are_made_at_their_times(model, step):
    result = run(model(CLOCK, period=0.0375), step, 0.6)
    counts = np.floor(result.time / 0.0375 + 1e-9)
    whole = 0.0375 * counts * (counts - 1.0) / 2.0  # x' is the number of events
    np.testing.assert_allclose(result.signals["a.x"], whole + counts * (result.time - 0.0375 * counts), atol=1e-12)
    assert result.signals["a.events"].tolist() == counts.tolist()


def test_a_model_without_states_has_its_events(model):
    result = run(model(CLOCK, states=False, period=0.0375), 0.05, 0.6)
    assert result.signals["a.events"].tolist() == np.floor(result.time / 0.0375 + 1e-9).tolist()


def test_step_events_are_asked_for(model):
    result = run(model(SAWTOOTH), 0.1, 2.0)
    assert result.signals["a.x"].max() < 0.61
    assert result.signals["a.events"][-1] == 4
    np.testing.assert_allclose(result.signals["a.x"] + 0.5 * result.signals["a.events"], result.time, atol=1e-12)


def test_a_stiff_model_is_handed_to_radau(model):
    result = run(model(STIFF, x_0=1.0), 1e-3, 0.1)
    np.testing.assert_allclose(result.signals["a.x"], np.cos(result.time), atol=1e-8)
    (message,) = result.metadata["messages"]["a"]
    assert re.fullmatch(
        r"warning: stiff, integrated by Radau from t = \S+e-05 s on: DOP853 made 1000 steps in one", message
    )


def test_fast_oscillations_keep_their_tolerance_over_large_steps(model):
    result = run(model(OSCILLATOR, x_0=1.0), 0.5, 5.0)
    np.testing.assert_allclose(result.signals["a.x"], np.cos(100.0 * result.time), atol=1e-6)


@pytest.mark.parametrize(
    ("kind", "sentence"),
    [
        (
            DISCARDS,
            r"a: no step leads on from t = 0\.(5|4999)\d* s: fmi2GetDerivatives at t = 0\.5\d* s returned discard",
        ),
        (NOT_FINITE, r"a: no step leads on from t = 0\.(5|4999)\d* s: the derivatives at t = 0\.5\d* s are not finite"),
        (FAILS, r"a: fmi2GetDerivatives at t = 0\.\d+ s returned error"),
        (ENDS, r"a: the FMU asks for the end of the simulation at t = 0\.6 s"),
        (ENDLESS, rf"a: {MOST_STEPS} steps and events from t = 0\.0 s end at 0\.0 s"),
    ],
)
def test_what_fails_says_where_and_keeps_what_came_before(model, kind, sentence):
    with pytest.raises(SimulationError, match=sentence) as caught:
        run(model(kind), 0.1, 1.0)
    assert len(caught.value.result.time) in ((1,) if kind == ENDLESS else (5, 6))


def test_a_chosen_loop_in_c_is_refused(model):
    with pytest.raises(UserError, match="engine must be auto or fmpy where FMUs are run for model exchange, found nat"):
        run(model(INTEGRATORS), 0.1, 1.0, engine="native")


def test_an_interface_that_the_fmu_has_not_is_refused(model, fmus):
    component = model(INTEGRATORS)
    with pytest.raises(UserError, match="must be an FMU for co-simulation, found one for model exchange only"):
        run(Component("a", component.path, {}, "CoSimulation"), 0.1, 1.0)
    with pytest.raises(UserError, match="FMU for model exchange, found one for co-simulation only"):
        run(Component("a", fmus / "IhcController.fmu", {}, "ModelExchange"), 0.1, 1.0)


# The pendulum both ways


@pytest.fixture(scope="module")
def exchange_only(fmus, tmp_path_factory):
    """A folder with the pendulum's plant for model exchange only, and its controller."""
    folder = tmp_path_factory.mktemp("exchange only")
    (folder / "IhcController.fmu").write_bytes((fmus / "IhcController.fmu").read_bytes())
    with zipfile.ZipFile(fmus / "QubeServo2.fmu") as old, zipfile.ZipFile(folder / "QubeServo2.fmu", "w") as new:
        for name in old.namelist():
            data = old.read(name)
            if name == "modelDescription.xml":
                data = re.sub(rb"<CoSimulation.*?</CoSimulation>", b"", data, flags=re.DOTALL)
            new.writestr(name, data)
    return folder


@pytest.fixture(scope="module")
def free_fall(fmus):
    """The pendulum's own integration, open loop."""
    return fall(Component("plant", fmus / "QubeServo2.fmu", {"delta_0": 0.2}))


def fall(plant):
    return simulate(SystemStructure([plant], [], [Signal("plant.voltage", lambda t: math.sin(3.0 * t))]), 1e-3, 2.0)


def test_the_pendulum_falls_as_by_its_own_steps(exchange_only, fmus, free_fall):
    only = fall(Component("plant", exchange_only / "QubeServo2.fmu", {"delta_0": 0.2}))
    both = fall(Component("plant", fmus / "QubeServo2.fmu", {"delta_0": 0.2}, "ModelExchange"))
    for name, values in free_fall.signals.items():
        np.testing.assert_allclose(only.signals[name], values, atol=1e-7, err_msg=name)
        np.testing.assert_array_equal(only.signals[name], both.signals[name])


def test_scenarios_balance_it(exchange_only, fmus):
    scenario, folder = load_scenario("tilt")
    by_steps = scenario.changed({"plant.measurement": "ideal", "run.duration": 2.0})
    chosen = by_steps.changed({"plant.interface": "ModelExchange"})
    runs = [
        simulate(build_system(s, where, folder), 1e-3, 2.0)
        for s, where in ((by_steps, fmus), (by_steps, exchange_only), (chosen, fmus))
    ]
    assert ["integrated" in r.metadata for r in runs] == [False, True, True]
    for other in runs[1:]:
        difference = np.abs(other.signals["plant.delta"] - runs[0].signals["plant.delta"]).max()
        assert difference < 1e-6


def test_an_ssp_carries_the_interface(exchange_only, tmp_path):
    scenario, folder = load_scenario("tilt")
    system = build_system(scenario, exchange_only, folder)
    path = write(tmp_path / "pair.ssp", "pair", system, 0.5, 1e-3)
    with zipfile.ZipFile(path) as archive:
        text = archive.read("SystemStructure.ssd").decode()
    assert re.findall(r'name="(\w+)" type="application/x-fmu-sharedlibrary".*?implementation="(\w+)"', text) == [
        ("controller", "CoSimulation"),
        ("plant", "ModelExchange"),
    ]
    again, place = load_scenario(str(path))
    assert (again.plant.interface, again.controller.interface) == ("ModelExchange", "CoSimulation")
    assert len(simulate(build_system(again, place, place), 1e-3, 0.5).time) == 501


def test_wires_join_it_to_others(model, tiny):
    system = SystemStructure(
        [tiny("b", gain=0.0), model(INTEGRATORS, v_0=2.0)], [Wire("a.x", "b.u"), Wire("b.y", "a.u")]
    )
    np.testing.assert_allclose(simulate(system, 0.1, 1.0).signals["a.x"][-1], 2.0, rtol=1e-12)
