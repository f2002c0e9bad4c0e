"""A unit with as many variables as there may be: up to 16 tanks and 8 pumps, see native/tanks/tanks.h."""

from pathlib import Path

from fmu_export.errors import UserError
from fmu_export.model_description import ModelExchange
from fmu_export.native_unit import NativeUnit
from fmu_export.variables import Interface, Variability, Variable

MOST, PUMPS, CHART = 16, 8, 50


def parameter(name, start, description="a parameter", variability: Variability = "fixed", **rest):
    return Variable(name, "parameter", description, variability=variability, start=start, **rest)


def numbered(name, *sizes):
    """Return NAME_1, NAME_2, ... or NAME_1_1, NAME_1_2, ..."""
    if not sizes:
        return [name]
    return [full for i in range(sizes[0]) for full in numbered(f"{name}_{i + 1}", *sizes[1:])]


TABLE = Interface(
    name="Tanks",
    description="Tanks that pumps fill",
    variables=(
        *[
            Variable(name, "input", "inflow", "m3/s", start=0.0, fault_on_non_finite=True)
            for name in numbered("flow", PUMPS)
        ],
        *[
            Variable(name, "output", "level of the water", "m", initial_dependencies=(f"begin_{i}", "count"))
            for i, name in enumerate(numbered("level", MOST), 1)
        ],
        *[Variable(name, "local", "rate of a level", "m/s") for name in numbered("level_rate", MOST)],
        Variable("total", "output", "weighted sum of the levels", "m"),
        Variable("corner", "output", "last entry of the chart"),
        Variable(
            "mode", "output", "what happens", type="Enumeration", variability="discrete", items=("calm", "filling")
        ),
        parameter("count", 1, type="Integer", min=1, max=MOST),
        parameter("strategy", 1, variability="tunable", type="Enumeration", items=("free", "none")),
        parameter("low", 0.0, variability="tunable", unit="m3/s"),
        parameter("high", 10.0, variability="tunable", unit="m3/s"),
        *[parameter(name, 1.0, unit="1/s", min=1e-6) for name in numbered("rate", MOST)],
        *[parameter(name, 0.0) for name in numbered("gain", MOST, PUMPS)],
        *[parameter(name, 0.0, unit="m") for name in numbered("begin", MOST)],
        *[parameter(name, 1, type="Integer", min=-9, max=9) for name in numbered("kinds", MOST)],
        *[parameter(name, 0.0) for name in numbered("chart", CHART, CHART)],
    ),
    step_size=0.1,
    stop_time=1.0,
    variable_step=True,
)


class Tanks:
    """The twin, as far as an export needs it: it refuses what contradicts itself, in the words of the table."""

    def __init__(self, values):
        assert set(values) == {v.name for v in TABLE.variables if not v.calculated}
        if values["low"] > values["high"]:
            raise UserError(f"low must not exceed high, found {values['low']:g} and {values['high']:g}")


def exchange(values):
    """Return the structure for model exchange of `count` tanks."""
    n = int(values["count"])
    levels, rates = numbered("level", n), numbered("level_rate", n)
    dependencies = dict.fromkeys(numbered("level", MOST), ()) | {
        "corner": (),
        "mode": tuple(numbered("flow", PUMPS)),
    }
    for i, (level, rate) in enumerate(zip(levels, rates, strict=True), 1):
        flows = [f"flow_{j}" for j in range(1, PUMPS + 1) if values[f"gain_{i}_{j}"]]
        dependencies |= {level: (level,), rate: (level, *flows)}
    dependencies["total"] = tuple(level for i, level in enumerate(levels, 1) if values[f"kinds_{i}"])
    return ModelExchange(tuple(levels), tuple(rates), dependencies, {"mode": ("low", "high", "strategy")})


NATIVE = NativeUnit(
    interface=TABLE,
    twin=Tanks,
    folder=Path(__file__).parent / "native" / "tanks",
    stem="tanks",
    prefix="tanks",
    model_exchange=exchange,
    largest_model_exchange=exchange({**TABLE.start_values(), "count": MOST}),
    constants={"TANKS_MOST": MOST, "TANKS_PUMPS": PUMPS, "TANKS_CHART": CHART},
)
