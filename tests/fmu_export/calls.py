"""Calls of FMI 2.0 as a C host makes them: the states of an instance, what is allowed in them, and right arguments."""

import csv
import ctypes
import math
from pathlib import Path

from tests.fmu_export.conftest import CONTROLLER, PLANT, STEP

EXCHANGE, STEPPED = 0, 1
OK, WARNING, DISCARD, ERROR = 0, 1, 2, 3
NAN, INFINITY = math.nan, math.inf
STATES = ("theta", "delta", "theta_dot", "delta_dot")

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


def declined(instance):
    """The sentence of an FMU that would not be instantiated."""
    assert instance.component is None
    ((status, category, message),) = instance.log
    assert (status, category) == (ERROR, "logStatusError")
    return message
