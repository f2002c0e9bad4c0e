"""The command `demo`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from filing.ownership import check_replaceable

from ..pendulum_export import EXPORTED, export_units
from .compare import check_folder, run_and_write
from .display import console, escaped, interruptible
from .options import FmusOption

DEMO = {"swing_up": 128, "tilt": 128, "tilt_kalman": 128, "tilt_ideal": 0}
"""The demonstration's scenarios, and their draws of the encoder offsets."""


def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for results.")] = Path("results"),
    fmus: FmusOption = Path("fmus"),
) -> None:
    """Design, export, co-simulate LC, SMC and IHC from hanging down and from a tilt, compare."""
    from ihc_fmu.pendulum.start_values import default_design

    from ..scenario import load_scenario
    from ..studies.experiments import LAWS, Experiment

    check_replaceable(output / "design.json", *(fmus / name for name in EXPORTED))
    for name in DEMO:
        check_folder(output / name, LAWS)
    with interruptible(output, fmus, *(output / name for name in DEMO)):
        console.print("1. design: the paper's A, b and k_lin, inverse design")
        design = default_design()
        design.save(output / "design.json")
        margins = design.certificate
        console.print(
            f"   certified: decrease margin {margins.decrease:.2g} 1/s, monotonicity {margins.monotone:.3g}, P > 0"
        )
        console.print("2. export")
        for path in export_units(design, output=fmus):
            console.print(f"   {escaped(path)}")
        console.print(
            "3. co-simulation: plant ident, 1 ms, 10 V; |q| = hypot(theta, delta); settled: |q| < 0.02 rad to the end"
        )
        experiments = []
        for name, draws in DEMO.items():
            scenario, folder = load_scenario(name)
            experiments.append(Experiment(scenario, folder, draws))
        run_and_write(experiments, fmus, output, list(LAWS))
