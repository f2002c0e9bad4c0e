"""Parameters from logs of simulated runs whose plant is known: found again, with intervals, or refused."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cosim import parameter_files
from cosim.errors import UserError
from cosim.hil import identify as module
from cosim.hil.identify import identify
from cosim.results import Result
from cosim.scenario import load_scenario
from cosim.scenario_run import run_scenario
from plant_fmu.parameters import PARAMETER_SETS

IDENT = PARAMETER_SETS["ident"]
TRUE = {"D_r": 1.5 * 2.7e-4, "D_p": 0.7 * 5e-5, "T_r": 5e-4}
SIGNALS = ("plant.theta_encoder", "plant.delta_encoder", "controller.voltage")
RESOLUTION = 2 * math.pi / 2048
SHORT = 0.1
"""Length of a segment in tests that need no accuracy [s]: a fit takes as long as a segment has steps."""


@pytest.fixture(scope="module")
def swing_up(fmus):
    """Make the log of a swing-up and balance, without the true state, by a plant with start values."""

    def make(duration=4.0, seed=1, controller=None, **start):
        changes = {"run.duration": duration, "run.seed": seed, "record.outputs": SIGNALS}
        changes |= {f"plant.start.{name}": value for name, value in (TRUE | start).items()}
        changes |= {f"controller.start.{name}": value for name, value in (controller or {}).items()}
        scenario, folder = load_scenario("swing_up")
        return run_scenario(scenario.changed(changes), fmus, folder)

    return make


@pytest.fixture(scope="module")
def log(swing_up):
    return swing_up()


@pytest.fixture(scope="module")
def exact(swing_up):
    """The log of a plant with ideal sensors."""
    return swing_up(encoder_counts=0)


def with_signals(log, metadata=None, **changes):
    """Return the log with columns replaced by function of the old one, added, or, for None, removed."""
    signals = dict(log.signals)
    for name, values in changes.items():
        full = name.replace("__", ".")
        if values is None:
            del signals[full]
        else:
            signals[full] = values(signals[full]) if callable(values) else values
    return Result(log.time, signals, dict.fromkeys(signals, "1"), log.metadata if metadata is None else metadata)


def rows(log, kept):
    return Result(log.time[kept], {n: s[kept] for n, s in log.signals.items()}, log.units, log.metadata)


def values(fit):
    return {name: estimate.value for name, estimate in fit.estimates.items()}


# What is found


def test_friction_and_damping_are_found_through_the_encoders(swing_up):
    trials = []
    fit = identify(swing_up(10.0), IDENT, progress=lambda *report: trials.append(report))
    assert list(fit.estimates) == ["D_r", "D_p", "T_r"]
    for name, tolerance in (("D_r", 0.03), ("D_p", 0.03), ("T_r", 0.06)):
        estimate = fit.estimates[name]
        assert estimate.value == pytest.approx(TRUE[name], rel=tolerance)
        assert estimate.low < estimate.value < estimate.high
        assert estimate.high - estimate.low < 4 * tolerance * TRUE[name]
        assert estimate.identifiable
    assert fit.estimates["D_r"].low <= TRUE["D_r"] <= fit.estimates["D_r"].high
    assert fit.estimates["D_p"].low <= TRUE["D_p"] <= fit.estimates["D_p"].high
    assert abs(fit.bias.value) < RESOLUTION
    assert fit.rms_after == pytest.approx(RESOLUTION / math.sqrt(12), rel=0.15)
    assert fit.rms_before > 2 * fit.rms_after
    assert not fit.disturbed
    assert fit.disturbance < 4e-3
    assert (fit.segments, fit.samples) == (40, 10_000)
    assert [number for number, _ in trials] == list(range(1, len(trials) + 1))
    assert trials[-1][1] == pytest.approx(fit.rms_after, rel=0.05)


def test_friction_cannot_be_told_from_a_disturbance_that_the_model_lacks(fmus):
    """The paper's disturbance at G = 3 is 47 mV RMS; its interval for T_r does not hold the truth."""
    sines = [{"amplitude": 0.02, "frequency": 10.0}, {"amplitude": 0.01, "frequency": 3.0}]
    changes = {"plant.start.T_r": 2e-4, "disturbance.gain": 3.0, "disturbance.sines": sines, "run.seed": 2}
    scenario, folder = load_scenario("swing_up")
    fit = identify(run_scenario(scenario.changed(changes), fmus, folder), IDENT)
    assert fit.estimates["T_r"].low > 2 * 2e-4
    assert fit.disturbed
    assert fit.disturbance == pytest.approx(0.047, rel=0.4)
    assert {name for name, e in fit.estimates.items() if not e.identifiable} == {"D_r", "T_r"}


