"""Linear models out of FMUs of both kinds, against analytic ones; and what cannot be linearized, in one sentence."""

from __future__ import annotations

import re
import subprocess
import sys
import textwrap
import zipfile
from typing import Any

import fmpy
import numpy as np
import pytest

from cosim.errors import UserError
from cosim.fmu import FmuError, Instance
from cosim.linearize import linear_model
from cosim.plant_model import sample_time_for
from cosim.system_export import export_system
from cosim.system_file import _hints, write
from fmu_export.native_build import build_library, host_platform
from fmu_export.python_fmu import export_python_fmu
from ihc_fmu.inverse import inverse_design
from ihc_fmu.quantity import Quantity
from ihc_fmu.synthesis import chosen_options
from ihc_fmu.system import System
from plant_fmu.linearization import linearize
from plant_fmu.parameters import PARAMETER_SETS
from plant_fmu.slave import QubeServo2
from tests.cosim.command import ended, sentence

UPRIGHT = {"delta": 0.0}
PAIRS = [f"{name}={name}_0" for name in ("theta", "delta", "theta_dot", "delta_dot")]
A, b = linearize(PARAMETER_SETS["ident"].parameters)


def repacked(source, path, change):
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(path, "w") as new:
        for name in old.namelist():
            data = old.read(name)
            new.writestr(name, change(data.decode()) if name == "modelDescription.xml" else data)
    return path


def for_model_exchange_only(text):
    text = re.sub(r"<CoSimulation.*?</CoSimulation>", "", text, flags=re.DOTALL)
    return text.replace('providesDirectionalDerivative="true"', 'providesDirectionalDerivative="false"')


@pytest.fixture(scope="session", params=["directional", "differences", "steps", "python"])
def pendulum(request, fmus, tmp_path_factory):
    """The pendulum's FMU as each of the ways finds it: (path, states to name, tolerance)."""
    folder, native = tmp_path_factory.mktemp("linearize"), fmus / "QubeServo2.fmu"
    if request.param == "differences":
        return repacked(native, folder / "exchange.fmu", for_model_exchange_only), (), 1e-11
    if request.param == "python":
        return export_python_fmu(QubeServo2, folder / "Python.fmu"), (), 1e-7
    return (native, PAIRS, 1e-7) if request.param == "steps" else (native, (), 1e-13)


def test_the_pendulum_linearizes_to_its_analytic_model(pendulum):
    path, states, tolerance = pendulum
    model = linear_model(path, ["voltage"], states=states, at=UPRIGHT)
    np.testing.assert_allclose(model.A, A, rtol=tolerance, atol=0)
    np.testing.assert_allclose(model.B[:, 0], b, rtol=tolerance, atol=0)
    np.testing.assert_array_equal(model.C, np.eye(4))
    assert not model.D.any()
    assert not model.residual.any()
    names = ["theta [rad]", "delta [rad]", "theta_dot [rad/s]", "delta_dot [rad/s]"]
    assert [str(q) for q in model.states] == names
    assert (model.inputs, model.notes) == ((Quantity("voltage", "V"),), ())
    assert model.error < max(tolerance, 1e-9)


def test_from_its_start_it_hangs_and_parameters_count(fmus):
    model = linear_model(fmus / "QubeServo2.fmu", ["voltage"], start={"m_p": 0.03, "back_emf": False})
    assert model.x_eq.tolist() == [0.0, np.pi, 0.0, 0.0]
    p = PARAMETER_SETS["ident"].parameters
    upright, _ = linearize(
        type(p)(**{**{f: getattr(p, f) for f in p.__dataclass_fields__}, "m_p": 0.03}), back_emf=False
    )
    hanging = upright.copy()
    hanging[3, :3] *= -1  # gravity and the coupling turn their signs
    hanging[2, 3] *= -1
    np.testing.assert_allclose(model.A, hanging, rtol=1e-9, atol=1e-12)


