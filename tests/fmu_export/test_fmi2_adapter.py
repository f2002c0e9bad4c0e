"""The C interface of both native FMUs, called as a C host calls it: what is refused, why, and that it changes nothing."""

import ctypes
from concurrent.futures import ThreadPoolExecutor

import pytest

from tests.fmu_export.calls import (
    BORN,
    CONTINUOUS,
    DISCARD,
    ENDED,
    ERROR,
    EVENT,
    EVERYWHERE,
    EXCHANGE,
    FUNCTIONS,
    INITIALIZING,
    KINDS,
    NAN,
    OK,
    PHASES,
    READY,
    STEPPED,
    UNSUPPORTED,
    allowed,
    arguments,
    bring,
    declined,
    faultless,
    real,
    references,
    row,
    whole,
)
from tests.fmu_export.conftest import CONTROLLER, PLANT, STEP, run


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
        results = [[] for _ in own]
        for k in range(60):
            for i, instance in enumerate(own):
                results[i] += run(instance, name, k, k + 1)
        return results

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
