"""One FMU: what is refused before it runs, start values, messages of the right instance, nothing left behind."""

import sys
import zipfile
from contextlib import closing
from pathlib import Path

import fmpy
import numpy as np
import pytest

from cosim.errors import UserError
from cosim.fmu import FmuError, Instance
from tests.cosim.linear_fmu import linear_fmu


@pytest.fixture
def controller(fmus):
    return Instance("controller", fmus / "IhcController.fmu")


@pytest.fixture
def running(tiny_fmu):
    """Start instances of the tiny FMU; all are closed after the test."""
    made = []

    def start(name, **values):
        instance = Instance(name, tiny_fmu)
        made.append(instance)
        instance.start(instance.checked_start(values), 0.0, 1.0)
        instance.run()
        return instance

    yield start
    for instance in made:
        instance.close()


def test_a_model_exchange_fmu_does_no_steps(tiny_fmu, repacked):
    def exchange(xml):
        start = xml.index("<CoSimulation")
        end = xml.index("/>", start) + 2
        return xml[:start] + '<ModelExchange modelIdentifier="Tiny"/>' + xml[end:]

    with pytest.raises(
        UserError, match=r"Tiny\.fmu must be an FMU for co-simulation, found one for model exchange only"
    ):
        Instance("a", repacked(tiny_fmu, {"modelDescription.xml": exchange}))


# Start values


def test_start_values_are_refused_with_the_instances_name(controller):
    with pytest.raises(UserError, match=r"^controller\.mu must lie in \[0, 1\], found 2.0$"):
        controller.checked_start({"mu": 2.0})
    with pytest.raises(UserError, match="controller has no variable named 'a_mim'; did you mean a_min"):
        controller.checked_start({"a_mim": 0.5})
    with pytest.raises(UserError) as refusal:
        controller.checked_start({"voltage": 0.0})
    rule = 'an output variable that the FMU calculates (initial = "calculated"), with no start value to set'
    assert str(refusal.value) == f"controller.voltage is {rule}"


@pytest.mark.parametrize("begins", ["output", "local"])
def test_outputs_and_locals_that_begin_with_their_start_value_can_be_set(tmp_path, begins):
    names = ["body.x[1]", "body.der(x[1])"]
    outputs = [(name, None) for name in (names if begins == "output" else ("y1", "y2"))]
    matrices = [[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], np.eye(2)
    path = linear_fmu(
        tmp_path / "Own.fmu", [("u", None)], outputs, *matrices, x0=(0.1, 0.0), starts=names, begins=begins
    )
    instance = Instance("plant", path)
    with closing(instance):
        instance.start(instance.checked_start({names[0]: 0.3, names[1]: 2}), 0.0, 1.0)
        instance.run()
        instance.stepper()(0.0, 0.1)
        (port,) = instance.ports([name for name, _ in outputs], "Get")
        instance.transfer([port])
        assert list(port.values) == pytest.approx([0.5, 2.0])


def test_start_values_reach_the_fmu(running):
    instance = running("a", gain=4.0, u=0.5, whole=-3, flag=True)
    ports = instance.ports(["y", "whole_out", "flag_out"], "Get")
    instance.stepper()(0.0, 0.1)
    instance.transfer(ports)
    assert [port.values[0] for port in ports] == [2.0, -3, 1]


# Messages


def test_messages_reach_the_instance_that_sent_them(running):
    """FMPy formats messages by one logger per process; the last instance made must not take them all."""
    instances = {
        name: running(name, gain=gain, warn_at=at) for name, gain, at in (("a", 1, 2), ("b", 2, 1), ("c", 3, 0))
    }
    steps = {name: instance.stepper() for name, instance in instances.items()}
    for k in range(2):
        for name in "cba":
            steps[name](0.1 * k, 0.1)
    assert instances["c"].messages == []
    assert [m for m in instances["a"].messages if m.startswith("warning")] == instances["a"].messages
    assert ["gain 1" in m and "t = 0.1 s" in m for m in instances["a"].messages] == [True]
    assert ["gain 2" in m and "t = 0 s" in m for m in instances["b"].messages] == [True]


def test_messages_arrive_after_fmpy_has_run_an_fmu_with_a_logger_of_its_own(tiny_fmu, running):
    strangers = []
    fmpy.simulate_fmu(
        str(tiny_fmu),
        stop_time=0.01,
        start_values={"warn_at": 1},
        debug_logging=True,
        logger=lambda *m: strangers.append(m),
    )
    seen = len(strangers)
    instance = running("a", warn_at=1)
    instance.stepper()(0.0, 0.1)
    assert seen == len(strangers) == 1
    assert "told to warn" in instance.messages[0]


def test_a_failure_names_instance_call_status_and_its_own_cause(running):
    good, bad = running("good", warn_at=1), running("bad", fail_at=2)
    step = bad.stepper()
    step(0.0, 0.1)
    good.stepper()(0.0, 0.1)
    with pytest.raises(FmuError, match=r"^bad: doStep\(0\.1, 0\.1\) returned \w+: .*told to fail in call 2$"):
        step(0.1, 0.1)
    assert any("Traceback" in message for message in bad.messages)
    assert not any("fail" in message for message in good.messages)
    good.stepper()(0.1, 0.1)  # the other instance is not affected


def test_the_number_of_messages_kept_is_bounded(running):
    instance = running("a")
    instance.messages.extend(["OK: one"] * 200)
    chatty = running("b", warn_at=1)
    chatty.messages.extend(["OK: one"] * 200)
    chatty.stepper()(0.0, 0.1)
    assert len(chatty.messages) == 200


# Nothing left behind


def test_instances_leave_search_path_and_working_folder(running):
    path, folder = list(sys.path), Path.cwd()
    for name in "abc":
        running(name).close()
    assert (sys.path, Path.cwd()) == (path, folder)


@pytest.mark.parametrize("binary", ["missing", "broken"])
def test_an_fmu_that_cannot_be_loaded_is_named_and_leaves_nothing(tiny_fmu, repacked, binary):
    path, folder = list(sys.path), Path.cwd()
    fmu = repacked(tiny_fmu, {"binaries/": None})
    if binary == "broken":
        with zipfile.ZipFile(fmu, "a") as archive:
            archive.writestr(f"binaries/{fmpy.platform}/Tiny{fmpy.sharedLibraryExtension}", "no code")
    instance = Instance("a", fmu)
    with pytest.raises(FmuError, match=r"^a \(.*changed Tiny\.fmu\): "):
        instance.start({}, 0.0, 1.0)
    instance.close()
    assert (sys.path, Path.cwd()) == (path, folder)


def test_code_changed_after_the_export_does_not_run(tiny_fmu, repacked):
    with zipfile.ZipFile(tiny_fmu) as archive:
        (code,) = [name for name in archive.namelist() if name.endswith("tiny/slave.py")]
    louder = repacked(tiny_fmu, {code: lambda text: text.replace("* inputs[0]", "* inputs[0] + 1.0")})
    instance = Instance("a", louder)
    with pytest.raises(FmuError, match="is not the code that was exported"):
        instance.start({}, 0.0, 1.0)
    instance.close()


def test_closing_twice_and_before_the_start_is_harmless(tiny_fmu, running):
    Instance("never started", tiny_fmu).close()
    instance = running("a")
    instance.close()
    instance.close()


def test_percent_signs_in_messages_arrive_as_they_are(running):
    instance = running("a", warn_at=1)  # tiny/slave.py then warns: f"told to warn, 100 % done %d, gain ..."
    instance.stepper()(0.0, 0.1)
    assert "told to warn, 100 % done %d, gain 1" in instance.messages[0]