def test_a_co_simulation_is_not_run_with_an_fmu_for_model_exchange_only(fmus, tmp_path):
    path = repacked(fmus / "QubeServo2.fmu", tmp_path / "exchange.fmu", for_model_exchange_only)
    with pytest.raises(UserError, match=r"must be an FMU for co-simulation, found one for model exchange only"):
        Instance("plant", path)


def test_an_output_that_a_sensor_counts_is_refused_or_told(fmus):
    fmu = fmus / "QubeServo2.fmu"
    with pytest.raises(UserError, match=r"theta_encoder after 0\.001 s has no derivative by theta"):
        linear_model(fmu, ["voltage"], ["theta_encoder"], states=PAIRS, at=UPRIGHT)
    exact = linear_model(fmu, ["voltage"], ["theta_encoder"], states=PAIRS, at=UPRIGHT, start={"encoder_counts": 0})
    np.testing.assert_array_equal(exact.C, [[1.0, 0.0, 0.0, 0.0]])
    (note,) = linear_model(fmu, ["voltage"], ["energy"], at=UPRIGHT).notes
    assert note == "the output energy does not change with the states there, and measures nothing"


# PythonFMU's plants, as somebody writes them


PLANT = """
import math
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

class {name}(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        for name in {parameters}:
            setattr(self, name, {parameters}[name])
            self.register_variable(Real(name, causality=Fmi2Causality.parameter, variability=Fmi2Variability.fixed))
        for name in {inputs}:
            setattr(self, name, 0.0)
            self.register_variable(Real(name, causality=Fmi2Causality.input, description="push [N]"))
        for name in {outputs}:
            setattr(self, name, 0.0)
            self.register_variable(Real(name, causality=Fmi2Causality.output, description="it [m/s] moves [m]"))

    def exit_initialization_mode(self):
{begin}

    def do_step(self, t, h):
{step}
        return True
"""


@pytest.fixture
def plant(tmp_path):
    """Make the FMU of a plant from its lines; each must have a name of its own, since Python keeps modules by name."""

    def make(name, step, begin="self.x, self.v = self.x_0, self.v_0", outputs=("x", "v"), **parameters):
        parameters = {"x_0": 0.0, "v_0": 0.0, **parameters}
        text = PLANT.format(
            **{"name": name, "parameters": parameters, "inputs": ["u"], "outputs": list(outputs)},
            **{
                key: textwrap.indent(textwrap.dedent(value), 8 * " ")
                for key, value in (("begin", begin), ("step", step))
            },
        )
        (tmp_path / f"{name.lower()}.py").write_text(text)
        command = [sys.executable, "-m", "pythonfmu", "build", "-f", f"{name.lower()}.py"]
        subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, timeout=60)
        return tmp_path / f"{name}.fmu"

    return make


RK4 = """
def f(x, v):
    return v, {acceleration}
x, v, n = self.x, self.v, 10
for _ in range(n):
    s = h / n
    a = f(x, v)
    b = f(x + s / 2 * a[0], v + s / 2 * a[1])
    c = f(x + s / 2 * b[0], v + s / 2 * b[1])
    d = f(x + s * c[0], v + s * c[1])
    x, v = x + s / 6 * (a[0] + 2 * b[0] + 2 * c[0] + d[0]), v + s / 6 * (a[1] + 2 * b[1] + 2 * c[1] + d[1])
self.x, self.v = x, v
"""


def test_a_plant_of_pythonfmu_about_a_held_angle(plant):
    fmu = plant("Held", RK4.format(acceleration="-9.81 * math.sin(x) - 0.3 * v + self.u"))
    model = linear_model(fmu, at={"x": 1.0}, free=["u"])
    assert model.x_eq.tolist() == [1.0, 0.0]
    assert model.u_eq[0] == pytest.approx(9.81 * np.sin(1.0), rel=1e-12)
    np.testing.assert_allclose(model.A, [[0, 1], [-9.81 * np.cos(1.0), -0.3]], rtol=1e-8)
    np.testing.assert_array_equal(model.B, [[0], [1]])
    assert [str(q) for q in (*model.states, *model.inputs)] == ["x [m]", "v [m]", "u [N]"]
    with pytest.raises(
        UserError, match=r"no equilibrium near x = 1, u = 0: v' is -8\.25\d m/s where .*; x is what would"
    ):
        linear_model(fmu, at={"x": 1.0})
    near = linear_model(fmu, at={"x": 3.14159})
    np.testing.assert_allclose(near.x_eq, [np.pi, 0.0], rtol=1e-13)
    assert near.notes == ("x = 3.14159 is 2.7e-06 beside the equilibrium, which is taken",)


