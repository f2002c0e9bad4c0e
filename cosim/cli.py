"""The command line `qube-ihc`; also `python -m cosim`."""

from __future__ import annotations

import errno
import importlib.metadata
import math
import os
import secrets
import sys
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from filing.ownership import check_replaceable, is_ours

from . import plant_commands, signals
from .display import (
    console,
    degrade_output,
    escaped,
    print_claims,
    print_comparison,
    print_design,
    print_metrics,
    print_results,
    print_tuning,
    problems,
    progress,
    say_error,
    say_fault,
    say_notes,
    staged_progress,
    warn_of_messages,
)
from .errors import Interrupted, SimulationError, UserError
from .export import EXPORTED, Kind, Smc, export_units
from .hil import commands as hil_commands
from .options import SCENARIO_HELP, FmusOption, SetOption, assignments, varied
from .system_export import export_system, exported_files

if TYPE_CHECKING:
    from ihc_fmu.design import Design

    from .results import Result
    from .scenario import Scenario

FAILED, USAGE, FAULT, CTRL_C = 1, 2, 70, 130
"""Exit codes; 70 is EX_SOFTWARE of sysexits.h."""

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

OUTPUT_LOST = (errno.ENOSPC, errno.EIO)
"""What writing to a full disk or to a terminal that is gone ends with; a file that has a name is named by UserError."""


class Method(StrEnum):
    """How P and k are found."""

    inverse = "inverse"
    direct = "direct"


hil_commands.register(app)
plant_commands.register(app)


def _show_version(wanted: bool) -> None:
    if wanted:
        console.print(f"qube-ihc {importlib.metadata.version('qube-ihc')}", highlight=False)
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of every error.")] = False,
) -> None:
    """Take the options that stand before a command; `main` has seen to --debug."""


def main() -> None:
    """Run the command line; its exit code says how it ended.

    0: well; 1: a run, a device or a compiler failed; 2: the user's mistake, in one sentence; 70: a fault of this program,
    with its traceback; 128 + n: signal n. The option --debug may stand anywhere and shows the traceback of every error.
    """
    from fmu_export.native_build import BuildError, CompilerMissingError

    from .fmu import FmuError
    from .hil.device import DeviceError

    signals.as_ctrl_c()
    degrade_output()
    arguments = [argument for argument in sys.argv[1:] if argument != "--debug"]
    debug = len(arguments) < len(sys.argv) - 1
    try:
        try:
            app(arguments)
        finally:
            sys.stdout.flush()
    except SystemExit as end:
        if end.code == CTRL_C:  # Typer makes this of a KeyboardInterrupt
            sys.exit(signals.exit_code())
        raise
    except UserError as error:
        say_error(error, traceback=debug)
        sys.exit(USAGE)
    except CompilerMissingError as error:
        say_error(error, f"{error}; pip install 'qube-ihc[cross]'", traceback=debug)
        sys.exit(FAILED)
    except (SimulationError, FmuError, BuildError, DeviceError) as error:
        say_error(error, traceback=debug)
        sys.exit(FAILED)
    except MemoryError as error:
        say_error(error, "there is not enough memory", traceback=debug)
        sys.exit(FAILED)
    except Exception as error:
        if not (isinstance(error, OSError) and error.filename is None and error.errno in OUTPUT_LOST):
            say_fault(error)
            sys.exit(FAULT)
        _discard_output()
        say_error(error, f"the output cannot be written: {error.strerror}", traceback=debug)
        sys.exit(FAILED)


def _discard_output() -> None:
    """Drop what is left to be written to an output that takes no more; to a terminal, the error output stays."""
    nothing = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            os.dup2(nothing, stream.fileno())


