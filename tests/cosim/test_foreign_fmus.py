"""FMUs that others made: names, types, statuses and silences that ours never have. One C file plays them all."""

import os
import signal
import subprocess
import sys
import time
import zipfile
from xml.sax.saxutils import quoteattr

import fmpy
import numpy as np
import pytest

from cosim import master
from cosim.errors import UserError
from cosim.fmu_files import describe
from cosim.hil.controller import ControllerFmu
from cosim.hil.replay import controller_of, replay
from cosim.master import simulate
from cosim.results import Result, SimulationError
from cosim.structure import Component, Signal, SystemStructure, Wire
from fmu_export.native_build import build_library, host_platform
from tests.cosim.hil import rig

C = rb"""
#include <stddef.h>
#include <string.h>
#if defined _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
typedef void (*logger)(void *, const char *, int, const char *, const char *, ...);
typedef struct { logger log; void *alloc, *free, *finished, *environment; } callbacks;
enum { PLACES = 64, STATUS = 0, AT = 1, HANG = 2, CHATTER = 3, WHERE = 4, INTEGERS = 5 };
typedef struct { double reals[PLACES]; int integers[PLACES]; int steps; callbacks *c; } unit;
static unit units[8];
static int used;

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }
EXPORT void *fmi2Instantiate(const char *n, int t, const char *g, const char *r, callbacks *c, int v, int l)
{
    unit *u = &units[used++ % 8];
    (void)n; (void)t; (void)g; (void)r; (void)v; (void)l;
    memset(u, 0, sizeof *u);
    u->c = c;
    return u;
}
EXPORT void fmi2FreeInstance(void *u) { (void)u; }
static int told(unit *u, int where)
{
    static volatile int for_ever = 1;
    if (u->integers[WHERE] != where || u->steps < u->integers[AT]) { return 0; }
    while (u->integers[HANG] && for_ever) { }
    for (int i = 0; i < u->integers[CHATTER]; i++) { u->c->log(u->c->environment, "n", 0, "c", "line %d", i); }
    if (u->integers[STATUS]) { u->c->log(u->c->environment, "n", u->integers[STATUS], "c", ""); }
    return u->integers[STATUS];
}
EXPORT int fmi2DoStep(void *v, double t, double h, int p)
{
    unit *u = v;
    (void)p;
    u->steps++;
    for (int i = 8; i < PLACES; i++) { u->reals[i] = t + h; u->integers[i] = i; }
    return told(u, 0);
}
EXPORT int fmi2SetReal(void *v, const unsigned *r, size_t n, const double *x)
{
    for (size_t i = 0; i < n; i++) { ((unit *)v)->reals[r[i]] = x[i]; }
    return told(v, 1);
}
EXPORT int fmi2GetReal(void *v, const unsigned *r, size_t n, double *x)
{
    for (size_t i = 0; i < n; i++) { x[i] = ((unit *)v)->reals[r[i]]; }
    return told(v, 2);
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
EXPORT int fmi2SetString(void *v, const unsigned *r, size_t n, const char **x)
{
    for (size_t i = 0; i < n; i++) { ((unit *)v)->reals[r[i]] = (double)strlen(x[i]); }
    return 0;
}
EXPORT int fmi2ExitInitializationMode(void *v)
{
    for (int i = 8; i < PLACES; i++) { ((unit *)v)->integers[i] = i; }
    return told(v, 3);
}
#define GOOD(name) EXPORT int name(void *v); int name(void *v) { (void)v; return 0; }
"""
GOOD = """SetupExperiment EnterInitializationMode Terminate Reset SetDebugLogging GetBoolean SetBoolean GetString
GetFMUstate SetFMUstate FreeFMUstate SerializedFMUstateSize SerializeFMUstate DeSerializeFMUstate CancelStep GetStatus
GetDirectionalDerivative SetRealInputDerivatives GetRealOutputDerivatives GetRealStatus GetIntegerStatus GetBooleanStatus
GetStringStatus"""
DO_STEP, SET_REAL, GET_REAL, EXIT_INITIALIZATION = range(4)
KNOBS = ("status", "at", "hang", "chatter", "where")
SOURCE = C + "\n".join(f"GOOD(fmi2{name})" for name in GOOD.split()).encode() + b"\n"


