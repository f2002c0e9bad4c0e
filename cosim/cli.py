"""The command line `qube-ihc`; also `python -m cosim`."""

from __future__ import annotations

import math
import sys
from contextlib import nullcontext
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .display import (
    console,
    print_claims,
    print_comparison,
    print_design,
    print_metrics,
    print_results,
    print_tuning,
    progress,
    say_error,
    staged_progress,
    warn_of_messages,
)
from .errors import Interrupted, SimulationError, UserError
from .export import Kind, Smc, export_units
from .hil import commands as hil_commands
from .options import SCENARIO_HELP, FmusOption, SetOption, assignments
from .toml_files import read_toml

if TYPE_CHECKING:
    from ihc_fmu.design import Design

FAILED = 1
USAGE = 2

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Implicit homogeneous control of the QUBE-Servo 2: **design** it from a linear controller, **export** plant and "
    "controller as FMUs, **run** scenarios with them, **compare** the laws, **tune** the controller, repeat the **paper**'s "
    "experiments. `demo` does the first four.",
)


class Method(StrEnum):
    """How P and k are found."""

    inverse = "inverse"
    direct = "direct"


hil_commands.register(app)


def main() -> None:
    """Run the command line; a user's mistake is one sentence and exit code 2, a failed run 1, Ctrl-C 130."""
    from fmu_export.native_build import BuildError

    from .hil.device import DeviceError

    try:
        app()
    except (SimulationError, ArithmeticError, BuildError, DeviceError) as error:
        say_error(error)
        sys.exit(FAILED)
    except (UserError, ValueError, OSError) as error:
        say_error(error)
        sys.exit(USAGE)


@app.command()
def design(
    system: Annotated[
        Path | None,
        typer.Option(help="TOML file with A (rows), b and, for the inverse method, k_lin; none: those of the paper."),
    ] = None,
    method: Annotated[
        Method, typer.Option(help="inverse: from k_lin, eqs. (10)-(11); direct: k free, eq. (9).")
    ] = Method.inverse,
    mu: Annotated[float, typer.Option(help="Minus the degree of homogeneity, in (0, 1].")] = 1.0,
    alpha: Annotated[float, typer.Option(help="Decrease to prove: d||x||/dt <= -alpha ||x||^(1-mu) [1/s].")] = 0.2,
    u_max: Annotated[
        float | None, typer.Option(help="Scale of P: largest |k x| on the unit ball [V]; 1.5 if no rule is given.")
    ] = None,
    delta_max: Annotated[
        float | None, typer.Option(help="Scale of P: largest second state (delta) on the unit ball [rad].")
    ] = None,
    beta: Annotated[float, typer.Option(help="Monotonicity of the dilation, G X + X G' >= 2 beta X.")] = 0.1,
    psi: Annotated[float, typer.Option(help="Remark 3: bound of the remainder, adds psi I to the inequality.")] = 0.0,
    d_max: Annotated[
        float, typer.Option(help="Matched disturbance that the proof must reject [V]; mu = 1 only.")
    ] = 0.0,
    output: Annotated[Path, typer.Option("--output", "-o", help="Where to write the design (JSON).")] = Path(
        "design.json"
    ),
) -> None:
    """Turn a linear controller into an implicit homogeneous one and prove it by matrix inequalities.

    Without options this is the paper's example. The numbers, their certificate and the largest feasible alpha are
    printed; the file goes into `export --design`.
    """
    from ihc_fmu.design import InfeasibleError, Options, direct_design, inverse_design, largest_alpha

    A, b, k_lin = _read_system(system, need_gain=method is Method.inverse)
    if u_max is None and delta_max is None:
        u_max = 1.5
    options = Options(mu=mu, alpha=alpha, u_max=u_max, delta_max=delta_max, beta=beta, psi=psi, d_max=d_max)
    try:
        found = direct_design(A, b, options) if method is Method.direct else inverse_design(A, b, k_lin, options)
    except InfeasibleError as error:
        if method is Method.direct or psi or d_max:
            raise
        raise UserError(f"{error}; the largest feasible alpha is {largest_alpha(A, b, k_lin, mu):.4g} 1/s") from None
    found.save(output)
    print_design(found)
    console.print(f"largest feasible alpha for this k_lin and mu: {largest_alpha(A, b, found.k_lin, mu):.4g} 1/s")
    console.print(f"wrote {output}")


