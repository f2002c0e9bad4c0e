"""The C interface of both native FMUs, called as a C host calls it: what is refused, why, and that it changes nothing."""

import csv
import ctypes
import math
import shutil
import struct
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tests.fmu_export.conftest import CONTROLLER, DEMANDING, PLANT, STEP, run

EXCHANGE, STEPPED = 0, 1
OK, WARNING, DISCARD, ERROR = 0, 1, 2, 3
NAN, INFINITY = math.nan, math.inf

# States (phases) of an instance, named as in the messages, and the functions that the standard allows in them.

BORN, INITIALIZING, READY, ENDED = "instantiated", "initialization mode", "step", "terminated"
EVENT, CONTINUOUS = "event mode", "continuous-time mode"
PHASES = {
    STEPPED: (BORN, INITIALIZING, READY, ENDED),
    EXCHANGE: (BORN, INITIALIZING, EVENT, CONTINUOUS, ENDED),
}
KINDS = [(PLANT, STEPPED), (PLANT, EXCHANGE), (CONTROLLER, STEPPED)]
EVERYWHERE = [(name, kind, phase) for name, kind in KINDS for phase in PHASES[kind]]


def transcribed():
    """Return the tables of FMI 2.0.5, sections 3.2.3 and 4.2.4: by kind and function the states that allow it.

    A number in a cell is a condition; conditions on variables are tested below. The states error and fatal are left out: a
    refused call leaves an instance in the state that it was in.
    """
    tables, kind, states = {EXCHANGE: {}, STEPPED: {}}, EXCHANGE, []
    for row in csv.reader((Path(__file__).parent / "allowed_calls.csv").read_text().splitlines()):
        if row and row[0] in ("model exchange", "co-simulation"):
            kind, states = (EXCHANGE if row[0] == "model exchange" else STEPPED), row[1:]
        elif row:
            tables[kind][row[0]] = {state for state, cell in zip(states, row[1:], strict=True) if cell}
    return tables


TABLES = transcribed()
UNSUPPORTED = ("GetString", "SetString", "CancelStep", "SetRealInputDerivatives", "GetRealOutputDerivatives")
WITHOUT_INSTANCE = ("GetTypesPlatform", "GetVersion", "Instantiate", "FreeInstance")
FUNCTIONS = [f for f in {**TABLES[EXCHANGE], **TABLES[STEPPED]} if f not in (*UNSUPPORTED, *WITHOUT_INSTANCE)]
MORE = {(function, BORN) for function in ("GetReal", "GetInteger", "GetBoolean")}
"""Allowed beyond the standard, since PyFMI and others do it: start values can be read before initialization."""


def allowed(kind, function, phase):
    return phase in TABLES[kind].get(function, ()) or (function, phase) in MORE


def bring(instance, phase):
    """Bring a new instance into a phase."""
    if phase != BORN:
        instance.setup()
        instance.done("EnterInitializationMode")
    if phase not in (BORN, INITIALIZING):
        instance.done("ExitInitializationMode")
    if phase == CONTINUOUS:
        instance.done("EnterContinuousTimeMode")
    if phase == ENDED:
        instance.done("Terminate")
    return instance


def row(kind, *values):
    return (kind * len(values))(*values)


def real(*values):
    return row(ctypes.c_double, *values)


def whole(*values):
    return row(ctypes.c_int, *values)


def references(*values):
    return row(ctypes.c_uint, *values)


def faultless(instance):
    """Arguments of every function that are right in themselves."""
    state = instance.save()
    serialized = instance.serialize(state)
    choice = {PLANT: "motor_model", CONTROLLER: "law"}[instance.description.modelName]
    switch = {PLANT: "back_emf", CONTROLLER: "enabled"}[instance.description.modelName]
    choice, switch = references(instance.reference(choice)), references(instance.reference(switch))
    count = instance.description.numberOfContinuousStates
    states, other = real(0.1, 0.2, 0.3, 0.4), references(instance.reference(instance.output_names[0]))
    first, flag, flags = references(0), ctypes.c_int(), ctypes.c_int()
    return {
        "SetDebugLogging": (1, 0, None),
        "SetupExperiment": (0, 0.0, 0.5, 1, 1.0),
        **{name: (first, 1, real(0.25)) for name in ("GetReal", "SetReal")},
        **{name: (choice, 1, whole(1)) for name in ("GetInteger", "SetInteger")},
        **{name: (switch, 1, whole(0)) for name in ("GetBoolean", "SetBoolean")},
        **{name: (first, 1, row(ctypes.c_char_p, b"1")) for name in ("GetString", "SetString")},
        "GetFMUstate": (ctypes.byref(ctypes.c_void_p()),),
        "SetFMUstate": (state,),
        "FreeFMUstate": (ctypes.byref(ctypes.c_void_p()),),
        "SerializedFMUstateSize": (state, ctypes.byref(ctypes.c_size_t())),
        "SerializeFMUstate": (state, ctypes.create_string_buffer(len(serialized)), len(serialized)),
        "DeSerializeFMUstate": (serialized, len(serialized), ctypes.byref(ctypes.c_void_p())),
        "GetDirectionalDerivative": (other, 1, first, 1, real(1.0), real(0.0)),
        "DoStep": (0.0, STEP, 1),
        **dict.fromkeys(("SetRealInputDerivatives", "GetRealOutputDerivatives"), (first, 1, whole(1), real(0.0))),
        "NewDiscreteStates": (ctypes.create_string_buffer(32),),
        "CompletedIntegratorStep": (1, ctypes.byref(flag), ctypes.byref(flags)),
        "SetTime": (0.5,),
        **{f"{do}ContinuousStates": (states, count) for do in ("Get", "Set", "GetNominalsOf")},
        "GetDerivatives": (states, count),
        **{f"Get{kind}Status": (i, real(0.0)) for kind, i in (("", 0), ("Integer", 1), ("String", 1), ("Real", 2))},
        "GetBooleanStatus": (3, whole(0)),
        "GetEventIndicators": (real(0.0), 0),
    }


def arguments(instance, function):
    return faultless(instance).get(function, ())


@pytest.mark.parametrize(("name", "kind", "phase"), EVERYWHERE)
def test_calls_are_refused_and_change_nothing_where_the_standard_has_it(name, kind, phase, native):
    instance = bring(native(name, kind), phase)
    known, before = faultless(instance), instance.everything()
    functions = [function for function in FUNCTIONS if not allowed(kind, function, phase)]
    for function in functions:
        message = instance.refused(function, *known.get(function, ()))
        assert f"fmi2{function} is " in message
        reasons = f"not allowed in the state '{phase}'", "for model exchange", "for co-simulation"
        assert message.endswith(reasons), function
        assert instance.everything() == before, function
    assert len(functions) > 10