@pytest.fixture(scope="session")
def library():
    return build_library({"odd.c": SOURCE}, "Odd", host_platform())


@pytest.fixture
def odd(library, tmp_path):
    """Make an FMU of (name, type, causality, unit), with the knobs before them."""

    def make(*variables, name="Odd.fmu", guid="{odd}", identifier="Odd", once=False):
        rows = []
        for i, knob in enumerate(KNOBS):
            rows.append(_variable(i, knob, "Integer", "parameter", None))
        rows += [_variable(8 + i, *variable) for i, variable in enumerate(variables)]
        outputs = [i + 1 for i, row in enumerate(rows) if 'causality="output"' in row]
        unknowns = "".join(f'<Unknown index="{i}"/>' for i in outputs)
        units = {v[3] for v in variables if v[3] is not None}
        definitions = "".join(f"<Unit name={quoteattr(u)}/>" for u in sorted(units))
        text = (
            f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="2.0" modelName="odd" guid="{guid}">'
            f'<CoSimulation modelIdentifier="{identifier}" canBeInstantiatedOnlyOncePerProcess="{str(once).lower()}"/>'
            + (f"<UnitDefinitions>{definitions}</UnitDefinitions>" if units else "")
            + '<TypeDefinitions><SimpleType name="Mode"><Enumeration><Item name="on" value="1"/>'
            '<Item name="fault" value="4"/></Enumeration></SimpleType><SimpleType name="Bare"><Enumeration>'
            '<Item name="on" value="1"/></Enumeration></SimpleType></TypeDefinitions>'
            f"<ModelVariables>{''.join(rows)}</ModelVariables>"
            f"<ModelStructure>{f'<Outputs>{unknowns}</Outputs>' if outputs else ''}</ModelStructure></fmiModelDescription>"
        )
        path = tmp_path / name
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("modelDescription.xml", text)
            archive.writestr(f"binaries/{fmpy.platform}/Odd{fmpy.sharedLibraryExtension}", library)
        return path

    return make


def _variable(reference, name, kind, causality, unit):
    start = {"Real": '0.0"', "Integer": '0"', "String": '"', "Boolean": 'false"'}.get(kind, '1"')
    start = "" if causality == "output" else f' start="{start}'
    declared = "" if kind in ("Real", "Integer", "String", "Boolean") else f' declaredType="{kind}"'
    about = f"{declared}{start}{'' if unit is None else f' unit={quoteattr(unit)}'}"
    variability = "fixed" if causality == "parameter" else "continuous" if kind == "Real" else "discrete"
    tag = "Enumeration" if declared else kind
    return (
        f'<ScalarVariable name={quoteattr(name, {chr(10): "&#10;"})} valueReference="{reference}" causality="{causality}" '
        f'variability="{variability}"><{tag}{about}/></ScalarVariable>'
    )


REAL = ("y", "Real", "output", None)


@pytest.fixture(params=["native", "fmpy"])
def engine(request, monkeypatch):
    monkeypatch.setattr(master, "needs_python", lambda _: request.param == "fmpy")
    return request.param


def run(fmu, steps=5, wires=(), signals=(), record=None, **start):
    return simulate(SystemStructure([Component("a", fmu, start)], wires, signals), 1e-3, steps * 1e-3, record=record)


@pytest.mark.usefixtures("engine")
@pytest.mark.parametrize(
    "name", ["a.b.c", "der(x)", "x[1,2]", 'say "so"', "two\nlines", "x;y", " ", "ß·λ", "time", "hil.tick", "-1"]
)
def test_a_name_is_recorded_saved_and_read_whatever_it_is(odd, tmp_path, name):
    result = run(odd((name, "Real", "output", None), ("other", "Integer", "output", None)))
    result.save(tmp_path / "run.csv")
    loaded = Result.load(tmp_path / "run.csv")
    assert list(loaded.signals) == [f"a.{name}", "a.other"]
    assert loaded[f"a.{name}"].tolist() == result.time.tolist()


def test_a_variable_without_a_unit_takes_that_of_its_wire_and_says_so(odd):
    fmu = odd(("y", "Real", "output", "rad"), ("u", "Real", "input", None))
    result = simulate(SystemStructure([Component("a", fmu), Component("b", fmu)], [Wire("a.y", "b.u")]), 1e-3, 2e-3)
    assert result.metadata["messages"] == {"b": ["warning: u declares no unit and is taken to be in rad"]}


