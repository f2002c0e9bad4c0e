"""Scripts of faults: what they mean, and what is said of those that mean nothing."""

import math

import pytest

from cosim.errors import UserError
from cosim.hil.faults import KINDS, InjectedFault, parse
from tests.cosim.hil.rig import one_sentence


@pytest.mark.parametrize(
    ("script", "faults"),
    [
        ("", ()),
        (" , ,", ()),
        ("arm-jump@3=500", (InjectedFault("arm-jump", 3.0, 500.0, 0.0),)),
        ("arm-jump@3=-500:0.01", (InjectedFault("arm-jump", 3.0, -500.0, 0.01),)),
        ("push@5=0.01", (InjectedFault("push", 5.0, 0.01, 0.05),)),
        ("push@5=0.01:0.2", (InjectedFault("push", 5.0, 0.01, 0.2),)),
        ("silent@2", (InjectedFault("silent", 2.0, 1.0, math.inf),)),
        ("stall@2=1:0.5", (InjectedFault("stall", 2.0, 1.0, 0.5),)),
        ("late@1e-1=4", (InjectedFault("late", 0.1, 4.0, 0.0),)),
        ("read-error@0", (InjectedFault("read-error", 0.0, 1.0, 0.0),)),
        (
            "stall@1, amplifier-fault@2 ,current@3=0.6:4",
            (
                InjectedFault("stall", 1.0, 1.0, math.inf),
                InjectedFault("amplifier-fault", 2.0, 1.0, math.inf),
                InjectedFault("current", 3.0, 0.6, 4.0),
            ),
        ),
    ],
)
def test_scripts(script, faults):
    assert parse(script) == faults


def test_a_current_may_be_no_number():
    (fault,) = parse("current@1=nan")
    assert math.isnan(fault.value)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_can_be_written(kind):
    (fault,) = parse(f"{kind}@1.5=2:0.25")
    assert fault == InjectedFault(kind, 1.5, 2.0, 0.25)
    if KINDS[kind][0] is not None:
        assert parse(f"{kind}@1.5")[0].value == KINDS[kind][0]
        assert parse(f"{kind}@1.5")[0].duration == KINDS[kind][1]


@pytest.mark.parametrize("kind", [kind for kind in KINDS if KINDS[kind][0] is None])
def test_kinds_that_need_a_value_say_so(kind):
    with pytest.raises(UserError, match=f"{kind} needs a value") as caught:
        parse(f"{kind}@1.5")
    one_sentence(caught.value)


@pytest.mark.parametrize(
    ("script", "said"),
    [
        ("arm-jmp@3=500", "did you mean arm-jump"),
        ("nonsense@3=500", "there is no fault 'nonsense'"),
        ("@3", "there is no fault ''"),
        ("silent", "kind@time"),
        ("silent@", "kind@time"),
        ("silent@soon", "kind@time"),
        ("silent@-1", "at least 0 s"),
        ("silent@nan", "at least 0 s"),
        ("silent@inf", "at least 0 s"),
        ("arm-jump@1=", "kind@time"),
        ("arm-jump@1=x", "kind@time"),
        ("arm-jump@1=5:", "kind@time"),
        ("arm-jump@1=5:x", "kind@time"),
        ("arm-jump@1=5:-1", "no negative time"),
        ("arm-jump@1=5:nan", "at least 0 s"),
        ("late@1=0", "at least one period"),
        ("late@1=nan", "whole number"),
        ("silent@1,arm-jump", "found 'arm-jump'"),
    ],
)
def test_bad_scripts_are_one_sentence(script, said):
    with pytest.raises(UserError) as caught:
        parse(script)
    assert said in one_sentence(caught.value)


@pytest.mark.parametrize("script", ["arm-jump@1=nan", "pendulum-jump@1=inf", "late@1=inf"])
def test_counts_and_periods_must_be_finite(script):
    with pytest.raises(UserError):
        parse(script)
