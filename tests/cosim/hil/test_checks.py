"""What is verified before a run: rest and signs."""

import math

import pytest

from cosim.hil import checks
from cosim.hil.checks import STILL_COUNTS, VOLTAGES, Signs, measure_signs, sign_test, verify_still
from cosim.hil.device import LED_IDLE, DeviceError
from cosim.hil.settings import Stopped
from tests.cosim.hil.rig import Between, lockstep, one_sentence, settings_of

SETTINGS = settings_of(1.0, still=0.1, sign_test=True)


@pytest.fixture
def bench(fmus):
    """Make a device that is started, its amplifier on; `change` may alter each sample."""
    made = []

    def make(faults="", change=None, **changes):
        device = Between(lockstep(fmus, faults, **changes), change)
        made.append(device)
        device.open()
        device.start(SETTINGS.period)
        device.enable(True)
        return device

    yield make
    for device in made:
        device.safe_stop("over")
        device.close()


# Rest


def test_a_device_at_rest_is_still(bench):
    device = bench()
    verify_still(device, SETTINGS, [])
    assert device.reads == len(device.voltages) == 100
    assert set(device.voltages) == {0.0}


@pytest.mark.parametrize("encoder", ["arm", "pendulum"])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(("counts", "still"), [(STILL_COUNTS, True), (STILL_COUNTS + 1, False)])
def test_how_much_may_move(bench, encoder, sign, counts, still):
    device = bench(f"{encoder}-jump@0.05={sign * counts}:0.01")
    if still:
        verify_still(device, SETTINGS, [])
        return
    with pytest.raises(DeviceError, match=f"the {encoder} must rest") as caught:
        verify_still(device, SETTINGS, [])
    assert f"moved by {sign * counts} " in one_sentence(caught.value)
    assert device.reads == 51


def test_a_pendulum_that_swings_is_not_still(bench):
    with pytest.raises(DeviceError, match="the pendulum must rest"):
        verify_still(bench(plant__start__delta_dot_0=0.5), SETTINGS, [])


def test_no_time_means_no_check(bench):
    device = bench(plant__start__delta_dot_0=5.0)
    verify_still(device, settings_of(still=0.0), [])
    assert device.reads == 0


@pytest.mark.parametrize("check", [verify_still, sign_test])
@pytest.mark.parametrize("script", ["amplifier-fault@0.05", "stall-error@0.05", "current@0.05=nan", "read-error@0.05"])
def test_faults_end_the_checks(bench, check, script):
    device = bench(script)
    with pytest.raises(DeviceError) as caught:
        check(device, SETTINGS, [])
    one_sentence(caught.value)
    assert device.reads <= 51


@pytest.mark.parametrize("check", [verify_still, sign_test])
def test_a_signal_ends_the_checks(bench, check):
    received = []
    device = bench(change=lambda n, sample: received.append(2) if n == 20 else None)
    with pytest.raises(Stopped) as caught:
        check(device, SETTINGS, received)
    assert caught.value.kind == "signal"
    assert len(device.voltages) == 20


# Signs


def test_the_right_signs(bench):
    device = bench()
    signs = sign_test(device, SETTINGS, [])
    assert signs.voltage == VOLTAGES[0]
    assert signs.arm >= checks.MOVED_COUNTS
    assert signs.pendulum <= -checks.MOVED_COUNTS
    assert set(device.voltages) == {-0.5, 0.5, 0.0}
    assert device.voltages[0] == -0.5  # the model's positive voltage first
    assert device.voltages[-1] == 0.0


def test_the_arm_hardly_moves_and_ends_at_rest(bench):
    device = bench()
    arms = []
    device.on_read = lambda n, sample: arms.append(sample.arm)
    sign_test(device, SETTINGS, [])
    assert max(abs(n) for n in arms) * 360.0 / 2048.0 < 15.0
    assert max(arms[-20:]) - min(arms[-20:]) <= 20


def turned(arm, pendulum):
    def change(n, sample):
        sample.arm, sample.pendulum = arm * sample.arm, pendulum * sample.pendulum

    return change


@pytest.mark.parametrize(
    ("arm", "pendulum", "said"),
    [
        (-1, 1, "against the voltage's sign"),
        (-1, -1, "against the voltage's sign"),
        (1, -1, "the pendulum's encoder counts the other way round"),
        (0, 1, "the arm's encoder did not"),
        (1, 0, "the pendulum's encoder did not"),
        (0, 0, "the arm did not move at 1.5 V"),
    ],
)
def test_wrong_signs(bench, arm, pendulum, said):
    device = bench(change=turned(arm, pendulum))
    with pytest.raises(DeviceError, match="sign test") as caught:
        sign_test(device, SETTINGS, [])
    assert said in one_sentence(caught.value)
    assert device.voltages[-1] == 0.0
    assert (1.5 in device.voltages) == (0 in (arm, pendulum))


def test_an_amplifier_without_power_is_told(bench):
    device = bench()
    device.enable(False)
    with pytest.raises(DeviceError, match="power supply"):
        sign_test(device, SETTINGS, [])


@pytest.mark.parametrize(("torque", "voltage"), [(0.0, 0.5), (0.003, 1.0), (0.0065, 1.5)])
def test_an_arm_that_sticks_gets_more_voltage(bench, torque, voltage):
    device = bench(plant__start__T_r=torque)
    signs = sign_test(device, SETTINGS, [])
    assert signs.voltage == voltage
    assert max(device.voltages) == voltage


def test_an_arm_that_sticks_at_all_voltages_is_told(bench):
    device = bench(plant__start__T_r=0.02)
    with pytest.raises(DeviceError, match=r"did not move at 1\.5 V"):
        sign_test(device, SETTINGS, [])
    assert max(map(abs, device.voltages)) == VOLTAGES[-1]


@pytest.mark.parametrize("rate", [200.0, 500.0, 2000.0])
def test_the_test_is_the_same_at_other_rates(fmus, rate):
    device = Between(lockstep(fmus))
    device.open()
    device.start(1.0 / rate)
    device.enable(True)
    signs = measure_signs(device, settings_of(1.0, rate), [])
    device.safe_stop("over")
    device.close()
    assert signs.problem() == ""
    assert device.reads == pytest.approx((2 * checks.PULSE + checks.COAST) * rate, abs=4)


def test_each_pulse_begins_where_the_arm_is(bench):
    device = bench()
    device.read(0.1)
    device.write(-1.0, LED_IDLE)
    for _ in range(100):
        device.read(0.1)
        device.write(0.0, LED_IDLE)
    assert device.device.board.sample.arm != 0
    assert sign_test(device, SETTINGS, []).arm > 0


@pytest.mark.parametrize(
    ("arm", "pendulum", "good"),
    [(4, -4, True), (30, -40, True), (3, -4, False), (4, -3, False), (-4, -4, False), (4, 4, False), (0, 0, False)],
)
def test_what_counts_as_right(arm, pendulum, good):
    problem = Signs(0.5, arm, pendulum).problem()
    assert (problem == "") == good
    if not good:
        one_sentence(problem)


def test_the_pendulum_goes_back_at_first_in_the_model(fmus):
    """A positive voltage turns the arm up and the hanging pendulum down: the plant's own first step."""
    device = lockstep(fmus)
    device.open()
    device.start(1e-3)
    device.enable(True)
    for _ in range(40):
        device.read(0.1)
        device.write(-1.0, LED_IDLE)
    sample = device.read(0.1)
    assert sample.arm < 0
    assert sample.pendulum < 0
    assert math.isclose(device.board.record[-1].voltage, -1.0)
    device.close()