@app.command()
def design(
    system: Annotated[
        Path | None,
        typer.Option(
            help="TOML file of a system: A, B and, for the inverse method, K or lqr; none: the paper's pendulum."
        ),
    ] = None,
    method: Annotated[
        Method, typer.Option(help="inverse: from K, eqs. (10)-(11); direct: K free, eq. (9).")
    ] = Method.inverse,
    mu: Annotated[
        float | None, typer.Option(help="Minus the degree of homogeneity, in (0, 1]; none: 1, or the largest found.")
    ] = None,
    alpha: Annotated[
        float | None,
        typer.Option(help="Decrease to prove: d||x||/dt <= -alpha ||x||^(1-mu) [1/s]; none: half of the largest one."),
    ] = None,
    u_max: Annotated[
        str | None,
        typer.Option(
            help="Scale of P: largest homogeneous part |(K - K_0) x| of the control on the unit ball, a number or one per "
            "input, separated by commas; none: half of what the limits leave."
        ),
    ] = None,
    delta_max: Annotated[float | None, typer.Option(help="Scale of P: largest state --state on the unit ball.")] = None,
    state: Annotated[
        str | None, typer.Option(help="Name of the state that --delta-max bounds; none: the second.")
    ] = None,
    beta: Annotated[float, typer.Option(help="Monotonicity of the dilation, G X + X G' >= 2 beta X.")] = 0.1,
    psi: Annotated[float, typer.Option(help="Remark 3: bound of the remainder, adds psi I to the inequality.")] = 0.0,
    d_max: Annotated[
        float, typer.Option(help="Matched disturbance that the proof must reject, in units of the input; mu = 1 only.")
    ] = 0.0,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Where to write the design; none: `design.json`.")
    ] = None,
) -> None:
    """Turn a linear controller into an implicit homogeneous one and prove it by matrix inequalities.

    Without options this is the paper's example. The numbers, why they were chosen, their certificate and the largest
    feasible alpha are printed; the file goes into `export --design`.
    """
    from . import designing

    path = output or Path("design.json")
    if path.suffix != ".json":
        raise UserError(f"--output must name a .json file, found {path}")
    check_replaceable(path, kind="design")
    wish = designing.Wish(method is Method.direct, mu, alpha, u_max, delta_max, state, beta, psi, d_max)
    with problems.status("solving the matrix inequalities") as shown:
        found, reasons = designing.find(*designing.system_and_wish(system, wish), shown.update)
        found.save(path)
        print_design(found, reasons)
        console.print(f"largest feasible alpha for this gain and mu: {escaped(designing.largest(found, shown.update))}")
    console.print(f"wrote {escaped(path)}")


@app.command()
def export(
    design: Annotated[
        Path | None, typer.Option(help="Design file of the `design` command; none: the default design.")
    ] = None,
    parameters: Annotated[
        str | None,
        typer.Option(
            help="Pendulum: parameter set of the plant: matrices, ident, hcs, listed, swapped, or a TOML file; none: ident."
        ),
    ] = None,
    nominal: Annotated[
        str | None, typer.Option(help="Pendulum: parameter set of the controller's nominal model; none: ident.")
    ] = None,
    smc: Annotated[
        Smc | None,
        typer.Option(
            help="Pendulum: fitted: SMC1, a fit to the paper's tables; linear-poles: SMC2, its linear part is k_lin; none: "
            "fitted."
        ),
    ] = None,
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
    other_model: Annotated[
        bool, typer.Option("--other-model", help="Export a design for another model than the plant's all the same.")
    ] = False,
) -> None:
    """Export plant and controller as FMUs (FMI 2.0), and both with their wires as one SSP file.

    Without a design, or with one of a system named rotary_pendulum, these are the QUBE-Servo 2 and its controller with
    swing-up; with another, a linear plant of the design's matrices and the controller of the design, named after its system.
    A design or a parameter set only changes start values, so that nothing is compiled. `fmpy info FILE` shows them; each
    FMU carries its documentation. Native FMUs run without Python, the plant also for model exchange.
    """
    from ihc_fmu.controller import resampled
    from ihc_fmu.estimation import remarks as remarks_of
    from ihc_fmu.pendulum.start_values import default_design
    from ihc_fmu.system import PENDULUM

    from . import certified

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
    of_pendulum = found.system.name == PENDULUM
    if not of_pendulum:
        given = {"--parameters": parameters, "--nominal": nominal, "--smc": smc, "--other-model": other_model or None}
        _refuse_pendulums(given, found.system.name)
    check_replaceable(*(output / name for name in (EXPORTED if of_pendulum else exported_files(found.system))))
    with console.status("building") if names else nullcontext() as status:
        building = None if status is None else lambda what: status.update(f"building {what}")
        if of_pendulum:
            paths = export_units(
                found,
                parameters or "ident",
                nominal or "ident",
                output,
                changes,
                smc or Smc.fitted,
                kind,
                names,
                building,
                shown,
                other_model=other_model,
            )
        else:
            found = resampled(found, changes["controller"].get("sample_time"))
            paths = export_system(found, output, changes, kind, names, building, shown)
            say_notes(remarks_of(found))
    say_notes(certified.remarks(certified.start_values(found), changes["controller"]))
    for path in paths:
        console.print(f"wrote {escaped(path)}")


