"""What the homogeneous law brings and costs on the plants in examples/, as a table: `make_tables.py --examples` writes it.

Each plant twice, with the design that `qube-ihc design` chooses: the nonlinear plant of the example's scenario, and the
linear one from the same state with its positions counted, by which a Kalman filter estimates the state.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cosim.scenario import Scenario, load_scenario
from cosim.studies.comparison import Comparison
from cosim.studies.estimates import change_text, estimate_text
from cosim.studies.experiments import Experiment, run_experiments
from cosim.system_export import export_system, exported_files
from ihc_fmu.design import Design
from ihc_fmu.inverse import inverse_design
from ihc_fmu.quantity import Quantity
from ihc_fmu.synthesis import chosen_options
from ihc_fmu.system import System

EXAMPLES = Path(__file__).parents[1] / "examples"
LAWS = ("LC", "IHC")
DRAWS = 16
STEPS = {"rad": 2.0 * np.pi / 4096, "m": 1e-4}
"""Steps of the sensors of the linear plants, by the unit of what they count."""
SETTLED = 0.02
"""|e| that counts as settled [m or rad]."""


@dataclass(frozen=True)
class Example:
    """A plant by the name of its folder: its positions that are judged, and those that are only counted."""

    name: str
    positions: tuple[str, ...]
    besides: tuple[str, ...] = ()

    @property
    def scenario(self) -> Scenario:
        """Its scenario, judged by the positions together, a metre as much as a radian."""
        found, _ = load_scenario(str(EXAMPLES / self.name / f"{self.name}_run.toml"))
        errors = [f"plant.{name}" for name in self.positions]
        judged = {"evaluate.errors": errors, "evaluate.scales": [1.0] * len(errors), "evaluate.tolerance": SETTLED}
        return found.changed(judged)

    def design(self) -> Design:
        """Return the design that the command `design` makes without options."""
        system = System.load(EXAMPLES / self.name / f"{self.name}.toml")
        return inverse_design(system, chosen_options(system).options)


ALL = (
    Example("crane", ("position", "angle")),
    Example("arm", ("shoulder", "elbow")),
    Example("double_pendulum", ("position", "angle_1", "angle_2")),
    Example("rotorcraft", ("x", "z", "pitch")),
    Example("servo", ("load_angle",), ("motor_angle",)),
)


def nonlinear(example: Example, design: Design, folder: Path) -> Comparison:
    """Return the laws on the plant of the example's scenario."""
    source, plant = f"{example.name}/{example.name}.py", folder / f"{example.name}.fmu"
    options = ["--handle-state", "--serialize-state", "-f", source, "-d", str(plant), "rk4_plant.py"]
    subprocess.run(
        [sys.executable, "-m", "pythonfmu", "build", *options], cwd=EXAMPLES, check=True, capture_output=True
    )
    export_system(design, folder)
    return run_experiments([Experiment(example.scenario, folder)], folder, LAWS)[0]


def counted(example: Example, design: Design, folder: Path) -> Comparison:
    """Return the laws on the linear plant, whose counted positions are all that is measured, from the same state."""
    states = [q.name for q in design.system.states]
    chosen = [states.index(name) for name in (*example.positions, *example.besides)]
    quantities = [design.system.states[i] for i in chosen]
    system = design.system.changed(
        name=f"{example.name}_counted",
        C=np.eye(design.n)[chosen],
        outputs=tuple(Quantity(f"{q.name}_sensor", q.unit) for q in quantities),
        resolutions=np.array([STEPS[q.unit] for q in quantities]),
    )
    export_system(replace(design, system=system), folder)
    plant, controller, _ = exported_files(system)
    scenario = example.scenario.changed({"plant.fmu": plant, "controller.fmu": controller})
    return run_experiments([Experiment(scenario, folder, DRAWS)], folder, LAWS)[0]


def ideal_row(found: Comparison) -> list[str]:
    """Return a plant's cells of the first table."""
    settling = [_value(found, law, "settling_time") for law in LAWS]
    return settling + [_change(found, name) for name in ("settling_time", "integral_e2", "energy", _peak(found))]


def counted_row(found: Comparison) -> list[str]:
    """Return a plant's cells of the second table."""
    cells = [_value(found, law, name) for name in ("settling_time", "steady_rms") for law in LAWS]
    variations = [_value(found, law, "control_variation") for law in LAWS]
    return [*cells, _change(found, "energy"), *variations, found.quantities["control_variation"].unit]


def tables(examples: Sequence[Example] = ALL) -> str:
    """Return both tables."""
    first = ["plant", *(f"{law}: settling [s]" for law in LAWS), "IHC over LC: settling", "∫e² dt", "∫u² dt", "peak u"]
    columns = (f"{law}: {what}" for what in ("settling [s]", "steady RMS e") for law in LAWS)
    second = ["plant, counted", *columns, "IHC over LC: ∫u² dt", *(f"{law}: variation of u" for law in LAWS), "unit"]
    rows: tuple[list[list[str]], list[list[str]]] = ([first], [second])
    for example in examples:
        design = example.design()
        with tempfile.TemporaryDirectory() as folder:
            rows[0].append([example.name, *ideal_row(nonlinear(example, design, Path(folder)))])
            rows[1].append([example.name, *counted_row(counted(example, design, Path(folder)))])
    return "\n".join(map(_markdown, rows))


def _markdown(rows: list[list[str]]) -> str:
    head, *rest = (f"| {' | '.join(row)} |\n" for row in rows)
    return head + "|---" * len(rows[0]) + "|\n" + "".join(rest)


def _peak(found: Comparison) -> str:
    """Return the name of the peak that the IHC raises most."""
    peaks = [name for name in found.shown if name.startswith("peak")]
    return max(peaks, key=lambda name: found.change("IHC", "LC", name).value)


def _value(found: Comparison, law: str, name: str) -> str:
    mark = "" if found.steady(law) or not found.quantities[name].of_window else "*"
    return estimate_text(found.value(law, name), found.quantities[name].text) + mark


def _change(found: Comparison, name: str) -> str:
    return change_text(found.change("IHC", "LC", name))