def test_with_ideal_sensors_inertias_too_are_found_exactly(exact):
    """The simulation of the fit is that of the plant; from a start that is far off."""
    start = replace(IDENT, parameters=replace(IDENT.parameters, D_p=0.0, J_r=4e-5, J_p=4e-5))
    fit = identify(exact, start, ("D_r", "D_p", "T_r", "J_r", "J_p"), SHORT)
    expected = TRUE | {"J_r": IDENT.parameters.J_r, "J_p": IDENT.parameters.J_p}
    assert values(fit) == pytest.approx(expected, rel=1e-3)
    assert fit.rms_after < 1e-6
    assert not fit.disturbed
    assert abs(fit.bias.value) < 1e-6


def test_absent_friction_is_found_absent(swing_up):
    friction = identify(swing_up(T_r=0.0), IDENT, segment=SHORT).estimates["T_r"]
    assert friction.low == 0.0
    assert 0.0 <= friction.value < 2e-5
    assert friction.high < 1e-4
    assert friction.identifiable


def test_the_fitted_set_is_the_start_but_for_what_was_identified(log, tmp_path):
    start = replace(IDENT, back_emf=False)
    fit = identify(log, start, ["D_r"], SHORT)
    fitted = fit.parameters
    assert fitted.parameters == replace(IDENT.parameters, D_r=fit.estimates["D_r"].value)
    assert (fitted.name, fitted.back_emf) == ("ident_identified", False)
    assert fitted.source == f"D_r identified from a log of swing_up, 4 s; the rest: {IDENT.source}"
    parameter_files.save(tmp_path / "mine.toml", fitted)
    assert parameter_files.load(tmp_path / "mine.toml").parameters == fitted.parameters
    without, with_emf = fit.estimates["D_r"].value, identify(log, IDENT, ["D_r"], SHORT).estimates["D_r"].value
    p = IDENT.parameters
    assert without - with_emf == pytest.approx(p.k_m**2 / p.R_m, rel=0.02)  # damping that the motor does not explain


@pytest.mark.parametrize(
    ("names", "told"),
    [
        (("D_p", "L_m"), {"D_p": True, "L_m": False}),
        (("D_r", "D_p", "k_m", "R_m"), {"D_r": False, "D_p": True, "k_m": False, "R_m": False}),
    ],
    ids=["no inductance in the model", "D_r + k_m^2/R_m and k_m/R_m"],
)
def test_what_the_log_does_not_tell_is_said(exact, names, told):
    fit = identify(exact, IDENT, names, SHORT)
    assert {name: estimate.identifiable for name, estimate in fit.estimates.items()} == told
    for estimate in fit.estimates.values():
        assert math.isinf(estimate.high) != estimate.identifiable
        assert estimate.low >= 0.0


def test_a_still_arm_tells_nothing_of_its_friction():
    """A pendulum swings on a blocked arm: damping of the pendulum only."""
    p = IDENT.parameters
    t = np.arange(3000) * 1e-3
    omega = math.sqrt(p.m_p * p.g_p * p.L_p / 2 / (p.J_p + p.m_p * p.L_p**2 / 4))
    signals = {"plant.theta_encoder": 0.0 * t, "plant.delta_encoder": math.pi + 0.1 * np.cos(omega * t)}
    log = Result(t, signals | {"controller.voltage": 0.0 * t}, {}, {})
    heavy = replace(IDENT, parameters=replace(p, J_r=1e3))
    fit = identify(log, heavy, segment=SHORT)
    assert {n: e.identifiable for n, e in fit.estimates.items()} == {"D_r": False, "D_p": True, "T_r": False}


# What a log may be


def test_the_applied_voltage_goes_before_the_commanded_one(log):
    voltage = log["controller.voltage"]
    both = with_signals(log, hil__applied_voltage=voltage, controller__voltage=np.zeros_like)
    assert values(identify(both, IDENT, segment=SHORT)) == values(identify(log, IDENT, segment=SHORT))