def test_a_plant_that_integrates_with_the_communication_step_is_the_model_of_that_step_and_this_is_said(plant):
    fmu = plant("Coarse", "self.x, self.v = self.x + h * self.v, self.v + h * (-4 * self.x - self.v + self.u)")
    true, found = np.array([[0, 1], [-4, -1]]), {}
    for step in (1e-2, 1e-3):
        model = linear_model(fmu, step=step)
        found[step] = np.abs(model.A - true).max()
        np.testing.assert_allclose(np.eye(2) + step * true, _exponential(model.A, step), atol=1e-9)  # Euler's map
        assert any("integrates with the communication step" in note for note in model.notes)
        assert 0.3 < model.error / (found[step] / 4) < 3
    assert found[1e-2] / found[1e-3] == pytest.approx(10, rel=0.1)


def _exponential(A, time):
    from scipy.linalg import expm

    return expm(A * time)


def test_a_state_that_is_not_named_is_found_out(plant):
    step = (
        "n = 20\nfor _ in range(n):\n    self.x, self.v = self.x + h / n * self.v, self.v + h / n * (self.u - self.v)"
    )
    fmu = plant("Hidden", step)
    assert linear_model(fmu).A.shape == (2, 2)
    with pytest.raises(UserError, match=r"the states x do not describe .*Hidden\.fmu"):
        linear_model(fmu, states=["x"])


@pytest.mark.parametrize(
    ("name", "begin", "words"),
    [
        ("Degrees", "self.x, self.v = math.radians(self.x_0), self.v_0", "x_0 must set x at the start.* by 0.01745"),
        ("Deaf", "self.x, self.v = 0.0, self.v_0", r"x_0 must set x at the start.* by 0$"),
    ],
)
def test_a_parameter_that_does_not_set_its_state_is_named(plant, name, begin, words):
    with pytest.raises(UserError, match=words):
        linear_model(plant(name, RK4.format(acceleration="self.u - x"), begin))


def test_an_output_with_direct_influence_of_the_input_has_it_in_d_and_is_no_system(plant):
    step = RK4.format(acceleration="self.u - x") + "self.a = 2 * self.u - self.x\nself.y = 3 * self.x"
    fmu = plant("Direct", step, outputs=("x", "v", "a", "y"))
    model = linear_model(fmu, outputs=["a", "y"])
    np.testing.assert_allclose(model.C, [[-1, 0], [3, 0]], atol=1e-8)
    np.testing.assert_allclose(model.D, [[2], [0]], atol=1e-8)
    with pytest.raises(UserError, match=r"the output a depends on u directly \(D = 2\), which a controller's model"):
        model.system()
    assert linear_model(fmu, outputs=["y"]).system().outputs == (Quantity("y", "m"),)


def test_an_output_that_is_a_step_late_is_told(plant):
    step = "self.y = self.x\n" + RK4.format(acceleration="self.u - 100 * v").strip("\n")
    begin = "self.x, self.v, self.y = self.x_0, self.v_0, self.x_0"
    (note,) = linear_model(plant("Late", step, begin, ("x", "v", "y")), outputs=["y"], step=1e-3).notes
    assert note.startswith("y depends on the state otherwise at the start than after a step")


