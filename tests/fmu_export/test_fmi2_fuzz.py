"""Any calls in any order on the native FMUs, against a small model of what is allowed when."""

import ctypes
import math
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

PLANT, CONTROLLER = "QubeServo2", "IhcController"
EXCHANGE, STEPPED = 0, 1
OK, DISCARD, ERROR = 0, 2, 3
STEP = 1e-3

BORN, INITIALIZING, READY, EVENT, CONTINUOUS, ENDED = range(6)
RUNNING = (READY, EVENT, CONTINUOUS)
BEFORE = (BORN, INITIALIZING)
SETTABLE = {"input": (*BEFORE, *RUNNING), "tunable": (*BEFORE, READY, EVENT), "fixed": BEFORE}

TAME = st.floats(-100.0, 100.0) | st.sampled_from([0.0, 1e-3, 1.0])
WILD = TAME | st.sampled_from([math.nan, math.inf, -math.inf, 1e9, -1e9, 5e-324])
WHOLE = st.integers(-2, 70) | st.sampled_from([-(2**31), 2**31 - 1, 2048])
CALLS = {
    "EnterInitializationMode": (BORN,),
    "ExitInitializationMode": (INITIALIZING,),
    "Terminate": RUNNING,
    "EnterEventMode": (EVENT, CONTINUOUS),
    "EnterContinuousTimeMode": (EVENT,),
}