def _read_system(path: Path | None, need_gain: bool) -> tuple[Any, Any, Any]:
    """Return A, b, k_lin of a TOML file, the paper's for None."""
    from ihc_fmu.design import PAPER_A, PAPER_B, PAPER_K_LIN

    if path is None:
        return PAPER_A, PAPER_B, PAPER_K_LIN
    data = read_toml(path, "system")
    wanted = ["A", "b", "k_lin"] if need_gain else ["A", "b"]
    missing = [name for name in wanted if name not in data]
    unknown = [name for name in data if name not in ("A", "b", "k_lin")]
    if missing or unknown:
        raise UserError(f"{path} must have A, b and k_lin; missing: {missing or 'none'}, unknown: {unknown or 'none'}")
    import numpy as np

    try:
        return tuple(np.array(data.get(name, []), dtype=float) for name in ("A", "b", "k_lin"))  # type: ignore[return-value]
    except (TypeError, ValueError):
        raise UserError(f"{path}: A must be rows of numbers of equal length, b and k_lin lists of numbers") from None


@app.command()
def export(
    design: Annotated[
        Path | None, typer.Option(help="Design file of the `design` command; none: the default design.")
    ] = None,
    parameters: Annotated[
        str, typer.Option(help="Parameter set of the plant: matrices, ident, hcs, listed, swapped, or a TOML file.")
    ] = "ident",
    nominal: Annotated[str, typer.Option(help="Parameter set of the controller's nominal model.")] = "ident",
    smc: Annotated[
        Smc,
        typer.Option(help="fitted: SMC1, a fit to the paper's tables; linear-poles: SMC2, its linear part is k_lin."),
    ] = Smc.fitted,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder to write to.")] = Path("fmus"),
    change: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="UNIT.VARIABLE=VALUE",
            help="Change a start value, e.g. `controller.a_min=0.7` or `plant.encoder_counts=0`; may be repeated.",
        ),
    ] = None,
    kind: Annotated[
        Kind, typer.Option(help="native: compiled, runs everywhere; python: the same in Python, for Python hosts.")
    ] = Kind.native,
    platforms: Annotated[
        str | None,
        typer.Option(
            help="Platforms of native FMUs, separated by commas: linux64, aarch64-linux, win64, darwin64, or `all`; "
            "none: this machine's. Others are compiled now, which the first time takes minutes."
        ),
    ] = None,
    outputs: Annotated[
        str | None,
        typer.Option(
            metavar="UNIT.OUTPUT,...",
            help="Outputs of the FMUs, separated by commas, for tools that take every output for a real number; the others "
            "become local variables. None: all are outputs.",
        ),
    ] = None,
) -> None:
    """Export plant and controller as FMUs (FMI 2.0), and both with their wires as one SSP file.

    A design or a parameter set only changes start values, so that nothing is compiled. `fmpy info FILE` shows them; each
    FMU carries its documentation. Native FMUs run without Python, the plant also for model exchange.
    """
    from ihc_fmu.start_values import default_design

    changes: dict[str, dict[str, Any]] = {"plant": {}, "controller": {}}
    for name, value in assignments(change):
        unit, dot, variable = name.partition(".")
        if not dot or unit not in changes:
            raise UserError(f"--set must name plant.VARIABLE or controller.VARIABLE, found {name!r}")
        changes[unit][variable] = value
    found = default_design() if design is None else _load_design(design)
    if platforms is not None and kind is Kind.python:
        raise UserError("--platforms is for native FMUs; Python FMUs hold PythonFMU's binaries for its platforms")
    names = None if platforms is None else [name.strip() for name in platforms.split(",")]
    shown = None if outputs is None else [name.strip() for name in outputs.split(",")]
    with console.status("building") if names else nullcontext():
        paths = export_units(found, parameters, nominal, output, changes, smc, kind, names, shown)
    for path in paths:
        console.print(f"wrote {path}")


def _load_design(path: Path) -> Design:
    from ihc_fmu.design import Design

    if not path.is_file():
        raise UserError(f"design file {path} does not exist")
    return Design.load(path)


@app.command()
def run(
    scenario: Annotated[str, typer.Argument(help=SCENARIO_HELP)],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="CSV file to write; none: `results/NAME.csv`.")
    ] = None,
    fmus: FmusOption = Path("fmus"),
    change: SetOption = None,
    engine: Annotated[
        str | None,
        typer.Option(
            help="Loop: `native` (C) or `fmpy` (Python), to the same result; `auto`: native unless an FMU is Python."
        ),
    ] = None,
    plot: Annotated[bool, typer.Option(help="Also write a picture beside the CSV.")] = True,
) -> None:
    """Run one scenario with the exported FMUs; write its signals (CSV, JSON) and a picture, print its metrics.

    A run that fails or is interrupted leaves what was recorded until then in `NAME.partial.csv`.
    """
    from .metrics import can_evaluate
    from .scenario import load_scenario, run_scenario

    chosen, folder = load_scenario(scenario)
    changes = dict(assignments(change)) | ({} if engine is None else {"run.engine": engine})
    chosen = chosen.changed(changes)
    path = output or Path("results") / f"{chosen.name}.csv"
    if path.suffix != ".csv":
        raise UserError(f"--output must name a .csv file, found {path}")
    with progress() as bar:
        task = bar.add_task(chosen.name, total=None)
        try:
            result = run_scenario(
                chosen, fmus, folder, progress=lambda done, total: bar.update(task, completed=done, total=total)
            )
        except (SimulationError, Interrupted) as stopped:
            if len(stopped.result.time):
                partial = path.with_suffix(".partial.csv")  # an earlier complete result stays
                stopped.result.save(partial)
                bar.console.print(f"wrote what was recorded until then, {len(stopped.result.time)} rows, to {partial}")
            raise
    warn_of_messages(result)
    result.save(path)
    console.print(f"wrote {path} and {path.with_suffix('.json')}")
    if plot and can_evaluate(result) and "controller.homogeneous_norm" in result.signals:
        from .plots import save_overview

        console.print(f"wrote {save_overview(result, path.with_suffix('.png'), chosen.description or chosen.name)}")
    if can_evaluate(result):
        print_metrics(result)