def test_in_parallel_order_a_row_has_the_voltage_of_the_next_step(log):
    def early(voltage):
        return np.append(voltage[1:], 0.0)

    parallel = with_signals(log, log.metadata | {"order": "parallel"}, controller__voltage=early)
    assert values(identify(parallel, IDENT, segment=SHORT)) == values(identify(log, IDENT, segment=SHORT))


def test_missed_rows_are_bridged(swing_up):
    """The controller samples every second step, so that a row may be missing before each of its samples."""
    whole = swing_up(8.0, controller={"sample_time": 2e-3})
    missed = np.random.default_rng(1).random(len(whole.time)) < 0.5
    missed[::2] = False
    gaps = rows(whole, np.flatnonzero(~missed))
    fit, expected = (identify(log, IDENT, segment=SHORT) for log in (gaps, whole))
    assert fit.samples < 0.8 * expected.samples
    assert fit.segments == expected.segments
    assert values(fit) == pytest.approx(values(expected), rel=0.05)
    assert values(fit) == pytest.approx(TRUE, rel=0.1)


def test_a_long_gap_is_left_out(log):
    whole, cut = identify(log, IDENT, segment=SHORT), rows(log, np.flatnonzero(np.abs(log.time - 2.5) > 0.3))
    fit = identify(cut, IDENT, segment=SHORT)
    assert fit.segments == whole.segments - 6
    assert values(fit) == pytest.approx(values(whole), rel=0.1)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda log: rows(log, slice(0, 300)), "at least 4 segments of 0.1 s without long gaps, found 3"),
        (lambda log: rows(log, slice(0, 1)), "at least two rows, with increasing times"),
        (lambda log: rows(log, slice(None, None, -1)), "with increasing times"),
        (lambda log: with_signals(log, plant__delta_encoder=None), "needs plant.delta_encoder; the log has"),
        (lambda log: with_signals(log, controller__voltage=None), "needs controller.voltage; the log has"),
        (lambda log: with_signals(log, plant__theta_encoder=lambda a: a * math.nan), "others in plant.theta_encoder"),
        (lambda log: with_signals(log, controller__voltage=lambda v: v + math.inf), "others in controller.voltage"),
        (
            lambda log: with_signals(log, plant__theta_encoder=np.zeros_like, plant__delta_encoder=np.ones_like),
            "must move by 0.05 rad, or nothing is to be seen, found 0 rad",
        ),
        (lambda log: with_signals(log, {"every": 10}), "needs every row, found a log with every = 10"),
        (
            lambda log: Result(log.time + 3e-4 * (np.arange(len(log.time)) % 2), log.signals, {}, {}),
            "rows must be whole periods apart",
        ),
    ],
)
def test_a_log_that_cannot_tell_anything_is_refused(log, change, problem):
    with pytest.raises(UserError) as refusal:
        identify(change(log), IDENT, segment=SHORT)
    assert problem in str(refusal.value)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("names", "segment", "problem"),
    [
        (["D_rr"], SHORT, "there is no parameter 'D_rr'; did you mean D_r"),
        (["back_emf"], SHORT, "there is no parameter 'back_emf'"),
        ([], SHORT, "named, once each, found none"),
        (["D_r", "D_r"], SHORT, "named, once each, found D_r, D_r"),
        (["D_r"], 5e-3, "at least 8 periods, 0.008 s, found 0.005 s"),
        (["D_r"], 2.0, "at least 4 segments of 2 s without long gaps, found 2"),
    ],
)
def test_what_cannot_be_asked_is_refused(log, names, segment, problem):
    with pytest.raises(UserError) as refusal:
        identify(log, IDENT, names, segment)
    assert problem in str(refusal.value)


def test_a_set_that_is_far_off_is_refused(log):
    heavy = replace(IDENT, parameters=replace(IDENT.parameters, k_m=10.0))
    with pytest.raises(UserError, match="cannot be simulated with the set ident; is it the log of this plant"):
        identify(log, heavy, segment=SHORT)


# The method


def test_half_widths_are_those_of_the_mean_of_independent_numbers():
    """One unknown, one number per segment: the jackknife is the standard error of the mean, with S - 1 degrees."""
    from scipy.stats import t as student

    r = np.random.default_rng(2).normal(size=(30, 1))
    r -= r.mean()
    half, known = module._half_widths(-np.ones((30, 1, 1)), r)
    expected = student.ppf(0.975, 29) * r.std(ddof=1) / math.sqrt(30)
    assert half == pytest.approx([expected], rel=1e-3)
    assert known.all()