class AnyOrder(RuleBasedStateMachine):
    """An instance, and what is known of it: its phase, its time, what every variable was set to.

    `values` has what was set last, by reference; `trusted` is whether no parameter was changed
    and no input was wild: then steps must succeed and outputs be finite.
    """

    make: Callable[[], Any]  # given by each test

    @initialize(far=st.sampled_from([True, True, True, False]))
    def begin(self, far):
        self.unit = self.make()
        self.kind = self.unit.kind
        self.is_plant = self.unit.description.modelName == PLANT
        self.by_reference = {v.valueReference: v for v in self.unit.variables.values()}
        states = ("theta", "delta", "theta_dot", "delta_dot") if self.is_plant else ()
        self.states = [self.unit.reference(name) for name in states]
        self.saved = []
        self.born()
        if far:
            self.go_on()
            self.go_on()

    def born(self):
        self.phase, self.set_up, self.time, self.stop, self.trusted = BORN, False, 0.0, math.inf, True
        self.values = {
            reference: float(v.start)
            if v.type == "Real"
            else int(v.start == "true" if v.type == "Boolean" else v.start)
            for reference, v in self.by_reference.items()
            if v.start is not None
        }

    def expect(self, function, *arguments, ok):
        """Call; where it is not `ok` it must be refused with one message and change nothing."""
        before, heard = (None if ok else self.unit.everything()), len(self.unit.log)
        status = self.unit.call(function, *arguments)
        assert status == (OK if ok else ERROR), (function, status, self.unit.log[heard:])
        if not ok:
            assert len(self.unit.log) == heard + 1
            assert self.unit.log[-1][1] == "logStatusError"
            assert self.unit.everything() == before

    # The order of calls

    @rule(start=st.sampled_from([0.0, 2.5, -1.0, math.nan, math.inf]), stop=st.sampled_from([None, 10.0, -5.0]))
    def setup_experiment(self, start, stop):
        ok = self.phase == BORN and math.isfinite(start) and (stop is None or stop >= start)
        self.expect("SetupExperiment", 0, 0.0, start, stop is not None, stop or 0.0, ok=ok)
        if ok:
            self.set_up, self.time, self.stop = True, start, math.inf if stop is None else stop

    @precondition(lambda self: self.phase in BEFORE)
    @rule()
    def go_on(self):
        """The right next call, so that most runs get somewhere."""
        if not self.set_up and self.phase == BORN:
            self.setup_experiment(0.0, None)
        self.change_phase("EnterInitializationMode" if self.phase == BORN else "ExitInitializationMode")

    @rule(function=st.sampled_from(sorted(CALLS)), really=st.integers(0, 5))
    def change_any_phase(self, function, really):
        if really == 0 or function != "Terminate":
            self.change_phase(function)

    def change_phase(self, function):
        if function == "ExitInitializationMode" and self.phase == INITIALIZING and not self.trusted:
            if self.unit.call(function) != OK:
                return
        else:
            ok = self.phase in CALLS[function] and (function != "EnterInitializationMode" or self.set_up)
            self.expect(function, ok=ok)
            if not ok:
                return
        self.phase = {
            "EnterInitializationMode": INITIALIZING,
            "ExitInitializationMode": READY if self.kind == STEPPED else EVENT,
            "Terminate": ENDED,
            "EnterEventMode": EVENT,
            "EnterContinuousTimeMode": CONTINUOUS,
        }[function]

    @precondition(lambda self: self.phase not in BEFORE)
    @rule(really=st.integers(0, 5))
    def reset(self, really):
        if really == 0 or self.phase == ENDED:
            self.expect("Reset", ok=True)
            self.born()

    # Variables

    def admissible(self, reference, kind, value):
        variable = self.by_reference.get(reference)
        if variable is None or self.unit.type(variable.name) != kind:
            return False
        role = variable.variability if variable.causality == "parameter" else variable.causality
        if self.phase == CONTINUOUS and kind == "Real" and reference in self.states:
            return math.isfinite(value)
        if self.phase not in SETTABLE.get(role, ()) or (self.phase == CONTINUOUS and kind != "Real"):
            return False
        if variable.type == "Enumeration":
            return 1 <= value <= len(variable.declaredType.items)
        if not math.isfinite(value):
            return role == "input" and not self.is_plant
        low, high = (math.inf * sign if m is None else float(m) for m, sign in ((variable.min, -1), (variable.max, 1)))
        return low <= value <= high or variable.type == "Boolean"

    def write(self, kind, pairs):
        references = (ctypes.c_uint * len(pairs))(*(reference for reference, _ in pairs))
        numbers = (ctypes.c_double if kind == "Real" else ctypes.c_int) * len(pairs)
        call = f"Set{kind}", references, len(pairs), numbers(*(value for _, value in pairs))
        ok = all(self.admissible(reference, kind, value) for reference, value in pairs)
        ok &= kind == "Real" or self.phase != CONTINUOUS
        variables = [self.by_reference[reference] for reference, _ in pairs] if ok else []
        if any(v.variability == "tunable" for v in variables) and self.phase in RUNNING:
            if any(v.causality == "input" for v in variables):
                return  # an input stays set where tunables of the same call contradict each other: test_fmu_instance.py
            before = self.unit.everything()
            if self.unit.call(*call) != OK:
                assert self.unit.everything() == before
                return
        else:
            self.expect(*call, ok=ok and self.phase != ENDED)
        if ok and self.phase != ENDED:
            self.values |= {r: bool(value) if kind == "Boolean" else value for r, value in pairs}
            self.trusted &= all(v.causality == "input" and is_tame(v, self.values[v.valueReference]) for v in variables)

    @rule(pairs=st.lists(st.tuples(st.integers(0, 130), WILD), max_size=3))
    def set_real(self, pairs):
        self.write("Real", pairs)

    @rule(pairs=st.lists(st.tuples(st.integers(0, 3), TAME), min_size=1, max_size=3))
    def set_inputs(self, pairs):
        self.write("Real", pairs)

    @rule(
        kind=st.sampled_from(["Integer", "Boolean"]), pairs=st.lists(st.tuples(st.integers(0, 130), WHOLE), max_size=2)
    )
    def set_whole(self, kind, pairs):
        self.write(kind, pairs)

    @rule(kind=st.sampled_from(["Real", "Integer", "Boolean"]), references=st.lists(st.integers(0, 130), max_size=4))
    def get(self, kind, references):
        values = ((ctypes.c_double if kind == "Real" else ctypes.c_int) * len(references))()
        call = f"Get{kind}", (ctypes.c_uint * len(references))(*references), len(references), values
        variables = [self.by_reference.get(reference) for reference in references]
        known = all(v is not None and self.unit.type(v.name) == kind for v in variables)
        calculated = any(v is not None and v.causality in ("output", "local") for v in variables)
        if calculated and self.phase in (INITIALIZING, EVENT, CONTINUOUS):  # brings them up to date, even where refused
            status = self.unit.call(*call)
            assert status == (OK if known else ERROR) or (self.phase == INITIALIZING and not self.trusted)
        else:
            self.expect(*call, ok=known and not (calculated and self.phase == BORN))
        if known and not calculated:
            for reference, value in zip(references, values, strict=True):
                assert value == self.values[reference] or math.isnan(self.values[reference])

    # Time

    @precondition(lambda self: self.phase == READY)
    @rule(steps=st.integers(1, 5))
    def advance(self, steps):
        for _ in range(steps):
            self.do_step(STEP, 0.0)

    @rule(step=st.sampled_from([STEP, STEP, STEP, STEP, STEP / 4, 0.0, -STEP, math.nan, math.inf]),
          ahead=st.sampled_from([0.0, 0.0, 0.0, 0.0, 0.25, -STEP, math.nan]))  # fmt: skip
    def do_step(self, step, ahead):
        right = step > 0 and math.isfinite(step) and ahead == 0 and self.time + step <= self.stop + 1e-6 * step
        if self.phase != READY:
            self.expect("DoStep", self.time + ahead, step, 1, ok=False)
            return
        outputs = self.unit.outputs()
        status = self.unit.call("DoStep", self.time + ahead, step, 1)
        if not right or status != OK:
            assert status == ERROR
            assert not (right and self.trusted)
            assert same(self.unit.outputs(), outputs)
            return
        self.time += step

    @rule(time=st.sampled_from([0.0, 1.0, math.nan, math.inf]))
    def set_time(self, time):
        self.expect("SetTime", time, ok=self.phase in (EVENT, CONTINUOUS) and math.isfinite(time))
        if self.phase in (EVENT, CONTINUOUS) and math.isfinite(time):
            self.time = time

    @precondition(lambda self: self.phase != ENDED and (self.kind == EXCHANGE or self.phase == READY))
    @rule(x=st.lists(TAME, min_size=4, max_size=4) | st.lists(WILD, min_size=3, max_size=5))
    def continuous_states(self, x):
        values, count = (ctypes.c_double * 5)(*x), len(x)
        allowed = self.phase == CONTINUOUS and count == 4
        if allowed and not all(map(math.isfinite, x)):
            before = self.unit.everything()
            assert self.unit.call("SetContinuousStates", values, count) == DISCARD
            assert self.unit.everything() == before
            return
        self.expect("SetContinuousStates", values, count, ok=allowed)
        if allowed:
            back = (ctypes.c_double * 4)()
            self.expect("GetContinuousStates", back, 4, ok=True)
            assert list(back) == x
            self.trusted &= all(abs(value) <= 100 for value in x)
            assert self.unit.call("GetDerivatives", back, 4) in (OK, DISCARD)

    # State

    @rule()
    def save(self):
        known = self.phase, self.set_up, self.time, self.stop, self.trusted, dict(self.values)
        self.saved.append((self.unit.save(), self.unit.everything(), known))

    @precondition(lambda self: self.saved)
    @rule(data=st.data(), serialized=st.booleans())
    def restore(self, data, serialized):
        state, everything, known = data.draw(st.sampled_from(self.saved))
        if serialized:
            state = self.unit.deserialize(everything)
        self.unit.done("SetFMUstate", state)
        assert self.unit.everything() == everything
        self.phase, self.set_up, self.time, self.stop, self.trusted, values = known
        self.values = dict(values)
        if serialized:
            self.unit.done("FreeFMUstate", ctypes.byref(state))

    @rule(data=st.binary(max_size=200), position=st.integers(0, 2**20))
    def restore_damaged(self, data, position):
        good = bytearray(self.unit.everything())
        good[position % len(good)] ^= 1 + position % 255
        for bad in (data, bytes(good)):  # a refusal changes nothing
            self.expect("DeSerializeFMUstate", bad, len(bad), ctypes.byref(ctypes.c_void_p()), ok=False)

    @invariant()
    def outputs_are_finite(self):
        if self.trusted and self.phase not in BEFORE:
            outputs = self.unit.outputs()
            assert all(map(math.isfinite, outputs)), dict(zip(self.unit.output_names, outputs, strict=True))

    def teardown(self):
        if hasattr(self, "unit"):
            for state, _, _ in self.saved:
                self.unit.done("FreeFMUstate", ctypes.byref(state))
            self.unit.free()


def same(one, other):
    return all(a == b or (math.isnan(a) and math.isnan(b)) for a, b in zip(one, other, strict=True))


def is_tame(variable, value):
    return math.isfinite(value) and abs(value) <= (1.0 if variable.name == "pendulum_torque" else 100.0)


@pytest.mark.parametrize(("name", "kind"), [(PLANT, STEPPED), (PLANT, EXCHANGE), (CONTROLLER, STEPPED)])
def test_any_calls_in_any_order(name, kind, native, native_folders):
    make = type(native(name))
    machine = type("Calls", (AnyOrder,), {"make": staticmethod(lambda: make(native_folders[name], kind))})
    run_state_machine_as_test(
        machine,
        settings=settings(
            max_examples=60,
            stateful_step_count=40,
            deadline=None,
            derandomize=True,
            database=None,
            suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
        ),
    )