def _refuse_pendulums(given: Mapping[str, object], system: str) -> None:
    """Raise UserError for an option that only the pendulum's units have."""
    for option, value in given.items():
        if value is not None:
            raise UserError(f"{option} is for the rotary pendulum's units, found with a design of the system {system}")


def _load_design(path: Path) -> Design:
    from ihc_fmu.design import Design

    return Design.load(path)


def _loaded(name: str, fmus: Path) -> tuple[Scenario, Path, Path]:
    """Return (scenario, its folder, the folder of its FMUs): an SSP file has its own."""
    from .scenario import load_scenario
    from .ssp import SUFFIX

    chosen, folder = load_scenario(name)
    return chosen, folder, folder if Path(name).suffix == SUFFIX else fmus


@app.command()
def ssp(
    scenario: Annotated[str, typer.Argument(help=SCENARIO_HELP)],
    output: Annotated[Path | None, typer.Option("--output", "-o", help="File to write; none: `NAME.ssp`.")] = None,
    fmus: FmusOption = Path("fmus"),
    change: SetOption = None,
) -> None:
    """Write a scenario as one SSP file: FMUs, wires, start values, step and duration; `run` runs it, other tools too.

    Signals and disturbances have no place in it.
    """
    from .master import Coupling
    from .scenario import build_system
    from .ssp import SUFFIX, write

    chosen, folder, fmus = _loaded(scenario, fmus)
    chosen = chosen.changed(dict(assignments(change)))
    path = output or Path(f"{chosen.name}{SUFFIX}")
    if path.suffix != SUFFIX:
        raise UserError(f"--output must name a {SUFFIX} file, found {path}")
    system = build_system(chosen, fmus, folder)
    start = Coupling(system).start
    system = replace(system, components=[replace(c, start=start[c.name]) for c in system.components])
    say_notes(f"an SSP has no signals: {s.target} keeps its start value there" for s in system.signals)
    written = write(path, chosen.name, system, chosen.run.duration, chosen.run.step)
    console.print(f"wrote {escaped(written)}")


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
    from .metrics import can_draw, can_evaluate
    from .scenario import build_system, remarks, rest_remarks, run_scenario

    chosen, folder, fmus = _loaded(scenario, fmus)
    changes = dict(assignments(change)) | ({} if engine is None else {"run.engine": engine})
    chosen = chosen.changed(changes)
    path = output or Path("results") / f"{chosen.name}.csv"
    if path.suffix != ".csv":
        raise UserError(f"--output must name a .csv file, found {path}")
    unfinished = path.with_suffix(".partial.csv")  # an earlier complete result stays
    check_replaceable(
        *(file.with_suffix(suffix) for file in (path, unfinished) for suffix in (".csv", ".json")), kind="result"
    )
    if plot:
        check_replaceable(path.with_suffix(".png"))
    system = build_system(chosen, fmus, folder)
    say_notes(remarks(system, chosen))
    with progress() as bar:
        task = bar.add_task(chosen.name, total=None)
        try:
            result = run_scenario(
                chosen,
                fmus,
                folder,
                progress=lambda done, total: bar.update(task, completed=done, total=total),
                target=path.parent,
            )
        except (SimulationError, Interrupted) as stopped:
            if len(stopped.result.time):
                partial = _save(stopped.result, unfinished)
                count = len(stopped.result.time)
                bar.console.print(f"wrote what was recorded until then, {count} rows, to {escaped(partial)}")
            raise
        try:
            _save(result, path)
        except KeyboardInterrupt:
            bar.console.print(f"interrupted while it was written: {escaped(path)} is whole")
            raise
    earlier = path.with_suffix(".png")
    if not plot and earlier.is_file() and is_ours(earlier):
        earlier.unlink()
        console.print(f"removed {escaped(earlier)}, the picture of an earlier run")
    warn_of_messages(result)
    say_notes(rest_remarks(result, system))
    console.print(f"wrote {escaped(path)} and {escaped(path.with_suffix('.json'))}")
    if plot and can_evaluate(result) and can_draw(result):
        from .plots import save_overview

        picture = save_overview(result, path.with_suffix(".png"), chosen.description or chosen.name)
        console.print(f"wrote {escaped(picture)}")
    if can_evaluate(result):
        print_metrics(result)