@pytest.mark.parametrize(
    ("name", "acceleration", "words"),
    [
        (
            "Dry",
            "self.u - (0.5 if v > 0 else -0.5 if v < 0 else 0.0)",
            "do not describe .*; a state is missing .* or dry friction is at work",
        ),
        ("OneWay", "max(self.u, 0.0) - x - v", "different derivatives by u to both sides"),
        ("Drift", "1.0 + 0 * self.u", r"no equilibrium near u = 0: v' is 1 m/s"),
        (
            "Magnet",
            "9.81 - (self.u / (1.0 + x)) ** 2 - 0.1 * v",
            r"no equilibrium near u = 0: v' is 9\.8\d+ m/s where the search begins; .*; free an input \(--free u\), or",
        ),
    ],
)
def test_what_is_not_smooth_or_does_not_rest_is_named(plant, name, acceleration, words):
    with pytest.raises(UserError, match=words):
        linear_model(plant(name, RK4.format(acceleration=acceleration)))


def test_a_plant_that_fails_beside_the_equilibrium_is_approached_and_one_that_always_does_named(plant):
    edge = plant("Edge", RK4.format(acceleration="self.u - math.sqrt(x) + 0.05 - v"), x_0=0.002)
    np.testing.assert_allclose(linear_model(edge).A, [[0, 1], [-0.5 / 0.05, -1]], rtol=1e-5)
    with pytest.raises(FmuError, match=r"plant: doStep\(0\.0, 0\.001\) returned .*math domain error"):
        linear_model(plant("Never", RK4.format(acceleration="math.sqrt(-1.0 - x * x)")))
    wall = plant("Wall", RK4.format(acceleration="self.u + math.sqrt(-x * x) - v"))
    with pytest.raises(UserError, match=r"Wall\.fmu cannot be evaluated near x = 0, v = 0, u = 0: .*math domain error"):
        linear_model(wall)


def test_names_that_are_not_there_are_refused_with_those_that_are(plant):
    fmu = plant("Names", RK4.format(acceleration="self.u - x"), outputs=("x", "v", "y"))
    cases: Any = (
        ({"inputs": ["w"]}, "the FMU has no real input 'w'"),
        ({"outputs": ["yy"]}, "no real output 'yy'.*did you mean"),
        ({"states": ["x=x0"]}, "no real parameter 'x0'.*x_0"),
        ({"states": ["z"]}, "no real output 'z'"),
        ({"states": ["x", "x=x_0"]}, "each state must be named once, found 'x' twice"),
        ({"at": {"w": 0.0}}, "no state or input 'w'"),
        ({"at": {"x": float("nan")}}, "x must be finite, found nan"),
        ({"at": {"u": 1.0}, "free": ["u"]}, "u cannot be free and stay at 1"),
        ({"free": ["w"]}, "no state or input 'w'"),
        ({"start": {"mass": 1.0}}, "no variable named 'mass'"),
        ({"step": 0.0}, "communication step must be positive"),
    )
    for arguments, words in cases:
        with pytest.raises(UserError, match=words) as caught:
            linear_model(fmu, **arguments)
        assert "\n" not in str(caught.value)


def test_a_plant_without_parameters_for_its_states_is_told_what_it_needs(plant):
    fmu = plant("Mute", RK4.format(acceleration="self.u"), "self.x, self.v = self.x_0, self.v_0", ("x", "v", "q"))
    named = repacked(fmu, fmu.with_name("Mute2.fmu"), lambda t: t.replace('"x_0"', '"begin"').replace('"v_0"', '"b.v"'))
    with pytest.raises(UserError, match="for co-simulation only and does not say what its states are: name each with"):
        linear_model(named)
    assert linear_model(named, states=["x=begin", "v=b.v"]).states == (Quantity("x", "m"), Quantity("v", "m"))


def test_an_output_whose_start_value_can_be_set_is_its_own_parameter(plant):
    fmu = plant("Own", RK4.format(acceleration="self.u - 4 * x"), "pass", ("x", "v"))
    exact = repacked(
        fmu,
        fmu.with_name("Own2.fmu"),
        lambda t: (
            t.replace('causality="output">', 'causality="output" initial="exact">')
            .replace("<Real/>", '<Real start="0"/>')
            .replace('"x_0"', '"a"')
            .replace('"v_0"', '"b"')
        ),
    )
    np.testing.assert_allclose(linear_model(exact).A, [[0, 1], [-4, 0]], rtol=1e-8)
    np.testing.assert_allclose(linear_model(exact, states=["v", "x"]).A, [[0, -4], [1, 0]], rtol=1e-8)


