"""What holds for Python FMUs alone: outputs equal to the library's to the last bit, and a process that stays sound."""

import random

import pytest

from tests.fmu_export.conftest import CONTROLLER, DEMANDING, NAMES, PLANT, STEP, inputs_at

STABILIZING = 3


@pytest.mark.parametrize("motor_model", [1, 2])
def test_plant_equals_the_library_under_random_voltages(motor_model, host, unit):
    changes = {**DEMANDING[PLANT], "motor_model": motor_model, "delta_0": 0.3}
    instance, library = host(PLANT).initialize(**changes), unit(PLANT, **changes)
    for k in range(500):
        inputs = inputs_at(PLANT, k)
        library.step(k * STEP, STEP, tuple(inputs.values()))
        assert instance.step(k * STEP, STEP, **inputs) == library.outputs()


def test_plant_equals_the_library_with_steps_of_any_length(host, unit):
    instance, library, rng, time = host(PLANT).initialize(delta_0=0.3), unit(PLANT, delta_0=0.3), random.Random(5), 0.0
    for _ in range(100):
        step = 10 ** rng.uniform(-5, -1)
        library.step(time, step, (2.0, 0.0, 0.0))
        assert instance.step(time, step, voltage=2.0) == library.outputs()
        time += step


WIRES = {"theta": "theta_encoder", "delta": "delta_encoder", "theta_dot": "theta_dot", "delta_dot": "delta_dot"}


@pytest.mark.parametrize(
    ("of_plant", "of_controller", "reached"),
    [
        ({}, {}, 2),
        ({"delta_0": 0.1, "noise_std": 1e-4}, {}, STABILIZING),
        ({"delta_0": 0.1, "encoder_counts": 0}, {"law": 1, "velocity_source": 2}, STABILIZING),
        ({"delta_0": -0.1, "motor_model": 2, "solver_step": 2.5e-4}, {"law": 2}, STABILIZING),
        ({"delta_0": 0.1}, {"norm_solver": 2, "discretization": 2, "sample_time": 5e-3}, STABILIZING),
    ],
    ids=["swing-up", "IHC", "LC", "SMC", "slow exact IHC"],
)
def test_closed_loop_equals_the_library_exactly(of_plant, of_controller, reached, host, unit):
    plant, controller = host(PLANT), host(CONTROLLER)
    plant.initialize(**of_plant)
    own_plant, own_controller = unit(PLANT, **of_plant), unit(CONTROLLER, **of_controller)
    measured = dict(zip(WIRES, plant.get(*WIRES.values()), strict=True))
    controller.initialize(**of_controller, **measured)
    own_controller.initialize(0.0, (*measured.values(), 0.0))
    places = [plant.output_names.index(source) for source in WIRES.values()]
    modes = set()
    for k in range(500):
        t = k * STEP
        own_controller.step(t, STEP, (*[own_plant.outputs()[i] for i in places], 0.0))
        own_plant.step(t, STEP, (own_controller.outputs()[0], 0.0, 0.0))
        commanded = controller.step(t, STEP, **dict(zip(WIRES, plant.get(*WIRES.values()), strict=True)))
        assert commanded == own_controller.outputs()
        assert plant.step(t, STEP, voltage=commanded[0]) == own_plant.outputs()
        modes.add(commanded[controller.output_names.index("mode")])
    assert reached in modes


# Tunable parameters


REPEAT = """
from conftest import Host
rows, modules = [], []
for _ in range(data["times"]):
    h = Host(data["folder"]).initialize()
    rows.append([list(h.step(k * 1e-3, 1e-3)) for k in range(3)])
    h.slave.terminate()
    h.slave.freeInstance()
    modules.append(len(sys.modules))
result = {"same": all(row == rows[0] for row in rows), "row": rows[0], "modules": [modules[0], modules[-1]]}
"""


def test_fifty_runs_in_one_process_are_the_same_and_load_no_more_modules(name, folders, host, run_python):
    result = run_python(REPEAT, {"folder": str(folders[name]), "times": 50})
    instance = host(name).initialize()
    assert result["same"]
    assert [tuple(row) for row in result["row"]] == [instance.step(k * STEP, STEP) for k in range(3)]
    assert result["modules"][0] == result["modules"][1]


SOUND = """
import gc
from conftest import Host
calls = {
    "step": lambda h: h.slave.doStep(0.0, 1e-3),
    "end": lambda h: h.slave.terminate(),
    "reference": lambda h: h.slave.setReal([9999], [0.0]),
    "string": lambda h: h.slave.getString([0]),
    "time": lambda h: h.slave.setupExperiment(startTime=float("nan")),
}
for state in (b"not json", b"[1, 2]", b"{}", b"\\xff\\xfe"):
    calls[repr(state)] = lambda h, state=state: h.slave.setFMUstate(h.slave.deSerializeFMUstate(state))
result = {}
for name, folder in data.items():
    good, said = Host(folder).initialize(), {}
    for _ in range(3):
        for call, fail in calls.items():
            h = Host(folder)
            try:
                fail(h)
            except Exception:
                said[call] = "".join(message for _, _, message in h.log[-2:])
            h.slave.freeInstance()
            gc.collect()
    result[name] = [said, list(good.step(0.0, 1e-3))]
"""


def test_failed_instances_can_be_freed_and_leave_the_process_sound(folders, unit, slaves, run_python):
    results = run_python(SOUND, {name: str(folder) for name, folder in folders.items()})
    for name in NAMES:
        library = unit(name)
        library.initialize(0.0, inputs := tuple(0.0 for _ in slaves[name].interface.of("input")))
        library.step(0.0, 1e-3, inputs)
        said, outputs = results[name]
        assert len(said) == 9
        assert [call for call in said if call[0] == "b" and "the state must be one of this FMU" not in said[call]] == []
        assert outputs == list(library.outputs())