def _save(result: Result, path: Path) -> Path:
    """Write a result; where that fails, as on a full disk, write it to the temporary folder and raise with its place."""
    import tempfile

    try:
        result.save(path)
    except UserError as error:
        rescued = Path(tempfile.gettempdir()) / f"qube-ihc-rescued-{secrets.token_hex(4)}" / path.name
        try:
            result.save(rescued)
        except UserError:
            raise error from None
        raise UserError(f"{error}; the rows are in {rescued}") from None
    return path


@app.command()
def compare(
    scenario: Annotated[
        list[str],
        typer.Argument(help=f"{SCENARIO_HELP} Or results of `run` or `hil` (*.csv)."),
    ],
    laws: Annotated[
        str | None,
        typer.Option(
            help="Laws to compare, separated by commas; none: those of LC, SMC and IHC that the controller has."
        ),
    ] = None,
    vary: Annotated[
        str | None,
        typer.Option(
            metavar="ENTRY=VALUE,...",
            help="Compare values of another entry of the scenario than the law, e.g. `controller.start.a_min=0.2,0.5,1`.",
        ),
    ] = None,
    draws: Annotated[
        int,
        typer.Option(
            min=0,
            help="Encoder offsets, the same for all laws: a Sobol set, best a power of two; 0: the scenario's, once. "
            "A plant without encoders is run once.",
        ),
    ] = 128,
    workers: Annotated[int | None, typer.Option(min=1, help="Threads; none: one per core.")] = None,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for results; the scenario's name is added.")
    ] = Path("results"),
    fmus: FmusOption = Path("fmus"),
    change: SetOption = None,
) -> None:
    """Run a scenario with each law and draw; print means with their intervals and what they decide, write results, pictures.

    Given results of `run` or `hil` instead, show them side by side.
    """
    from .experiments import LAW, LAWS, Study, check_names, laws_of
    from .scenario import build_system, remarks

    if laws is not None and vary is not None:
        raise UserError("compare takes --laws or --vary, not both")
    if all(name.endswith(".csv") for name in scenario):
        _compare_results([Path(name) for name in scenario], output / "compared")
        return
    if len(scenario) > 1:
        raise UserError(f"compare takes one scenario, or results (*.csv), found {', '.join(scenario)}")
    chosen, folder, fmus = _loaded(scenario[0], fmus)
    chosen = chosen.changed(dict(assignments(change)))
    if vary is not None:
        entry, values = varied(vary)
        names = list(values)
    else:
        entry, values, known = LAW, None, laws_of(chosen, fmus, folder)
        names = [name for name in known if name in LAWS] if laws is None else [law.strip() for law in laws.split(",")]
        if not names or not set(names) <= set(known) or len(set(names)) < len(names):
            raise UserError(f"--laws must be different ones of {', '.join(known)}, found {laws or ', '.join(names)!r}")
    check_names(names)
    say_notes(remarks(build_system(chosen, fmus, folder), chosen))
    _check_folder(output / chosen.name, names)
    _compare([Study(chosen, folder, draws, entry, values)], fmus, output, names, workers)