def test_a_dotted_name_can_be_wired_and_driven(odd):
    fmu = odd(("p.u.x", "Real", "input", None), ("q.y", "Real", "output", None))
    system = SystemStructure(
        [Component("a", fmu), Component("b", fmu)], [Wire("a.q.y", "b.p.u.x")], [Signal("a.p.u.x", float)]
    )
    assert len(simulate(system, 1e-3, 2e-3).signals) == 2


@pytest.mark.usefixtures("engine")
def test_string_outputs_are_told_and_not_recorded(odd):
    result = run(odd(REAL, ("label", "String", "output", None), ("text", "String", "parameter", None)), text="hé")
    assert list(result.signals) == ["a.y"]
    assert result.metadata["messages"] == {"a": ["warning: String outputs are not recorded: label"]}
    with pytest.raises(UserError, match=r"^the output a\.label cannot be recorded, it is a String$"):
        run(odd(REAL, ("label", "String", "output", None)), record=["a.label"])
    strings = odd(("in", "String", "input", None), ("out", "String", "output", None))
    with pytest.raises(UserError, match="must join numbers or Booleans, found String"):
        run(strings, wires=[Wire("a.out", "a.in")])
    with pytest.raises(UserError, match="cannot follow a function of time, it is a String"):
        run(strings, signals=[Signal("a.in", float)])


@pytest.mark.parametrize("value", [1.0, True, "nul\0"])
def test_a_start_value_of_the_wrong_type_for_a_text_is_refused(odd, value):
    with pytest.raises(UserError, match=r"a\.text must be a text, found"):
        run(odd(REAL, ("text", "String", "parameter", None)), text=value)


@pytest.mark.usefixtures("engine")
@pytest.mark.parametrize("where", [DO_STEP, GET_REAL])
@pytest.mark.parametrize(
    ("status", "words"),
    [
        (2, "discard"),
        (3, "error"),
        (4, "fatal"),
        (5, "pending"),
        (6, "the status 6, which FMI does not know"),
        (-1, "status -1"),
    ],
)
def test_a_status_that_is_no_success_fails_with_the_rows_kept(odd, status, words, where):
    with pytest.raises(SimulationError) as failure:
        run(odd(REAL), status=status, at=3, where=where)
    assert words in str(failure.value)
    assert "\n" not in str(failure.value)
    assert failure.value.result.time.tolist() == pytest.approx([0.0, 1e-3, 2e-3])


@pytest.mark.parametrize("status", [-1, 3, 7])
def test_a_failure_while_it_begins_is_one_too(odd, status):
    with pytest.raises(SimulationError, match="exitInitializationMode returned"):
        run(odd(REAL), status=status, where=EXIT_INITIALIZATION)


def test_the_cause_is_not_lost_among_many_messages(odd):
    with pytest.raises(SimulationError) as failure:
        run(odd(REAL), status=3, chatter=500, at=1)
    messages = failure.value.result.metadata["messages"]["a"]
    assert (len(messages), messages[-1]) == (200, "error: ")


@pytest.mark.parametrize("identifier", ["../../evil", "/tmp/evil", "a b", "ä", ""])
def test_a_library_outside_its_folder_is_refused(odd, identifier):
    with pytest.raises(UserError, match=r"C identifier|not a valid FMU"):
        describe(odd(REAL, identifier=identifier))


def test_a_model_description_has_no_entities(tmp_path):
    path = tmp_path / "entities.fmu"
    bomb = '<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/passwd">]><fmiModelDescription>&x;</fmiModelDescription>'
    for encoding in ("utf-8", "utf-16"):
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("modelDescription.xml", bomb.encode(encoding))
        with pytest.raises(UserError, match="a model description has no document type"):
            describe(path)


# On a device

ANGLES = (("theta", "Real", "input", "rad"), ("delta", "Real", "input", "rad"))
MODE, VOLTAGE = ("mode", "Mode", "output", None), ("voltage", "Real", "output", "V")


def on_device(fmus, fmu, folder, duration=0.01, **start):
    device = rig.Between(rig.lockstep(fmus))
    loop = rig.Loop(device, Component("controller", fmu, start), rig.settings_of(duration), folder / "run")
    try:
        return device, loop.run()
    finally:
        loop.log.discard()