def test_numbers_beyond_the_range_are_refused(plant):
    with pytest.raises((UserError, FmuError)) as caught:
        linear_model(plant("Huge", RK4.format(acceleration="1e307 * (self.u - x)")), at={"x": 0.0})
    assert "\n" not in str(caught.value)


def test_an_fmu_that_wants_one_communication_step_gets_no_other(plant):
    step = "self.x, self.v = self.x + h * self.v, self.v + h * self.u\nif h != 1e-3:\n    raise ValueError(h)"
    fmu = plant("Fixed", step)
    model = linear_model(fmu, step=1e-3)
    assert model.notes == ()
    fixed = repacked(fmu, fmu.with_name("Fixed2.fmu"), lambda t: t.replace('StepSize="true"', 'StepSize="false"'))
    np.testing.assert_array_equal(linear_model(fixed, step=1e-3).A, model.A)


def test_ctrl_c_during_a_python_plants_step_ends_it_and_is_not_the_plants_failure(plant):
    stop = "import signal\nself.x += 0.0\nif self.u > 0.005:\n    signal.raise_signal(signal.SIGINT)"
    with pytest.raises(KeyboardInterrupt):
        linear_model(plant("Stopped", stop + RK4.format(acceleration="self.u - x")))


# A model for model exchange made by others


C = rb"""
#include <stddef.h>
#include <string.h>
#define EXPORT __attribute__((visibility("default")))
typedef struct { double x[2], u, y; int status, endless, finished, wrong, event; } unit;
static unit units[4];
static int used;
EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }
EXPORT void *fmi2Instantiate(const char *n, int t, const char *g, const char *r, const void *c, int v, int l)
{
    unit *u = &units[used++ % 4];
    (void)n; (void)g; (void)r; (void)c; (void)v; (void)l;
    memset(u, 0, sizeof *u);
    return t == 0 ? u : NULL;
}
EXPORT void fmi2FreeInstance(void *v) { (void)v; }
EXPORT int fmi2SetInteger(void *v, const unsigned *r, size_t n, const int *x)
{
    for (size_t i = 0; i < n; i++) { (&((unit *)v)->status)[r[i]] = x[i]; }
    return 0;
}
EXPORT int fmi2SetReal(void *v, const unsigned *r, size_t n, const double *x)
{
    unit *u = v;
    (void)r;
    for (size_t i = 0; i < n; i++) { u->u = x[i]; }
    return u->event ? 0 : 3;
}
EXPORT int fmi2GetReal(void *v, const unsigned *r, size_t n, double *x)
{
    unit *u = v;
    const double values[] = { u->x[0], u->x[1], u->x[1], -4.0 * u->x[0] + u->u, u->u, 2.0 * u->x[0] };
    for (size_t i = 0; i < n; i++) { x[i] = values[r[i]]; }
    return 0;
}
EXPORT int fmi2GetDerivatives(void *v, double *x, size_t n)
{
    unit *u = v;
    const unsigned r[] = { 2, 3 };
    if (u->status && u->x[0] != 0.0) { return u->status; }
    return fmi2GetReal(v, r, n, x);
}
EXPORT int fmi2SetContinuousStates(void *v, const double *x, size_t n)
{
    unit *u = v;
    if (u->event) { return 3; }
    memcpy(u->x, x, n * sizeof *x);
    return 0;
}
EXPORT int fmi2GetContinuousStates(void *v, double *x, size_t n) { memcpy(x, ((unit *)v)->x, n * sizeof *x); return 0; }
EXPORT int fmi2GetDirectionalDerivative(void *v, const unsigned *z, size_t nz, const unsigned *k, size_t nk,
                                        const double *dk, double *dz)
{
    unit one = *(unit *)v, zero = one;
    const double factor = one.wrong ? 2.0 : 1.0;
    double low;
    (void)nk;
    *(k[0] < 2 ? &one.x[k[0]] : &one.u) = 1.0;
    *(k[0] < 2 ? &zero.x[k[0]] : &zero.u) = 0.0;
    for (size_t i = 0; i < nz; i++) {
        fmi2GetReal(&one, &z[i], 1, &dz[i]);
        fmi2GetReal(&zero, &z[i], 1, &low);
        dz[i] = factor * dk[0] * (dz[i] - low);
    }
    return 0;
}
typedef struct { int again, end, nominals, values, next; double time; } event;
EXPORT int fmi2NewDiscreteStates(void *v, event *e)
{
    unit *u = v;
    memset(e, 0, sizeof *e);
    e->again = u->endless;
    e->end = u->finished;
    return 0;
}
EXPORT int fmi2EnterEventMode(void *v) { ((unit *)v)->event = 1; return 0; }
EXPORT int fmi2ExitInitializationMode(void *v) { ((unit *)v)->event = 1; return 0; }
EXPORT int fmi2EnterContinuousTimeMode(void *v) { ((unit *)v)->event = 0; return 0; }
#define GOOD(name) EXPORT int name(void *v); int name(void *v) { (void)v; return 0; }
"""
GOOD = """SetupExperiment EnterInitializationMode Terminate Reset SetDebugLogging GetInteger GetBoolean SetBoolean GetString
SetString GetFMUstate SetFMUstate FreeFMUstate SerializedFMUstateSize SerializeFMUstate DeSerializeFMUstate SetTime
CompletedIntegratorStep GetEventIndicators GetNominalsOfContinuousStates"""
KNOBS = ("status", "endless", "finished", "wrong")