def test_model_exchange_calls_of_a_stepped_instance_are_refused_with_the_cause(native):
    instance = bring(native(PLANT), ENDED)
    message = instance.refused("GetContinuousStates", *arguments(instance, "GetContinuousStates"))
    assert message == "fmi2GetContinuousStates is for model exchange"


@pytest.mark.parametrize(("name", "kind", "phase"), EVERYWHERE)
def test_calls_work_where_the_standard_has_it(name, kind, phase, native):
    instance = bring(native(name, kind), phase)
    state, known = instance.save(), faultless(instance)
    for function in FUNCTIONS:
        if not allowed(kind, function, phase):
            continue
        if function == "EnterInitializationMode":
            instance.setup()
        if function in ("SetInteger", "SetBoolean") and phase not in (BORN, INITIALIZING) and name == PLANT:
            continue  # fixed
        if function == "GetDirectionalDerivative" and name == CONTROLLER:
            assert "has no directional derivatives" in instance.refused(function, *known[function])
            continue
        if function in ("GetIntegerStatus", "GetStringStatus"):
            assert instance.call(function, *known[function]) == DISCARD
            continue
        instance.done(function, *known.get(function, ()))
        instance.done("SetFMUstate", state)
    assert instance.log == [] or name == CONTROLLER


@pytest.mark.parametrize("function", UNSUPPORTED)
def test_unsupported_calls_say_so_in_every_state(function, name, native):
    for phase in PHASES[STEPPED]:
        instance = bring(native(name), phase)
        known, before = arguments(instance, function), instance.everything()
        assert f"fmi2{function}: " in instance.refused(function, *known)
        assert instance.everything() == before


def test_calls_without_an_instance_are_refused(name, native):
    instance = native(name)
    known, library = faultless(instance), instance.library
    for function in (*FUNCTIONS, *UNSUPPORTED):
        assert getattr(library, f"fmi2{function}")(None, *known.get(function, ())) == ERROR, function
    library.fmi2FreeInstance(None)
    assert instance.log == []


# Instantiation


def declined(instance):
    """The sentence of an FMU that would not be instantiated."""
    assert instance.component is None
    ((status, category, message),) = instance.log
    assert (status, category) == (ERROR, "logStatusError")
    return message


@pytest.mark.parametrize("guid", [None, "{12345678-0000-0000-0000-000000000000}", "", "x" * 5000])
def test_another_guid_is_refused(guid, name, native):
    instance = native(name, guid=guid if guid != "" else " ")
    message = declined(instance)
    assert "the GUID must be {" in message
    assert ("none" if guid is None else guid[:20]) in message


@pytest.mark.parametrize("other", [None, ""])
def test_an_instance_must_have_a_name(other, name, native):
    assert "an instance must have a name" in declined(native(name, name=other))


@pytest.mark.parametrize(("name", "kind"), [(CONTROLLER, EXCHANGE), (PLANT, 2), (CONTROLLER, -1)])
def test_a_kind_that_the_unit_does_not_have_is_refused(name, kind, native):
    assert name in declined(native(name, kind))


def test_an_unknown_kind_is_not_called_model_exchange(native):
    assert "model exchange" not in declined(native(CONTROLLER, 2))


def test_a_host_without_callbacks_gets_no_instance(name, native):
    instance = native(name)
    make, texts = instance.library.fmi2Instantiate, instance.arguments
    assert make(*texts[:4], None, 0, 0) is None
    instance.callbacks.logger = type(instance.callbacks.logger)()
    assert make(*texts[:4], ctypes.byref(instance.callbacks), 0, 0) is None


@pytest.fixture
def elsewhere(native_folders, tmp_path):
    """Copy the resources of an FMU into a folder of any name."""

    def copy(name, folder):
        target = tmp_path / folder / "resources"
        shutil.copytree(native_folders[name] / "resources", target)
        return target

    return copy


FORMS = {
    "URI": lambda path: path.as_uri(),
    "URI/": lambda path: path.as_uri() + "/",
    "one slash": lambda path: path.as_uri().replace("file://", "file:"),
    "localhost": lambda path: path.as_uri().replace("file://", "file://localhost"),
    "only escapes": lambda path: "file:///" + "".join(f"%{byte:02x}" for byte in str(path)[1:].encode()),
    "plain": str,
    "plain/": lambda path: f"{path}/",
}


@pytest.mark.parametrize("folder", ["plain", "with spaces in it", "100%", "a%20b", "Grüße, 世界", "#?&+;=@[]'$!"])
@pytest.mark.parametrize("form", FORMS)
def test_resources_are_found_in_any_folder(form, folder, name, elsewhere, native):
    location = FORMS[form](elsewhere(name, folder))
    assert native(name, location=location).initialize().outputs() == native(name).initialize().outputs()


def test_missing_resource_location_is_refused(name, native):
    message = declined(native(name, location=None))
    assert "resource location" in message
    assert "none" in message


@pytest.mark.parametrize(
    "location", ["file:///nowhere/100%25", "/nowhere/100%", "http://example.org/x", "%s%n%s%n", "."]
)
def test_a_location_without_start_values_is_refused_with_the_path(location, name, native):
    message = declined(native(name, location=location))
    assert "cannot read" in message
    path = location.replace("file://", "").replace("%25", "%")
    assert f"{path}/start_values.bin" in message


def test_a_path_that_is_too_long_is_refused(name, native):
    assert "resource location" in declined(native(name, location="file:///" + "x" * 5000))


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_long_path_is_reported_in_valid_text(native):
    assert "/é" in declined(native(PLANT, location="/" + "é" * 200))


HEAD = 80  # bytes before the numbers

DAMAGES = {
    "empty": lambda data: b"",
    "head only": lambda data: data[:HEAD],
    "half of the head": lambda data: data[:40],
    "one byte short": lambda data: data[:-1],
    "one number short": lambda data: data[:-8],
    "one byte more": lambda data: data + b"\0",
    "another beginning": lambda data: b"FMUstars" + data[8:],
    "another format": lambda data: data[:8] + b"\1" + data[9:],
    "another count": lambda data: data[:12] + b"\1\0\0\0" + data[16:],
    "GUID without an end": lambda data: data[:16] + b"x" * 64 + data[HEAD:],
}