@app.command()
def compare(
    scenario: Annotated[
        list[str],
        typer.Argument(help=f"{SCENARIO_HELP} Or results of `run` or `hil` (*.csv)."),
    ],
    laws: Annotated[str, typer.Option(help="Laws to compare, separated by commas.")] = "LC,SMC,IHC",
    draws: Annotated[int, typer.Option(min=0, help="Random encoder offsets per law; 0: the scenario's own, once.")] = 5,
    workers: Annotated[int | None, typer.Option(min=1, help="Threads; none: one per core.")] = None,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for results; the scenario's name is added.")
    ] = Path("results"),
    fmus: FmusOption = Path("fmus"),
    change: SetOption = None,
) -> None:
    """Run a scenario with each law and draw, print the medians as a table, write results and pictures.

    Given results of `run` or `hil` instead, show them side by side.
    """
    from .experiments import LAWS, Study
    from .scenario import load_scenario

    chosen_laws = [law.strip() for law in laws.split(",")]
    unknown = [law for law in chosen_laws if law not in LAWS]
    if unknown or len(set(chosen_laws)) != len(chosen_laws):
        raise UserError(f"--laws must be different ones of {', '.join(LAWS)}, found {laws!r}")
    if all(name.endswith(".csv") for name in scenario):
        _compare_results([Path(name) for name in scenario], output / "compared")
        return
    if len(scenario) > 1:
        raise UserError(f"compare takes one scenario, or results (*.csv), found {', '.join(scenario)}")
    chosen, folder = load_scenario(scenario[0])
    chosen = chosen.changed(dict(assignments(change)))
    _compare([Study(chosen, folder, range(1, draws + 1))], fmus, output, chosen_laws, workers)


def _compare_results(paths: list[Path], folder: Path) -> None:
    from .plots import save_comparison
    from .results import Result

    stems = [path.stem for path in paths]
    names = stems if len(set(stems)) == len(stems) else [str(path.with_suffix("")) for path in paths]
    if len(set(names)) < len(names):
        raise UserError(f"results to compare must be different files, found {', '.join(map(str, paths))}")
    results = {name: Result.load(path) for name, path in zip(names, paths, strict=True)}
    print_results(results)
    save_comparison(results, folder, ", ".join(names))
    console.print(f"pictures in {folder}")


def _compare(studies: list[Any], fmus: Path, output: Path, laws: list[str], workers: int | None = None) -> None:
    from .experiments import compare as run_comparison

    with progress() as bar:
        task = bar.add_task("co-simulation", total=None)
        comparisons = run_comparison(
            studies, fmus, laws, workers, lambda done, total: bar.update(task, completed=done, total=total)
        )
    from .plots import save_comparison

    for comparison in comparisons:
        folder = output / comparison.scenario.name
        comparison.save(folder)
        save_comparison(comparison.results, folder, comparison.scenario.description or comparison.scenario.name)
        print_comparison(comparison)
        console.print(f"results and pictures in {folder}\n")


