"""States of native FMUs: saved, written as bytes, given back to the right one only."""

import ctypes

import pytest

from tests.fmu_export.calls import CONTINUOUS, EVENT, EVERYWHERE, EXCHANGE, READY, STEPPED, bring
from tests.fmu_export.conftest import CONTROLLER, DEMANDING, PLANT, STEP, run, step_silently


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


def test_bytes_do_not_depend_on_the_instance_and_on_what_was_asked_for(name, native):
    first, second = (
        native(name).initialize(**DEMANDING[name]),
        native(name, name="another").initialize(**DEMANDING[name]),
    )
    run(first, name, 0, 45)
    step_silently(second, name, 0, 45)
    assert first.everything() == second.everything()


@pytest.mark.parametrize("call", ["Reset", "SetFMUstate"])
def test_nothing_is_left_of_a_step_whose_outputs_nobody_asked_for(call, name, native):
    instance = native(name)
    before, state = instance.everything(), instance.save()
    step_silently(instance.initialize(), name, 0, 1)
    instance.done(call, *[state] * (call == "SetFMUstate"))
    assert instance.everything() == before


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