@pytest.fixture(scope="module")
def library():
    source = C + "\n".join(f"GOOD(fmi2{name})" for name in GOOD.split()).encode() + b"\n"
    return build_library({"model.c": source}, "Model", host_platform())


@pytest.fixture
def foreign(library, tmp_path):
    """A mass on a spring with a discrete input, names as of Modelica, and knobs for what goes wrong."""

    def real(reference, name, about, kind):
        return f'<ScalarVariable name="{name}" valueReference="{reference}" {kind}><Real {about}/></ScalarVariable>'

    knobs = "".join(
        f'<ScalarVariable name="{knob}" valueReference="{i}" causality="parameter" variability="fixed"><Integer start="0"/>'
        "</ScalarVariable>"
        for i, knob in enumerate(KNOBS)
    )
    variables = (
        real(0, "body.x[1]", 'start="0" unit="m" nominal="0.1"', 'initial="exact"')
        + real(1, "body.v", 'start="0" unit="m/s"', 'initial="exact"')
        + real(2, "der(body.x[1])", 'derivative="1"', "")
        + real(3, "der(body.v)", 'derivative="2"', "")
        + real(4, "force", 'start="0" min="-5" max="7" unit="N"', 'causality="input" variability="discrete"')
        + real(5, "sensor.y", 'unit="mm"', 'causality="output"')
    )
    text = (
        '<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="2.0" modelName="m" guid="{m}">'
        '<ModelExchange modelIdentifier="Model" providesDirectionalDerivative="true"/><UnitDefinitions>'
        '<Unit name="m"/><Unit name="m/s"/><Unit name="N"/><Unit name="mm"/></UnitDefinitions>'
        f"<ModelVariables>{variables}{knobs}</ModelVariables>"
        '<ModelStructure><Outputs><Unknown index="6"/></Outputs><Derivatives><Unknown index="3"/><Unknown index="4"/>'
        "</Derivatives></ModelStructure></fmiModelDescription>"
    )
    path = tmp_path / "Foreign.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", text)
        archive.writestr(f"binaries/{fmpy.platform}/Model{fmpy.sharedLibraryExtension}", library)
    return path


