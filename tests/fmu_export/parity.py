"""The native FMU and the Python unit under any admissible numbers: the same outputs, or a refusal in the same words."""

import math

import numpy as np
from fmpy.fmi1 import FMICallException

from fmu_export.errors import UserError
from tests.fmu_export.conftest import Host

STEP = 1e-3


def extreme_values(interface, rng, start):
    """A few parameters at their bounds, tiny, huge, or somewhat off their start values."""
    values = {}
    for v in rng.sample(interface.of("parameter"), rng.randint(1, 6)):
        low, high = v.limits()
        if v.type != "Real":
            few = [0, 1, int(low) if math.isfinite(low) else 0, int(high) if math.isfinite(high) else 2**31 - 1]
            candidates = few[:2] if v.type == "Boolean" else [value for value in few if low <= value <= high]
        else:
            near = [start.get(v.name, v.start) * f for f in (0.0, 1e-3, 0.5, 2.0, 1e3)]
            wide = [s * 10.0**e for s in (-1, 1) for e in (-320, -300, -12, -3, 0, 3, 12, 150, 300)]
            candidates = [value for value in (low, high, *near, *wide) if low <= value <= high and math.isfinite(value)]
        values[v.name] = rng.choice(candidates)
    return values


def answer_of_python(call, *arguments):
    try:
        return call(*arguments)
    except (UserError, ArithmeticError) as error:
        return str(error)


def answer_of_native(native, call, *arguments, **values):
    """Return what the call returns, or the sentence of its refusal."""
    try:
        return call(*arguments, **values)
    except FMICallException:
        return native.log[-1][2].splitlines()[0]


def compare(folder, interface, twin, start, changes, rows, exact):
    """Run both from `start` with `changes` under the rows of inputs; return how it ended: refused, failed or ran."""
    names = [v.name for v in interface.of("input")]
    values = interface.start_values({**start, **changes})
    native = Host(folder)

    def begin():
        unit = twin(values)
        unit.initialize(0.0, (0.0,) * len(names))
        return unit

    try:
        python = answer_of_python(begin)
        answer = answer_of_native(native, native.initialize, **changes)
        if isinstance(python, str):
            assert answer == python, changes
            return "refused"
        for k, row in enumerate(rows):
            assert not isinstance(answer, str), (changes, answer)
            np.testing.assert_allclose(
                np.array(native.outputs(), float), np.array(python.outputs(), float), rtol=0.0 if exact else 1e-12
            )
            said = answer_of_python(python.step, k * STEP, STEP, row)
            native.log.clear()
            answer = answer_of_native(native, native.step, k * STEP, STEP, **dict(zip(names, row, strict=True)))
            if isinstance(said, str):
                assert answer == said, changes
                return "failed"
            assert [text for _, _, text in native.log] == [f"t = {k * STEP:.9g} s: {text}" for text in said], changes
        return "ran"
    finally:
        native.slave.freeInstance()