def test_a_foreign_controller_runs_with_its_own_outputs_whatever_they_are_called(odd, fmus, tmp_path):
    names = ("tick", "current", "number", "a.b,c")
    others = [(name, "Real", "output", None) for name in names]
    fmu = odd(*ANGLES, VOLTAGE, MODE, *others, ("label", "String", "output", None))
    device, report = on_device(fmus, fmu, tmp_path)
    assert (report.stop, report.failures) == ("complete", ())
    assert {f"controller.{name}" for name in names} <= report.result.signals.keys()
    assert "controller.label" not in report.result.signals
    assert "String outputs" in report.result.metadata["messages"]["controller"][0]
    assert len(device.voltages) == 10


def test_a_foreign_controllers_outputs_and_driven_inputs_are_logged_each_in_its_column(odd):
    others = [("flag", "Boolean", "output", None), ("count", "Integer", "output", None)]
    inputs = [("level", "Integer", "input", None), ("rate", "Real", "input", "Hz")]
    component = Component("controller", odd(*ANGLES, *others, *inputs, VOLTAGE, MODE))
    controller = ControllerFmu(component, 1e-3, ["level", "rate"])
    controller.follow({"level": [7, 8], "rate": [0.5, 2.5]})
    controller.prepare()
    count, mode = (controller.instance.variables[name].valueReference for name in ("count", "mode"))
    whole = {"flag": 0, "count": count, "mode": mode}
    try:
        rows = [controller.begin(0.0, 0.0)]
        controller.command(0.0, 0.0, 1)
        rows.append(controller.outputs())
        first, second = (
            dict(zip(controller.layout.reals + controller.layout.integers, row, strict=True)) for row in rows
        )
        assert first == {**whole, "voltage": 0.0, "rate": 0.5, "level": 7}
        assert second == {**whole, "voltage": 0.001, "rate": 2.5, "level": 8}  # this FMU's real numbers are its time
    finally:
        controller.close()


@pytest.mark.parametrize(
    ("variables", "start", "problem"),
    [
        (
            (*ANGLES, ("voltage", "String", "output", None), MODE),
            {},
            "voltage must be a real output in V, found String",
        ),
        (
            (*ANGLES, ("voltage", "Real", "output", "mV"), MODE),
            {},
            "voltage must be a real output in V, found .* in mV",
        ),
        (
            (ANGLES[0], ("delta", "Real", "input", "deg"), VOLTAGE),
            {},
            "delta must be a real input in rad, found .* in deg",
        ),
        ((ANGLES[0], VOLTAGE), {}, "no variable named 'delta'"),
        ((*ANGLES, VOLTAGE, ("mode", "Real", "output", None)), {}, "mode must be an Enumeration with the item fault"),
        ((*ANGLES, VOLTAGE, ("mode", "Bare", "output", None)), {}, "mode must be an Enumeration with the item fault"),
        ((*ANGLES, VOLTAGE), {"status": -3, "at": 1}, "doStep.* the status -3"),
        ((*ANGLES, VOLTAGE), {"status": 3, "where": GET_REAL, "at": 1}, "fmi2GetReal returned error"),
        ((*ANGLES, VOLTAGE), {"status": 5, "where": EXIT_INITIALIZATION}, "exitInitializationMode returned pending"),
    ],
)
def test_what_a_controller_lacks_is_found_before_the_device_is_touched(odd, fmus, tmp_path, variables, start, problem):
    device = rig.Between(rig.lockstep(fmus))
    controller = Component("controller", odd(*variables), start)
    with pytest.raises(UserError, match=problem) as caught:
        rig.Loop(device, controller, rig.settings_of(0.01), tmp_path / "run").run()
    rig.one_sentence(caught.value)
    assert device.calls in ([], ["close"])
    assert list(tmp_path.glob("*.rows")) == []


def test_a_controller_for_one_instance_is_not_rehearsed_and_runs(odd, fmus, tmp_path):
    assert on_device(fmus, odd(*ANGLES, VOLTAGE, once=True), tmp_path)[1].stop == "complete"