def test_a_foreign_model_keeps_its_names_units_and_limits(foreign, tmp_path):
    model = linear_model(foreign, outputs=["sensor.y"], at={"force": 2.0})
    np.testing.assert_allclose(model.A, [[0, 1], [-4, 0]], atol=1e-12)
    np.testing.assert_allclose(model.B, [[0], [1]], atol=1e-12)
    np.testing.assert_allclose(model.C, [[2, 0]], atol=1e-12)
    np.testing.assert_allclose([*model.x_eq, *model.u_eq, *model.y_eq], [0.5, 0.0, 2.0, 1.0], atol=1e-12)
    assert (model.lower.tolist(), model.upper.tolist()) == ([-5.0], [7.0])
    text = _hints(model.system())
    hints = [line for line in text.splitlines() if line.startswith("# ") and " = " in line]
    assert [hint.split()[1] for hint in hints] == [
        *("lqr", "resolutions", "deviations", "set_points", "integral", "observer")
    ]
    for hint in hints:  # each of them is what it says
        new = tmp_path / f"{hint.split()[1]}.toml"
        write(new, model)
        new.write_text(new.read_text(encoding="utf-8").replace(hint, hint.removeprefix("# ")), encoding="utf-8")
        assert System.load(new).sample_time == 0.01  # of 2 rad/s
    system = model.system("mass")
    system.save(tmp_path / "mass.toml")
    loaded = System.load(tmp_path / "mass.toml")
    assert loaded.states == (Quantity("body.x[1]", "m"), Quantity("body.v", "m/s"))
    assert loaded.outputs == (Quantity("sensor.y", "mm"),)
    with pytest.raises(UserError, match=r"name what is measured with --output: the state body\.x\[1\] is no output"):
        linear_model(foreign)
    with pytest.raises(UserError, match=r"the state body\.v acts on body\.x\[1\] and cannot be left out"):
        linear_model(foreign, outputs=["sensor.y"], states=["body.x[1]"])


@pytest.mark.parametrize(
    ("knob", "value", "error", "words"),
    [
        ("endless", 1, FmuError, "100 event iterations at t = 0 s do not come to an end"),
        ("finished", 1, FmuError, "asks for the end of the simulation at t = 0 s"),
        ("wrong", 1, UserError, "contradicts itself: its directional derivative of .*' by .* is -?[28], differences"),
        ("status", 3, UserError, r"cannot be evaluated near body\.x\[1\] = 0, .*getDerivatives returned error"),
        ("status", -7, UserError, "getDerivatives returned the status -7, which FMI does not know"),
    ],
)
def test_a_foreign_model_that_misbehaves_is_one_sentence(foreign, knob, value, error, words):
    with pytest.raises(error, match=words) as caught:
        linear_model(foreign, outputs=["sensor.y"], start={knob: value})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("A", "time", "why"),
    [
        ([[0.0, 1.0], [32.7, -0.222]], 2e-3, "0.02 of the time of the plant's fastest pole, 5.83 1/s"),
        ([[-0.5]], 0.02, "0.02 of the time of the plant's fastest pole, 0.5 1/s"),
        (np.eye(4, k=1), 1e-3, "no pole of the plant says what it needs"),
        ([[-7000.0]], 1e-3, "the plant's fastest pole, 7e+03 1/s, is left to itself"),
        ([[1000.0]], 1e-4, "0.1 of the time in which the plant grows, at 1e+03 1/s"),
    ],
)
def test_a_sample_time_is_chosen_from_the_poles(A, time, why):
    assert sample_time_for(np.array(A)) == (time, why)


# The command