def parts(data):
    """Return what is before the names, and the names, each with a zero behind it."""
    (count,) = struct.unpack_from("<I", data, 12)
    return data[: HEAD + 8 * count], data[HEAD + 8 * count + 4 :]


def with_names(data, names, size=None):
    """Return start values with other names."""
    return parts(data)[0] + struct.pack("<I", len(names) if size is None else size) + names


def renamed(data, name):
    """Return start values with another first name."""
    return with_names(data, name + b"\0" + parts(data)[1].split(b"\0", 1)[1])


DAMAGES |= {
    "no names": lambda data: with_names(data, b""),
    "names without an end": lambda data: with_names(data, parts(data)[1][:-1]),
    "a name beyond the end": lambda data: with_names(data, parts(data)[1][:-1] + b"x"),
    "a name too many": lambda data: renamed(data, b"a\0b"),
    "a name too few": lambda data: with_names(data, parts(data)[1].split(b"\0", 1)[1]),
    "more names than bytes": lambda data: with_names(data, parts(data)[1], len(parts(data)[1]) + 1),
    "fewer names than bytes": lambda data: with_names(data, parts(data)[1], len(parts(data)[1]) - 1),
    "no end of names": lambda data: with_names(data, parts(data)[1], 2**32 - 1),
    "a name too long": lambda data: renamed(data, b"x" * 801),
    "a line feed": lambda data: renamed(data, b"a\nb"),
    "DEL": lambda data: renamed(data, b"a\x7f"),
    "a control character of two bytes": lambda data: renamed(data, b"a\xc2\x85"),
    "half a character": lambda data: renamed(data, b"a\xc3"),
    "half a character of three bytes": lambda data: renamed(data, b"\xe2\x82"),
    "the rest of a character": lambda data: renamed(data, b"\x9f"),
    "an overlong zero": lambda data: renamed(data, b"\xc0\x80"),
    "an overlong slash": lambda data: renamed(data, b"\xe0\x80\xaf"),
    "a surrogate": lambda data: renamed(data, b"\xed\xa0\x80"),
    "beyond Unicode": lambda data: renamed(data, b"\xf4\x90\x80\x80"),
    "no lead byte": lambda data: renamed(data, b"\xf8\x88\x80\x80"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_start_values_are_refused(damage, name, elsewhere, native):
    folder = elsewhere(name, "damaged")
    file = folder / "start_values.bin"
    file.write_bytes(DAMAGES[damage](file.read_bytes()))
    message = declined(native(name, location=folder.as_uri()))
    assert "this FMU's start values must be in its resources" in message


@pytest.mark.parametrize("text", ["Stoß 50 %s \\ € 𝛿", "x" * 800, "\u00a0"])
def test_messages_have_the_names_of_the_file(text, native, elsewhere):
    folder = elsewhere(PLANT, "renamed")
    data = (folder / "start_values.bin").read_bytes()
    (folder / "start_values.bin").write_bytes(renamed(data, text.encode()))
    instance = native(PLANT, location=folder.as_uri())
    assert instance.refused(*instance.setting(voltage=NAN)) == f"{text} must be finite, found nan at t = 0 s"


def test_start_values_of_the_other_unit_are_refused(native, elsewhere):
    message = declined(native(PLANT, location=elsewhere(CONTROLLER, "other").as_uri()))
    assert "this FMU's start values must be in its resources" in message


def test_a_folder_in_place_of_the_file_is_refused(name, native, elsewhere):
    folder = elsewhere(name, "folder")
    (folder / "start_values.bin").unlink()
    (folder / "start_values.bin").mkdir()
    assert "start_values.bin" in declined(native(name, location=folder.as_uri()))


@pytest.mark.parametrize(
    ("variable", "value"),
    [
        ("voltage", NAN),
        ("m_p", INFINITY),
        ("solver_step", 1.0),
        ("encoder_counts", -1.0),
        ("motor_model", 3.0),
        ("back_emf", 2.0),
        ("noise_seed", 1e300),
        ("encoder_counts", 2.0**31),
        ("noise_seed", 1.5),
        ("back_emf", 0.5),
    ],
)
def test_a_start_value_out_of_range_is_refused(variable, value, native, elsewhere):
    folder = elsewhere(PLANT, "out of range")
    data = bytearray((folder / "start_values.bin").read_bytes())
    struct.pack_into("<d", data, HEAD + 8 * native(PLANT).reference(variable), value)
    (folder / "start_values.bin").write_bytes(data)
    assert f"the start value of {variable} must" in declined(native(PLANT, location=folder.as_uri()))


# Pointers, references and types


def pointers_missing(instance):
    """Calls whose only fault is a NULL."""
    state, serialized = ctypes.c_void_p(), b"x" * 64
    one, number, flag = references(0), real(0.0), ctypes.byref(ctypes.c_int())
    of_variables = [
        (f"{do}{kind}", bad)
        for do in ("Get", "Set")
        for kind in ("Real", "Integer", "Boolean")
        for bad in ((None, 1, number), (one, 1, None))
        if (instance.kind, do) != (EXCHANGE, "Set") or kind == "Real"  # others cannot be set in continuous-time mode
    ]
    full = (one, 1, one, 1, number, real(0.0))
    common = [
        *of_variables,
        ("SetDebugLogging", (1, 1, None)),
        *((name, (None,)) for name in ("GetFMUstate", "SetFMUstate", "FreeFMUstate")),
        ("SerializedFMUstateSize", (None, ctypes.byref(ctypes.c_size_t()))),
        ("SerializedFMUstateSize", (instance.save(), None)),
        ("SerializeFMUstate", (None, serialized, 64)),
        ("SerializeFMUstate", (instance.save(), None, 64)),
        ("DeSerializeFMUstate", (None, 64, ctypes.byref(state))),
        ("DeSerializeFMUstate", (serialized, 64, None)),
        *(("GetDirectionalDerivative", (*full[:i], None, *full[i + 1 :])) for i in (0, 2, 4, 5)),
    ]
    if instance.kind == STEPPED:
        return common
    return [
        *common,
        ("CompletedIntegratorStep", (1, None, flag)),
        ("CompletedIntegratorStep", (1, flag, None)),
        *((f"{do}ContinuousStates", (None, 4)) for do in ("Get", "Set", "GetNominalsOf")),
        ("GetDerivatives", (None, 4)),
    ]


@pytest.mark.parametrize(("name", "kind"), KINDS)
def test_a_missing_pointer_is_refused(name, kind, native):
    instance = bring(native(name, kind), READY if kind == STEPPED else CONTINUOUS)
    calls, before = pointers_missing(instance), instance.everything()
    for function, given in calls:
        message = instance.refused(function, *given)
        assert "a pointer is missing" in message or "the pointer is no state of this FMU" in message
        assert f"fmi2{function}: " in message
        assert instance.everything() == before


def test_event_information_needs_a_pointer(native):
    assert "a pointer is missing" in bring(native(PLANT, EXCHANGE), EVENT).refused("NewDiscreteStates", None)


def test_nothing_may_be_asked_for_without_pointers(name, native):
    instance = native(name).initialize()
    for function in (
        "GetReal",
        "GetInteger",
        "GetBoolean",
        "GetString",
        "SetReal",
        "SetInteger",
        "SetBoolean",
        "SetString",
    ):
        instance.done(function, None, 0, None)


def test_unknown_references_and_wrong_types_are_refused(name, native):
    instance = native(name).initialize()
    count, before = len(instance.variables), instance.everything()
    types = {v.valueReference: instance.type(v.name) for v in instance.variables.values()}
    assert sorted(types) == list(range(count))
    for kind in ("Real", "Integer", "Boolean"):
        for reference in (*range(count), count, count + 1, 2**31, 2**32 - 1):
            if types.get(reference) != kind:
                for do in ("Get", "Set"):
                    given = references(reference), 1, real(0.0) if kind == "Real" else whole(0)
                    message = instance.refused(f"{do}{kind}", *given)
                    assert message == f"no {kind} variable has the value reference {reference}"
    assert instance.everything() == before


def test_a_refused_derivative_leaves_the_hosts_memory_alone(native):
    instance, numbers = native(PLANT).initialize(), real(77.0, 77.0)
    unknown = references(instance.reference("theta"), 9999)
    instance.refused("GetDirectionalDerivative", unknown, 2, references(0), 1, real(1.0), numbers)
    assert tuple(numbers) == (77.0, 77.0)


# Values

STATES = ("theta", "delta", "theta_dot", "delta_dot")
PHASES_OF_ROLE = {
    "input": {BORN, INITIALIZING, READY, EVENT, CONTINUOUS},
    "tunable": {BORN, INITIALIZING, READY, EVENT},
    "fixed": {BORN, INITIALIZING},
    "output": set(),
    "local": set(),
}


def role(variable):
    return variable.variability if variable.causality == "parameter" else variable.causality


@pytest.mark.parametrize(("name", "kind", "phase"), EVERYWHERE)
def test_every_variable_can_be_set_in_its_states_only(name, kind, phase, native):
    instance = bring(native(name, kind), phase)
    before = instance.everything()
    for variable in instance.variables.values():
        is_output, is_real = role(variable) in ("output", "local"), variable.type == "Real"
        is_state = variable.name in STATES and phase == CONTINUOUS
        call = instance.setting(**{variable.name: 0 if is_output and not is_state else instance.get(variable.name)[0]})
        if (phase in PHASES_OF_ROLE[role(variable)] and (is_real or phase != CONTINUOUS)) or is_state:
            instance.done(*call)
        else:
            message = instance.refused(*call)
            if phase == ENDED or (phase == CONTINUOUS and not is_real):
                assert f"is not allowed in the state '{phase}'" in message
            elif is_output:
                assert message == f"{variable.name} is an output and cannot be set"
            else:
                assert f"{variable.name} is a {role(variable)} parameter" in message
    assert instance.everything() == before


def test_outputs_cannot_be_read_before_initialization(name, native):
    instance = native(name)
    for output in instance.output_names:
        one, number = references(instance.reference(output)), real(0.0)
        message = instance.refused(f"Get{instance.type(output)}", one, 1, number)
        assert message == f"outputs are defined from initialization on, asked for {output} before it"


def just_outside(variable):
    """Values next to the limits of a parameter, and the limits."""
    if variable.type == "Enumeration":
        items = len(variable.declaredType.items)
        return [0, items + 1, -(2**31), 2**31 - 1], [1, items]
    limits = [(float(limit), away) for limit, away in ((variable.min, -1), (variable.max, 1)) if limit is not None]
    if variable.type == "Integer":
        return [int(limit) + away for limit, away in limits], [int(limit) for limit, _ in limits]
    return [math.nextafter(limit, away * INFINITY) for limit, away in limits], [limit for limit, _ in limits]


def test_every_parameter_is_held_within_its_limits(name, native):
    instance, limited = native(name), 0
    for variable in instance.variables.values():
        if variable.causality != "parameter" or variable.type == "Boolean":
            continue
        outside, edges = just_outside(variable)
        limited += bool(outside)
        for value in edges:
            instance.set(**{variable.name: value})
        before = instance.everything()
        for value in outside:
            message = instance.refused(*instance.setting(**{variable.name: value}))
            assert message.startswith(f"{variable.name} must lie in [")
            assert f"found {value:g}" in message
        assert instance.everything() == before
    assert limited >= 20


@pytest.mark.parametrize("phase", PHASES[STEPPED][:3])
@pytest.mark.parametrize("bad", [NAN, INFINITY, -INFINITY])
def test_non_finite_numbers_are_refused(bad, phase, name, native):
    instance = bring(native(name), phase)
    before = instance.everything()
    for variable in instance.variables.values():
        if variable.type == "Real" and phase in PHASES_OF_ROLE[role(variable)]:
            if name == CONTROLLER and variable.causality == "input":
                continue
            message = instance.refused(*instance.setting(**{variable.name: bad}))
            assert f"{variable.name} must be finite, found {bad}" in message.replace("-nan", "nan")
    assert instance.everything() == before


def test_every_number_but_zero_is_true(native):
    instance = native(CONTROLLER)
    for number in (1, -1, 7, -(2**31)):
        instance.set(enabled=False)
        instance.set(enabled=number)
        assert instance.get("enabled") == (1,)


TOGETHER = {
    "one of them not finite": (PLANT, BORN, {"voltage": 1.0, "theta_0": 1.0, "pendulum_torque": NAN}),
    "one of them out of range": (PLANT, INITIALIZING, {"m_p": 0.1, "solver_step": 1.0, "L_p": 0.2}),
    "one of them an output": (PLANT, READY, {"voltage": 1.0, "theta": 1.0}),
    "one of them fixed": (PLANT, READY, {"voltage": 1.0, "m_p": 0.1}),
    "one Integer out of range": (PLANT, BORN, {"noise_seed": 7, "encoder_counts": -1}),
    "one of them fixed, one tunable": (CONTROLLER, READY, {"voltage_limit": 1.0, "theta": 1.0, "k_lin_1": 1.0}),
    "contradicting tunables": (CONTROLLER, READY, {"voltage_limit": 1.0, "a_min": 2.0, "b_max": 1.5}),
    "an input and contradicting tunables": (CONTROLLER, READY, {"theta": 1.0, "a_min": 2.0, "b_max": 1.5}),
}


@pytest.mark.parametrize("case", TOGETHER)
def test_several_variables_are_set_together_or_not_at_all(case, native):
    name, phase, values = TOGETHER[case]
    instance = bring(native(name), phase)
    before = instance.everything()
    assert instance.refused(*instance.setting(**values))
    assert instance.everything() == before


def test_an_unknown_reference_among_others_sets_nothing(name, native):
    instance = native(name).initialize()
    before = instance.everything()
    instance.refused("SetReal", references(0, 1, 9999), 3, real(0.5, 0.25, 0.125))
    assert instance.everything() == before


# Parameters that contradict each other

CONTRADICTIONS = {
    "limits": (CONTROLLER, {"a_min": 2.0}, {"b_max": 2.0}, ["a_min must not exceed b_max", "a_min = 2 ", "b_max = 1"]),
    "angles": (CONTROLLER, {"capture_angle": 0.9}, {"capture_angle": 0.5}, ["capture_angle", "fall_back_angle", "0.9"]),
    "singular Phi": (
        CONTROLLER,
        {f"Phi_1{j}": 0.0 for j in (1, 2, 3, 4)},
        {"Phi_11": 1.0, "Phi_12": 0.5, "Phi_13": 0.25, "Phi_14": 0.125},
        ["Phi must be regular"],
    ),
    "Kalman gain": (
        CONTROLLER,
        {"velocity_source": 3, "sample_time": 2e-3},
        {"velocity_source": 1, "sample_time": 1e-3},
        ["kalman_sample_time", "sample_time = 0.002 s"],
    ),
    "inertia": (
        PLANT,
        {"J_p": 1e-12, "J_r": 1e-12, "m_p": 1.0},
        {"J_p": 3e-5, "J_r": 6e-5, "m_p": 0.024},
        ["J_p and J_r must not vanish beside", "J_r = 1e-12"],
    ),
    "nominal inertia": (
        CONTROLLER,
        {"nominal_coupling": 1.0},
        {"nominal_coupling": 0.0},
        ["the square of nominal_coupling must be below"],
    ),
}


@pytest.mark.parametrize("case", CONTRADICTIONS)
def test_contradiction_at_the_end_of_initialization_can_be_put_right(case, native):
    name, wrong, right, parts = CONTRADICTIONS[case]
    instance = bring(native(name), INITIALIZING)
    instance.set(**wrong)
    for _ in range(2):
        message = instance.refused("ExitInitializationMode")
        assert [part for part in parts if part not in message] == []
    output = instance.output_names[0]
    message = instance.refused("GetReal", references(instance.reference(output)), 1, real(0.0))
    assert [part for part in parts if part not in message] == []
    instance.set(**right)
    instance.done("ExitInitializationMode")
    assert run(instance, name, 0, 5) == run(native(name).initialize(**{**wrong, **right}), name, 0, 5)


@pytest.mark.parametrize("case", ["limits", "angles"])
def test_contradiction_by_tuning_leaves_the_old_values_in_force(case, native):
    _, wrong, _, parts = CONTRADICTIONS[case]
    instance, other = native(CONTROLLER).initialize(), native(CONTROLLER).initialize()
    run(instance, CONTROLLER, 0, 45)
    run(other, CONTROLLER, 0, 45)
    message = instance.refused(*instance.setting(**wrong))
    assert [part for part in parts if part not in message] == []
    assert "t = 0.045 s" in message
    assert instance.everything() == other.everything()
    assert run(instance, CONTROLLER, 45, 60) == run(other, CONTROLLER, 45, 60)


def test_tunables_are_judged_together(native):
    instance = native(CONTROLLER).initialize()
    instance.done(*instance.setting(a_min=2.0, b_max=3.0))
    assert instance.get("a_min", "b_max") == (2.0, 3.0)


# Steps

JUMP = "time must not jump"
LENGTH = "the communication step must be positive and finite"

STEPS = {  # unit, parameters, inputs, the step that is refused, the right one, parts of the cause
    "of no length": (PLANT, {}, {}, (3e-3, 0.0), STEP, [LENGTH, "found 0 s"]),
    "backwards": (PLANT, {}, {}, (3e-3, -STEP), STEP, [LENGTH, "-0.001 s"]),
    "of NaN": (PLANT, {}, {}, (3e-3, NAN), STEP, [LENGTH, "nan"]),
    "endless": (CONTROLLER, {}, {}, (3e-3, INFINITY), STEP, [LENGTH, "inf"]),
    "ahead": (PLANT, {}, {}, (4e-3, STEP), STEP, [JUMP, "0.003", "0.004"]),
    "back": (CONTROLLER, {}, {}, (2e-3, STEP), STEP, [JUMP, "0.003", "0.002"]),
    "a little ahead": (PLANT, {}, {}, (3e-3 + 2e-9, STEP), STEP, [JUMP]),
    "at NaN": (CONTROLLER, {}, {}, (NAN, STEP), STEP, [JUMP, "nan"]),
    "at infinity": (PLANT, {}, {}, (INFINITY, STEP), STEP, [JUMP, "inf"]),
    "too long": (PLANT, {}, {}, (3e-3, 1e6), STEP, ["must not exceed 1000000 internal steps", "1e+06 s"]),
    "longest of all": (PLANT, {}, {}, (3e-3, 1.7e308), STEP, ["must not exceed 1000000 internal steps"]),
    "delay between two steps": (
        PLANT,
        {"measurement_delay": 2e-3},
        {},
        (3e-3, 1.5e-3),
        STEP,
        ["the communication step must stay the same", "0.0015 s after 0.001 s"],
    ),
    "state without bounds": (
        PLANT,
        {},
        {"pendulum_torque": 1e300},
        (3e-3, STEP),
        STEP,
        ["the state left the range of numbers", "before the step", "pendulum_torque = 1e+300"],
    ),
    "not a part of the sample time": (
        CONTROLLER,
        {},
        {},
        (3e-3, 3e-4),
        STEP,
        ["sample_time must be a multiple", "0.001 s", "0.0003 s"],
    ),
    "too many samples": (CONTROLLER, {}, {}, (3e-3, 1e4), STEP, ["must not exceed 1000000 samples", "10000 s"]),
    "of almost no length": (CONTROLLER, {}, {}, (3e-3, 1e-320), STEP, ["sample_time must be a multiple"]),
}


@pytest.mark.parametrize("case", STEPS)
def test_a_refused_step_changes_nothing_and_a_right_one_follows(case, native):
    name, parameters, inputs, wrong, right, parts = STEPS[case]
    instance, other = native(name).initialize(**parameters), native(name).initialize(**parameters)
    run(instance, name, 0, 3)
    run(other, name, 0, 3)
    usual = dict(zip(inputs, instance.get(*inputs), strict=True))
    instance.set(**inputs)
    message = instance.refused("DoStep", *wrong, 0)
    assert [part for part in parts if part not in message] == []
    status = ctypes.c_int()
    instance.done("GetStatus", 0, ctypes.byref(status))
    assert status.value == ERROR
    instance.set(**usual)
    assert instance.outputs() == other.outputs()
    assert instance.step(3e-3, right) == other.step(3e-3, right)
    assert instance.everything() == other.everything()
    assert run(instance, name, 4, 20) == run(other, name, 4, 20)


@pytest.mark.parametrize(
    ("delay", "step", "part"),
    [(1.5e-3, 1e-3, "must be a multiple of"), (2.0, 1e-3, "must not exceed 1000 communication")],
)
def test_a_delay_that_the_step_does_not_fit_is_refused(delay, step, part, native):
    instance = native(PLANT).initialize(measurement_delay=delay)
    message = instance.refused("DoStep", 0.0, step, 0)
    assert part in message
    assert f"{delay:g} s with a step of {step:g} s" in message
    instance.step(0.0, delay / 2)


@pytest.mark.parametrize("bad", [NAN, INFINITY, -INFINITY])
def test_the_experiment_must_begin_at_a_number_and_not_end_before(bad, name, native):
    instance = native(name)
    before = instance.everything()
    assert "the start time must be finite" in instance.refused("SetupExperiment", 0, 0.0, bad, 0, 0.0)
    assert "the stop time must not be before" in instance.refused("SetupExperiment", 0, 0.0, 1.0, 1, 0.5)
    assert "the stop time must not be before" in instance.refused("SetupExperiment", 0, 0.0, 1.0, 1, NAN)
    assert instance.everything() == before
    instance.done("SetupExperiment", 1, NAN, 1.0, 1, 1.0)


# What a host may ask about a step


def test_status_of_the_last_step(name, native):
    instance = native(name).initialize(2.5)
    status, number, flag = ctypes.c_int(77), ctypes.c_double(), ctypes.c_int(77)
    instance.step(2.5, STEP)
    instance.done("GetStatus", 0, ctypes.byref(status))
    instance.done("GetRealStatus", 2, ctypes.byref(number))
    instance.done("GetBooleanStatus", 3, ctypes.byref(flag))
    assert (status.value, number.value, flag.value) == (OK, 2.5 + STEP, 0)
    instance.refused("DoStep", 7.0, STEP, 0)
    instance.done("GetStatus", 0, ctypes.byref(status))
    instance.done("GetRealStatus", 2, ctypes.byref(number))
    assert (status.value, number.value) == (ERROR, 2.5 + STEP)


def test_other_statuses_are_not_known(name, native):
    instance = native(name).initialize()
    known = {("GetStatus", 0), ("GetRealStatus", 2), ("GetBooleanStatus", 3)}
    for function in ("GetStatus", "GetRealStatus", "GetIntegerStatus", "GetBooleanStatus", "GetStringStatus"):
        for kind in (-1, 0, 1, 2, 3, 4):
            value = ctypes.c_int64(77)
            if (function, kind) in known:
                assert "a pointer is missing" in instance.refused(function, kind, None)
            else:
                assert instance.call(function, kind, ctypes.byref(value)) == DISCARD
                assert value.value == 77


# Outputs


def test_values_at_the_start(native):
    plant = native(PLANT).initialize(voltage=5.0, theta_0=0.5, delta_0=0.0, delta_dot_0=2.0, encoder_counts=0)
    assert plant.get("theta", "delta", "theta_dot", "delta_dot") == (0.5, 0.0, 0.0, 2.0)
    assert plant.get("theta_encoder", "delta_encoder") == (0.5, 0.0)
    assert plant.get("voltage", "current") == (5.0, 0.0)
    controller = native(CONTROLLER).initialize(delta=0.05)
    assert controller.get("voltage", "mode", "fault", "homogeneous_norm_used") == (0.0, 1, 1, 1.0)
    assert controller.get("homogeneous_norm")[0] > 0.0


@pytest.mark.parametrize("changes", [{"theta_dot_0": 1e200}, {"m_p": 1e12, "J_r": 1e12}], ids=["velocity", "mass"])
def test_outputs_of_the_plant_are_finite_or_the_call_fails(changes, native):
    instance = native(PLANT)
    instance.set(**changes)
    bring(instance, INITIALIZING)
    assert instance.call("ExitInitializationMode") != OK or all(map(math.isfinite, instance.outputs()))


def test_terminated_instance_keeps_its_outputs_until_reset(name, native):
    instance = native(name).initialize()
    last = run(instance, name, 0, 45)[-1]
    instance.done("Terminate")
    assert instance.outputs() == last
    assert "'terminated'" in instance.refused("DoStep", 0.045, STEP, 0)
    assert "'terminated'" in instance.refused("Terminate")
    instance.done("Reset")
    assert run(instance.initialize(), name, 0, 45)[-1] == last


# Model exchange


def test_rates_in_initialization_are_those_of_the_start_values(native):
    instance, rate, later = native(PLANT, EXCHANGE), real(*[0.0] * 4), real(*[0.0] * 4)
    instance.set(theta_dot_0=0.3, delta_0=0.2)
    bring(instance, INITIALIZING).set(voltage=2.0)
    instance.done("GetDerivatives", rate, 4)
    assert rate[0] == 0.3
    instance.done("ExitInitializationMode")
    instance.done("GetDerivatives", later, 4)
    assert tuple(rate) == tuple(later)


def test_continuous_states_are_set_together_or_not_at_all(native):
    instance = bring(native(PLANT, EXCHANGE), CONTINUOUS)
    before = instance.everything()
    for i, bad in enumerate((NAN, INFINITY, -INFINITY, NAN)):
        x = [0.1, 0.2, 0.3, 0.4]
        x[i] = bad
        assert instance.call("SetContinuousStates", real(*x), 4) == DISCARD
        assert instance.everything() == before
        assert "must be finite" in instance.log[-1][2]
    for count in (0, 1, 3, 5):
        for function in (
            "SetContinuousStates",
            "GetContinuousStates",
            "GetDerivatives",
            "GetNominalsOfContinuousStates",
        ):
            assert "must be for 4 values" in instance.refused(function, real(*[0.0] * 5), count)
    assert "must be for 0 values" in instance.refused("GetEventIndicators", real(0.0), 1)
    assert instance.everything() == before


def test_derivatives_follow_states_and_inputs(native):
    instance, x, rate = bring(native(PLANT, EXCHANGE), CONTINUOUS), real(0.1, 0.2, 0.3, 0.4), real(*[0.0] * 4)
    instance.done("SetContinuousStates", x, 4)
    assert instance.get(*STATES) == tuple(x)
    instance.done(*instance.setting(theta=0.5, delta_dot=0.6, voltage=1.0))
    assert instance.get(*STATES, "voltage") == (0.5, 0.2, 0.3, 0.6, 1.0)
    assert "delta must be finite" in instance.refused(*instance.setting(theta=0.1, delta=NAN))
    instance.done(*instance.setting(theta=0.1, delta_dot=0.4, voltage=0.0))
    assert instance.get(*STATES) == tuple(x)
    instance.done("GetDerivatives", rate, 4)
    assert tuple(rate) == instance.get("theta_dot", "delta_dot", "theta_ddot", "delta_ddot")
    slow = rate[2]
    instance.set(voltage=3.0)
    instance.done("GetDerivatives", rate, 4)
    assert rate[2] > slow
    instance.done("SetContinuousStates", real(0.0, 0.5, 1e300, 0.0), 4)
    assert instance.call("GetDerivatives", rate, 4) == DISCARD


@pytest.mark.parametrize("bad", [NAN, INFINITY])
def test_time_must_be_a_number(bad, native):
    assert "the time must be finite" in bring(native(PLANT, EXCHANGE), EVENT).refused("SetTime", bad)


@pytest.mark.parametrize(
    ("changes", "part"),
    [
        ({"noise_std": 1e-3}, "noise_std must be 0"),
        ({"measurement_delay": 1e-3}, "measurement_delay must be 0"),
        ({"motor_model": 2}, "4 continuous states"),
    ],
)
def test_parameters_without_meaning_in_model_exchange_are_refused(changes, part, native):
    instance = native(PLANT, EXCHANGE)
    instance.set(**changes)
    assert part in bring(instance, INITIALIZING).refused("ExitInitializationMode")


# State


def test_a_state_is_written_over_and_freed_once(name, native):
    instance = native(name).initialize()
    state = instance.save()
    run(instance, name, 0, 5)
    after = instance.outputs()
    instance.done("GetFMUstate", ctypes.byref(state))
    run(instance, name, 5, 10)
    instance.done("SetFMUstate", state)
    assert instance.outputs() == after
    for _ in range(2):
        instance.done("FreeFMUstate", ctypes.byref(state))
        assert state.value is None
    assert "the pointer is no state of this FMU" in instance.refused("SetFMUstate", state)


def test_something_else_is_no_state(name, native):
    instance, something = native(name).initialize(), ctypes.create_string_buffer(64)
    pointer, before = ctypes.c_void_p(ctypes.addressof(something)), instance.everything()
    for function, given in {
        "SetFMUstate": (pointer,),
        "GetFMUstate": (ctypes.byref(pointer),),
        "FreeFMUstate": (ctypes.byref(pointer),),
        "SerializedFMUstateSize": (pointer, ctypes.byref(ctypes.c_size_t())),
        "SerializeFMUstate": (pointer, something, 64),
        "DeSerializeFMUstate": (before, len(before), ctypes.byref(pointer)),
    }.items():
        assert f"fmi2{function}: the pointer is no state of this FMU" in instance.refused(function, *given)
    assert pointer.value == ctypes.addressof(something)
    assert instance.everything() == before


@pytest.mark.parametrize(("name", "kind"), [(PLANT, EXCHANGE), (CONTROLLER, STEPPED)])
def test_a_state_of_another_unit_or_kind_is_refused(name, kind, native):
    phase = {EXCHANGE: CONTINUOUS, STEPPED: READY}
    state = bring(native(PLANT), READY).save()
    assert "no state of this FMU" in bring(native(name, kind), phase[kind]).refused("SetFMUstate", state)


@pytest.mark.parametrize(("name", "kind", "phase"), EVERYWHERE)
def test_serialized_state_continues_in_another_instance(name, kind, phase, native):
    serialized = bring(native(name, kind), phase).everything()
    instance = native(name, kind)
    instance.done("SetFMUstate", instance.deserialize(serialized))
    assert instance.everything() == serialized
    assert f"'{phase}'" in instance.refused(
        "CompletedIntegratorStep" if phase != CONTINUOUS else "DoStep",
        *((1, None, None) if phase != CONTINUOUS else (0.0, STEP, 0)),
    )


def test_bytes_do_not_depend_on_the_instance(name, native):
    first, second = (
        native(name).initialize(**DEMANDING[name]),
        native(name, name="another").initialize(**DEMANDING[name]),
    )
    run(first, name, 0, 45)
    run(second, name, 0, 45)
    assert first.everything() == second.everything()


def test_one_wrong_byte_is_noticed(name, native):
    instance = native(name).initialize(**DEMANDING[name])
    run(instance, name, 0, 45)
    good = instance.everything()
    for position in [*range(256), *range(256, len(good), 1 if len(good) < 4000 else 17), len(good) - 1]:
        bad = bytearray(good)
        bad[position] ^= 1 << position % 8
        state = ctypes.c_void_p()
        message = instance.refused("DeSerializeFMUstate", bytes(bad), len(bad), ctypes.byref(state))
        assert "damaged" in message or "the bytes are no state of this FMU" in message
        assert state.value is None
    assert instance.everything() == good


def test_bytes_of_another_length_are_refused(name, native):
    instance, state = native(name).initialize(), ctypes.c_void_p()
    good = instance.everything()
    for bad in (b"", good[:1], good[:-1], good[: len(good) // 2], good + b"\0", good + good):
        message = instance.refused("DeSerializeFMUstate", bad, len(bad), ctypes.byref(state))
        assert f"must have {len(good)} bytes, found {len(bad)}" in message
    buffer = ctypes.create_string_buffer(b"\1" * len(good), len(good))
    message = instance.refused("SerializeFMUstate", instance.save(), buffer, len(good) - 1)
    assert f"needs {len(good)} bytes, found {len(good) - 1}" in message
    assert buffer.raw == b"\1" * len(good)


@pytest.fixture(scope="module")
def redesigned(tmp_path_factory, native_units, start):
    """The plant's FMU with another start value, unpacked."""
    from fmpy import extract

    from fmu_export.native_fmu import export_native_fmu

    folder = tmp_path_factory.mktemp("redesigned")
    path = export_native_fmu(native_units[PLANT], folder / f"{PLANT}.fmu", {**start[PLANT], "voltage_limit": 5.0})
    return extract(str(path), str(folder / "unpacked"))


def test_foreign_bytes_are_refused_and_a_given_state_stays(native, redesigned):
    instance = native(PLANT).initialize()
    before, state = instance.everything(), instance.save()
    foreign = {
        "other unit": native(CONTROLLER).initialize().everything(),
        "other kind": bring(native(PLANT, EXCHANGE), EVENT).everything(),
        "other design": native(redesigned).initialize().everything(),
        "zeros": bytes(len(before)),
    }
    for what, serialized in foreign.items():
        message = instance.refused("DeSerializeFMUstate", serialized, len(serialized), ctypes.byref(state))
        expected = (
            "must have" if what == "other unit" else f"no state of this FMU with GUID {instance.description.guid}"
        )
        assert expected in message
    run(instance, PLANT, 0, 5)
    instance.done("SetFMUstate", state)
    assert instance.everything() == before


# Log


def complaints(instance):
    """How many messages an error and then a warning of the controller give."""
    instance.log.clear()
    instance.call("SetReal", references(9999), 1, real(0.0))
    errors = len(instance.log)
    instance.done("Reset")
    instance.initialize().step(0.0, STEP, theta=NAN)
    return errors, len(instance.log) - errors


def switch(instance, on, *categories):
    names = row(ctypes.c_char_p, *(category.encode() for category in categories))
    instance.done("SetDebugLogging", on, len(categories), names)


def test_log_categories(native, native_folders):
    instance = native(CONTROLLER)
    assert complaints(instance) == (1, 1)
    for on, categories, expected in [
        (0, (), (0, 0)),
        (1, ("logStatusError",), (1, 0)),
        (1, ("logStatusWarning",), (1, 1)),
        (0, ("logStatusError",), (0, 1)),
        (0, ("logStatusWarning", "logStatusError"), (0, 0)),
        (1, ("logAll",), (1, 1)),
        (0, ("logAll",), (0, 0)),
        (1, (), (1, 1)),
    ]:
        switch(instance, on, *categories)
        assert complaints(instance) == expected
    declared = (native_folders[CONTROLLER] / "modelDescription.xml").read_text()
    for category in ("logStatusError", "logStatusWarning", "logAll"):
        assert f'<Category name="{category}"' in declared


def test_host_without_logging_hears_of_errors_only(native):
    assert complaints(native(CONTROLLER, logging=False)) == (1, 0)


def test_unknown_log_category_is_refused(name, native):
    instance = native(name)
    names = row(ctypes.c_char_p, b"logEvents%s%n")
    assert "there is no log category 'logEvents%s%n'" in instance.refused("SetDebugLogging", 1, 1, names)
    assert "there is no log category ''" in instance.refused("SetDebugLogging", 1, 1, row(ctypes.c_char_p, None))


def test_unknown_log_category_among_others_switches_nothing(native):
    instance = native(CONTROLLER)
    names = row(ctypes.c_char_p, b"logStatusError", b"nonsense")
    assert "nonsense" in instance.refused("SetDebugLogging", 0, 2, names)


@pytest.mark.parametrize("text", ["100%", "%s%s%n%n", "%%", "%d%5$s", "%" * 400])
def test_messages_with_percent_signs_arrive_as_they_are(text, name, native):
    message = declined(native(name, guid=text))
    assert message.endswith(f"found {text}")


def test_messages_of_any_length_are_safe(name, native):
    for length in (10, 500, 511, 512, 513, 1023, 1024, 1025, 5000):
        message = declined(native(name, guid="%" * length))
        assert message.startswith("the GUID must be {")
        assert message.count("%") <= length


# Several instances


def test_messages_go_to_the_instance_that_they_are_about(native):
    first, second = native(PLANT), native(CONTROLLER)
    first.refused("Terminate")
    assert second.log == []
    second.refused("Terminate")
    assert len(first.log) == 1


def test_fifty_instances_in_two_threads_equal_one(name, native):
    expected = run(native(name).initialize(), name, 0, 60)
    instances = [native(name).initialize() for _ in range(50)]

    def work(own):
        found = [[] for _ in own]
        for k in range(60):
            for i, instance in enumerate(own):
                found[i] += run(instance, name, k, k + 1)
        return found

    with ThreadPoolExecutor(2) as pool:
        halves = list(pool.map(work, (instances[::2], instances[1::2])))
    assert all(rows == expected for half in halves for rows in half)


REPEAT = """
import ctypes, resource
from conftest import Native

def resident():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize()

h = Native(data["folder"])
h.free()

def live(times):
    for _ in range(times):
        h.instantiate()
        h.initialize()
        h.done("DoStep", 0.0, 1e-3, 0)
        state = h.save()
        again = h.deserialize(h.serialize(state))
        h.done("FreeFMUstate", ctypes.byref(state))
        h.done("FreeFMUstate", ctypes.byref(again))
        h.call("SetReal", (ctypes.c_uint * 1)(9999), 1, (ctypes.c_double * 1)())
        h.log.clear()
        h.done("Terminate")
        h.free()

live(200)
before = resident()
live(1000)
result = resident() - before
"""


def test_a_thousand_lives_take_no_memory(name, native_folders, run_python):
    assert run_python(REPEAT, {"folder": str(native_folders[name])}) < 2**20