def _check_folder(folder: Path, laws: Sequence[str] = ()) -> None:
    """Raise UserError where a comparison in `folder` would replace a file that is not this project's."""
    from .plots import COMPARISON

    files = [f"{name}{suffix}" for name in (*laws, "comparison") for suffix in (".csv", ".json")] if laws else []
    check_replaceable(*(folder / name for name in (*files, *(f"{name}.png" for name in COMPARISON))))


def _compare_results(paths: list[Path], folder: Path) -> None:
    from filing.files import staging

    from .hil.overlay import alike
    from .plots import save_comparison
    from .results import Result

    stems = [path.stem for path in paths]
    names = stems if len(set(stems)) == len(stems) else [str(path.with_suffix("")) for path in paths]
    if len(set(names)) < len(names):
        raise UserError(f"results to compare must be different files, found {', '.join(map(str, paths))}")
    results = alike({name: Result.load(path) for name, path in zip(names, paths, strict=True)})
    _check_folder(folder)
    print_results(results)
    with staging(folder) as place:
        save_comparison(results, place, ", ".join(names))
    console.print(f"pictures in {escaped(folder)}")


def _compare(studies: list[Any], fmus: Path, output: Path, laws: list[str], workers: int | None = None) -> None:
    from .experiments import compare as run_comparison
    from .plots import save_comparison

    written: list[str] = []
    try:
        with progress() as bar:
            task = bar.add_task("co-simulation", total=None)
            comparisons = run_comparison(
                studies, fmus, laws, workers, lambda done, total: bar.update(task, completed=done, total=total)
            )
        for comparison in comparisons:
            folder = output / comparison.scenario.name
            title = comparison.scenario.description or comparison.scenario.name
            comparison.save(folder, partial(save_comparison, comparison.results, title=title))
            written.append(comparison.scenario.name)
            print_comparison(comparison)
            console.print(f"results and pictures in {escaped(folder)}\n")
    except KeyboardInterrupt:
        kept = f"whole: {', '.join(written)}" if written else "nothing was kept"
        console.print(f"interrupted: a comparison is written whole or not at all; {escaped(kept)}")
        raise