def test_the_command_writes_a_system_file_and_leaves_its_upper_part(fmus, tmp_path):
    arguments = ("linearize", fmus / "QubeServo2.fmu", "--input", "voltage", "--at", "delta=0", "-o", "qube.toml")
    done = ended(*arguments, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    path = tmp_path / "qube.toml"
    np.testing.assert_allclose(System.load(path).A, A, rtol=1e-12)
    own = "# mine\n# lqr"
    path.write_text(path.read_text().replace("# lqr", own).replace("# limits = [1.0]", "limits = [10.0]"))
    path.write_text(path.read_text().replace('name = "QubeServo2"', 'name = "qube"'))
    before = path.read_text()
    assert ended(*arguments, cwd=tmp_path).returncode == 0
    assert path.read_text() == before
    assert ended(*arguments, "--set", "m_p=0.03", cwd=tmp_path).returncode == 0
    system: Any = System.load(path)
    assert (system.name, system.upper.tolist()) == ("qube", [10.0])
    assert own in path.read_text()
    assert abs(system.A[3, 1] - A[3, 1]) > 1.0
    path.write_text(path.read_text().replace("limits = [10.0]", "limits = [1.0, 2.0]"))
    assert sentence(ended(*arguments, cwd=tmp_path)).startswith("what stands above the line in qube.toml does not fit")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("-o", "qube.json"), r"-o must name a \.toml file, found qube\.json"),
        (("-o", "mine.toml"), "mine.toml was not written by qube-ihc and stays"),
        (("-o", "other.toml"), "other.toml was not written by linearize and stays"),
        (("--at", "delta"), "--at takes NAME=VALUE, found 'delta'"),
        (("--at", "delta=up"), "--at delta must be a number or a multiple of pi, found 'up'"),
        (("--at", "delta=0", "--at", "delta=1"), "--at must have each name once, found 'delta' twice"),
        (
            ("--at", "delta=1", "--free", "voltage", "--at", "theta_dot=1"),
            r"search begins; .*; hold other values \(--at\)",
        ),
        (("--step", "0.001"), "--step is for FMUs that are for co-simulation only"),
        (("--at", "delta=1"), "there is no equilibrium near delta = 1, voltage = 0"),
    ],
)
def test_the_command_refuses_in_one_sentence_and_writes_nothing(fmus, tmp_path, arguments, words):
    (tmp_path / "mine.toml").write_text("x = 1\n")
    (tmp_path / "other.toml").write_text("# written by qube-ihc\nx = 1\n")
    before = {file.name: file.read_text() for file in tmp_path.iterdir()}
    done = ended("linearize", fmus / "QubeServo2.fmu", "--input", "voltage", *arguments, cwd=tmp_path)
    assert re.search(words, sentence(done))
    assert {file.name: file.read_text() for file in tmp_path.iterdir()} == before


def test_a_folder_is_not_linearized(tmp_path):
    assert sentence(ended("linearize", ".", cwd=tmp_path)) == "the file to linearize must be an FMU, found the folder ."


@pytest.mark.parametrize(("text", "value"), [("pi", np.pi), ("-pi/2", -np.pi / 2), ("2*pi", 2 * np.pi), ("1e-3", 1e-3)])
def test_values_may_be_multiples_of_pi(text, value):
    from cosim.cli.linearize import _value

    assert _value("x", text) == value


def test_a_counted_output_of_the_linear_plant_is_named_with_what_turns_it_off(tmp_path):
    system = System(
        name="cart",
        A=np.array([[0, 1], [0, -1]], float),
        B=np.array([[0], [1]], float),
        C=np.array([[1, 0]], float),
        K=np.array([[-1, -1]], float),
        states=(Quantity("x"), Quantity("v")),
        outputs=(Quantity("x"),),
        resolutions=np.array([0.01], float),
    )
    export_system(inverse_design(system, chosen_options(system).options), tmp_path)
    fmu = tmp_path / "cart_linear_plant.fmu"
    fine = {"x_resolution": 1e-5}  # the steps of differences see it
    with pytest.raises(
        UserError, match=r"differences give .*; x is counted \(x_resolution = 1e-05\): --set x_resolution=0"
    ):
        linear_model(fmu, ["u1"], ["x"], start=fine)
    with pytest.raises(UserError) as refusal:
        linear_model(fmu, ["u1"], ["x"]).system()
    assert str(refusal.value) == "x is counted (x_resolution = 0.01): --set x_resolution=0, or take --output x_true"
    for names, start in ((["x"], {"x_resolution": 0.0}), (["x_true"], {})):
        np.testing.assert_array_equal(linear_model(fmu, ["u1"], names, start=start).system().C, [[1.0, 0.0]])