def test_a_replay_that_fails_keeps_its_head(odd, fmus, tmp_path):
    fmu = odd(*ANGLES, VOLTAGE, MODE)
    result = on_device(fmus, fmu, tmp_path)[1].result
    start = {"controller": {"status": 3, "at": 4}}
    broken = Result(result.time, result.signals, result.units, {**result.metadata, "start_values": start})
    with pytest.raises(SimulationError, match=r"^at t = 0\.003 s of the replay: controller: doStep"):
        replay(broken, fmu)


def test_a_log_chooses_no_file_but_its_own_in_the_users_folder(odd, fmus, tmp_path):
    fmu = odd(*ANGLES, VOLTAGE, MODE)
    result = on_device(fmus, fmu, tmp_path)[1].result
    assert controller_of(result, None, tmp_path) == fmu
    used = result.metadata["fmus"]["controller"]
    for file in (str(fmu), "../Odd.fmu", "a/Odd.fmu", "..", "C:Odd.fmu", 3, None):
        other = {**result.metadata, "fmus": {"controller": {**used, "file": file}}}
        with pytest.raises(UserError, match=r"fmus\.controller\.file must be"):
            controller_of(Result(result.time, result.signals, result.units, other), None, tmp_path)
    odd(*ANGLES, VOLTAGE, MODE, guid="{another}")
    with pytest.raises(
        UserError, match=r"is not the FMU that the log was made with, its GUID is \{another\}.*--controller"
    ):
        controller_of(result, None, tmp_path)
    assert controller_of(result, fmu, tmp_path) == fmu  # the user's own word


# A call that never returns

HANGING = """
import os
import sys
from pathlib import Path
from cosim import interrupts
from cosim.studies import engine
from cosim.hil.loop import Loop
from cosim.master import simulate
from cosim.structure import Component, SystemStructure
from cosim.scenario import Scenario
from tests.cosim.hil import rig
interrupts.GRACE = 0.2
what, fmu, fmus, folder = sys.argv[1], *map(Path, sys.argv[2:])
def go(*_):
    os.write(1, b"begins" + os.linesep.encode())
    simulate(SystemStructure([Component("a", fmu, {"hang": 1, "at": 3})]), 1e-3, 1.0)
class Noted(rig.Between):
    def safe_stop(self, reason):
        print("0 V:", reason, self.device.safe_stop(reason), flush=True)
        return []
if what == "run":
    go()
elif what == "compare":
    engine.run_scenario = go
    engine.run_all([engine.Job(k, Scenario()) for k in range(2)], fmus, print, workers=2)
else:
    controller = Component("controller", fmu, {"hang": 1, "at": 3})
    os.write(1, b"begins" + os.linesep.encode())
    Loop(Noted(rig.lockstep(fmus)), controller, rig.settings_of(1.0), folder / "run").run()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Ctrl-C is sent with POSIX signals")
def test_a_second_interrupt_ends_a_process_whose_fmu_hangs(odd, fmus, tmp_path):
    fmu = odd(*ANGLES, VOLTAGE)
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    hung = {
        what: subprocess.Popen(
            [sys.executable, "-c", HANGING, what, str(fmu), str(fmus), str(tmp_path)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "TMPDIR": str(temporary)},
        )
        for what in ("run", "compare", "hil")
    }
    try:
        for process in hung.values():
            assert process.stdout is not None
            assert process.stdout.readline() == "begins\n"
        time.sleep(1.5)
        for process in hung.values():
            process.send_signal(signal.SIGINT)
        for process in hung.values():
            assert process.stderr is not None
            assert "Ctrl-C once more ends the process" in process.stderr.readline()
            assert process.poll() is None
            process.send_signal(signal.SIGINT)
        said = {what: process.communicate(timeout=20) for what, process in hung.items()}
    finally:
        for process in hung.values():
            process.kill()
    assert {process.returncode for process in hung.values()} == {128 + signal.SIGINT}
    assert all("ended while an FMU was computing" in errors for _, errors in said.values())
    assert "0 V: ended while the controller was computing []" in said["hil"][0]
    assert f"the rows are in {tmp_path / 'run.rows'}" in said["hil"][1]
    assert list(temporary.glob("qube-ihc-*")) == []


def test_the_values_of_a_foreign_fmu_may_be_anything(odd):
    result = run(odd(REAL, ("n", "Mode", "output", None)))
    assert result["a.n"].dtype == np.int64