@app.command()
def tune(
    scenario: Annotated[str, typer.Argument(help=SCENARIO_HELP)],
    measure: Annotated[
        str,
        typer.Option(help="What to make small: integral_q2, steady_rms, settling_time, energy or voltage_variation."),
    ] = "integral_q2",
    most_chattering: Annotated[
        float | None, typer.Option(help="Largest voltage variation per second, relative to the LC's; none: no limit.")
    ] = None,
    a_min: Annotated[str | None, typer.Option(help="Values of a_min, separated by commas; none: 1 to 0.1.")] = None,
    b_max: Annotated[str | None, typer.Option(help="Values of b_max; none: 1, 1.25, 1.6, 2.")] = None,
    u_max: Annotated[
        str | None, typer.Option(help="Scales of P, |k x| on the unit ball [V]; none: 1.5, 3, 10.")
    ] = None,
    mu: Annotated[str | None, typer.Option(help="Values of mu; none: 0.5, 1.")] = None,
    draws: Annotated[int, typer.Option(min=1, help="Random encoder offsets and noise for each point.")] = 8,
    design: Annotated[
        Path | None, typer.Option(help="Design file with your A, b, k_lin and alpha; none: the default design.")
    ] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Threads; none: one per core.")] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder to write to; none: `results/tune_NAME`.")
    ] = None,
    fmus: FmusOption = Path("fmus"),
    change: SetOption = None,
) -> None:
    """Tune a_min, b_max, the scale of P and mu as the paper says: from the LC on, as long as the measure improves.

    Writes all points as a table and a picture, and the best as a scenario and a design. Finished runs are kept: the same
    command, or one with more values, goes on from there.
    """
    from ihc_fmu.start_values import default_design

    from .campaign import Journal
    from .scenario import load_scenario
    from .tuning import PURPOSE, Grid, Problem, save
    from .tuning import tune as run_tuning

    chosen, folder = load_scenario(scenario)
    chosen = chosen.changed(dict(assignments(change)))
    given = {"a_min": a_min, "b_max": b_max, "u_max": u_max, "mu": mu}
    grid = Grid(
        **{name: _numbers(f"--{name.replace('_', '-')}", text) for name, text in given.items() if text is not None}
    )
    limit = math.inf if most_chattering is None else most_chattering
    found = default_design() if design is None else _load_design(design)
    problem = Problem(chosen, folder, fmus, found, measure, limit, draws)
    target = output or Path("results") / f"tune_{chosen.name}"
    with Journal(target / "runs.jsonl", PURPOSE) as journal, staged_progress() as report:
        tuning = run_tuning(problem, grid, journal, workers, report)
    paths = save(tuning, problem, target)
    print_tuning(tuning)
    for path in paths:
        console.print(f"wrote {path}")


def _numbers(option: str, text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise UserError(f"{option} takes numbers separated by commas, found {text!r}") from None


@app.command()
def paper(
    quick: Annotated[
        bool, typer.Option("--quick", help="A smaller study, in less than a minute: 10 draws instead of 200.")
    ] = False,
    draws: Annotated[
        int | None, typer.Option(min=1, help="Random draws for each controller and condition; none: 200, quick 10.")
    ] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Threads; none: one per core.")] = None,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for everything.")] = Path("results/paper"),
    fmus: Annotated[
        Path | None, typer.Option(help="Folder with exported FMUs; none: exports them to `fmus` in the output folder.")
    ] = None,
) -> None:
    """Repeat the paper's section V in simulation and judge each of its claims: figures, tables, one HTML report.

    Interrupt it at any time: finished runs are kept, and the same command goes on from there.
    """
    from dataclasses import replace

    from ihc_fmu.start_values import default_design

    from .paper.report import make
    from .paper.study import FULL, QUICK, Study

    size = QUICK if quick else FULL
    if draws is not None:
        size = replace(size, draws=draws)
    if fmus is None:
        fmus = output / "fmus"
        export_units(default_design(), output=fmus)
    with staged_progress() as report:
        claims = make(Study(output, fmus, size, workers), report)
    print_claims(claims)
    console.print(f"wrote {output / 'report.html'} and the tables, figures and scenarios beside it")


DEMO = {"swing_up": 3, "tilt": 5, "tilt_kalman": 3, "tilt_ideal": 0}
"""The demonstration's scenarios, and their draws of the encoder offsets."""


@app.command()
def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for results.")] = Path("results"),
    fmus: FmusOption = Path("fmus"),
) -> None:
    """Design, export, co-simulate LC, SMC and IHC from hanging down and from a tilt, compare."""
    from ihc_fmu.start_values import default_design

    from .experiments import LAWS, Study
    from .scenario import load_scenario

    console.print("1. design: the paper's A, b and k_lin, inverse design")
    found = default_design()
    found.save(output / "design.json")
    margins = found.certificate
    console.print(
        f"   certified: decrease margin {margins.decrease:.2g} 1/s, monotonicity {margins.monotone:.3g}, P > 0"
    )
    console.print("2. export")
    for path in export_units(found, output=fmus):
        console.print(f"   {path}")
    console.print(
        "3. co-simulation: plant ident, 1 ms, 10 V; |q| = hypot(theta, delta); settled: |q| < 0.02 rad to the end"
    )
    studies = []
    for name, draws in DEMO.items():
        chosen, folder = load_scenario(name)
        studies.append(Study(chosen, folder, range(1, draws + 1)))
    _compare(studies, fmus, output, list(LAWS))