@app.command()
def tune(
    scenario: Annotated[str, typer.Argument(help=SCENARIO_HELP)],
    measure: Annotated[
        str | None,
        typer.Option(
            help="Metric to make small; of the pendulum integral_q2, steady_rms, settling_time, energy or "
            "voltage_variation; none: the integral of the squared error."
        ),
    ] = None,
    most_chattering: Annotated[
        float | None, typer.Option(help="Largest variation of the controls, relative to the LC's; none: no limit.")
    ] = None,
    a_min: Annotated[str | None, typer.Option(help="Values of a_min, separated by commas; none: 1 to 0.1.")] = None,
    b_max: Annotated[str | None, typer.Option(help="Values of b_max; none: 1, 1.25, 1.6, 2.")] = None,
    u_max: Annotated[
        str | None, typer.Option(help="Scales of the pendulum's P, |k x| on the unit ball [V]; none: 1.5, 3, 10.")
    ] = None,
    mu: Annotated[str | None, typer.Option(help="Values of the pendulum's mu; none: 0.5, 1.")] = None,
    draws: Annotated[
        int, typer.Option(min=1, help="Encoder offsets and noise, the same for each point; best a power of two.")
    ] = 16,
    design: Annotated[
        Path | None,
        typer.Option(
            help="The pendulum's design file with your A, b, k_lin and alpha; none: the default design. Another "
            "controller keeps the design that it was exported with."
        ),
    ] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Threads; none: one per core.")] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder to write to; none: `results/tune_NAME`.")
    ] = None,
    fmus: FmusOption = Path("fmus"),
    change: SetOption = None,
) -> None:
    """Tune a_min and b_max, of the pendulum the scale of P and mu too: from the LC on, as long as the measure improves.

    Writes all points as a table and a picture, and the best as a scenario and a design. Finished runs are kept: the same
    command, or one with more values, goes on from there.
    """
    from ihc_fmu.pendulum.start_values import default_design

    from .campaign import Journal
    from .pendulum import is_controller
    from .scenario import controller_values
    from .tuning import PURPOSE, WRITTEN_FILES, Grid, Problem, save
    from .tuning import tune as run_tuning

    chosen, folder, fmus = _loaded(scenario, fmus)
    chosen = chosen.changed(dict(assignments(change)))
    given = {"a_min": a_min, "b_max": b_max, "u_max": u_max, "mu": mu}
    grid = Grid(
        **{name: _numbers(f"--{name.replace('_', '-')}", text) for name, text in given.items() if text is not None}
    )
    limit = math.inf if most_chattering is None else most_chattering
    found = None if design is None else _load_design(design)
    if found is None and is_controller(controller_values(chosen, fmus, folder)):
        found = default_design()
    if found is None and (u_max is not None or mu is not None):
        raise UserError("--u-max and --mu are for the pendulum's controller; another keeps those of its design")
    problem = Problem(chosen, folder, fmus, found, measure, limit, draws)
    target = output or Path("results") / f"tune_{chosen.name}"
    check_replaceable(*(target / name for name in WRITTEN_FILES))
    with Journal(target / "runs.sqlite", PURPOSE) as journal, staged_progress() as report:
        tuning = run_tuning(problem, grid, journal, workers, report)
    paths = save(tuning, problem, target)
    print_tuning(tuning)
    for path in paths:
        console.print(f"wrote {escaped(path)}")


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
    from ihc_fmu.pendulum.start_values import default_design

    from .paper.report import make
    from .paper.study import FULL, QUICK, Study

    size = QUICK if quick else FULL
    if draws is not None:
        size = replace(size, draws=draws)
    check_replaceable(output / "report.html")
    if fmus is None:
        fmus = output / "fmus"
        export_units(default_design(), output=fmus)
    with staged_progress() as report:
        claims = make(Study(output, fmus, size, workers), report)
    print_claims(claims)
    console.print(f"wrote {escaped(output / 'report.html')} and the tables, figures and scenarios beside it")


DEMO = {"swing_up": 128, "tilt": 128, "tilt_kalman": 128, "tilt_ideal": 0}
"""The demonstration's scenarios, and their draws of the encoder offsets."""


@app.command()
def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for results.")] = Path("results"),
    fmus: FmusOption = Path("fmus"),
) -> None:
    """Design, export, co-simulate LC, SMC and IHC from hanging down and from a tilt, compare."""
    from ihc_fmu.pendulum.start_values import default_design

    from .experiments import LAWS, Study
    from .scenario import load_scenario

    check_replaceable(output / "design.json", *(fmus / name for name in EXPORTED))
    for name in DEMO:
        _check_folder(output / name, LAWS)
    console.print("1. design: the paper's A, b and k_lin, inverse design")
    found = default_design()
    found.save(output / "design.json")
    margins = found.certificate
    console.print(
        f"   certified: decrease margin {margins.decrease:.2g} 1/s, monotonicity {margins.monotone:.3g}, P > 0"
    )
    console.print("2. export")
    for path in export_units(found, output=fmus):
        console.print(f"   {escaped(path)}")
    console.print(
        "3. co-simulation: plant ident, 1 ms, 10 V; |q| = hypot(theta, delta); settled: |q| < 0.02 rad to the end"
    )
    studies = []
    for name, draws in DEMO.items():
        chosen, folder = load_scenario(name)
        studies.append(Study(chosen, folder, draws))
    _compare(studies, fmus, output, list(LAWS))
