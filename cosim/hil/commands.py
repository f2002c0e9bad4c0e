"""The commands `hil`, `device`, `replay`, `overlay` and `identify`."""

from __future__ import annotations

import math
import signal
import subprocess
import sys
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from filing.files import staging
from filing.ownership import check_replaceable
from fmu_export.files import uninterrupted
from fmu_export.variables import did_you_mean

from ..display import console, escaped, print_metrics, print_results, problems, progress, say_notes, show_table
from ..errors import UserError
from ..options import SCENARIO_HELP, FmusOption, SetOption, assignments

if TYPE_CHECKING:
    from ..master import Component
    from ..results import Result
    from ..scenario import Scenario
    from .device import Device
    from .loop import Report
    from .settings import Settings

FAILED = 1

LOWEST_RATE, HIGHEST_RATE = 100.0, 10_000.0
"""Sampling rates [Hz]: below, a device takes two periods for a loop that has died."""

RunArgument = Annotated[Path, typer.Argument(help="Result of `hil` (CSV, with its JSON beside it).")]
ControllerOption = Annotated[
    Path | None, typer.Option(help="Controller FMU; none: the scenario's, in the folder of `--fmus`.")
]


OTHER_FMU = "this FMU is not the file that the log was made with (another GUID)"


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    for command in (hil, device, replay, overlay, identify):
        app.command()(command)


def hil(
    device: Annotated[
        str,
        typer.Option(
            help="`qube`: the board; `qlabs`: Quanser's virtual twin; `sim`: simulated, in this process; "
            "`udp://HOST:PORT`: simulated by `qube-ihc device`."
        ),
    ] = "sim",
    controller: ControllerOption = None,
    rate: Annotated[float, typer.Option(help="Sampling rate [Hz].")] = 1000.0,
    duration: Annotated[float, typer.Option(help="Duration after the start checks [s].")] = 20.0,
    output: Annotated[
        Path,
        typer.Option("--output", "-o", help="Folder for the log; earlier runs there stay: run.csv, run_2.csv, ..."),
    ] = Path("results/hil"),
    check: Annotated[
        bool, typer.Option("--check", help="Test installation, controller, board, signs and timing instead of running.")
    ] = False,
    scenario: Annotated[
        str, typer.Option(help=f"Controller's start values, and the plant of a simulated device. {SCENARIO_HELP}")
    ] = "device",
    change: SetOption = None,
    fmus: FmusOption = Path("fmus"),
    on_fall: Annotated[
        str,
        typer.Option(help="A balanced pendulum that falls: `swing-up` swings it up again, `stop` ends the run at 0 V."),
    ] = "swing-up",
    sign_test: Annotated[
        bool, typer.Option(help="Turn the arm a little at low voltage before, to test the signs.")
    ] = True,
    watchdog: Annotated[bool, typer.Option(help="Arm the board's watchdog.")] = True,
    identifier: Annotated[str | None, typer.Option(help="The board's identifier; none: the usual one.")] = None,
    lockstep: Annotated[
        bool,
        typer.Option("--lockstep", help="Simulated device without a clock: each sample is one period, no waiting."),
    ] = False,
    faults: Annotated[
        str,
        typer.Option(
            help="Faults of the device `sim`, e.g. `arm-jump@3=500,push@5=0.01:0.05`; docs/hil.md lists them."
        ),
    ] = "",
    stop_on_misses: Annotated[
        bool | None,
        typer.Option(
            "--stop-on-misses/--allow-misses",
            help="Stop after 5 missed periods in a row or 1 % within a second; none: on a real device, and a warning on a "
            "simulated one.",
        ),
    ] = None,
    real_time: Annotated[bool, typer.Option(help="Ask for real-time scheduling and locked memory.")] = True,
    status: Annotated[bool | None, typer.Option(help="Live line; none: where the error output is a terminal.")] = None,
) -> None:
    """Run the controller FMU on the QUBE-Servo 2, real or simulated: check, swing up, balance, log, stop at 0 V.

    Ctrl-C stops at 0 V after the current sample. The log has a simulation's columns and units, and the timing beside.
    """
    from ..scenario import build_system, load_scenario, remarks
    from .settings import Settings

    if on_fall not in ("swing-up", "stop"):
        raise UserError(f"--on-fall must be swing-up or stop, found {on_fall!r}")
    if not LOWEST_RATE <= rate <= HIGHEST_RATE:
        raise UserError(f"--rate must lie in [{LOWEST_RATE:g}, {HIGHEST_RATE:g}] Hz, found {rate:g} Hz")
    chosen, folder = load_scenario(scenario)
    chosen = chosen.changed({**dict(assignments(change)), "run.step": 1.0 / rate, "run.duration": duration})
    if chosen.plant.measurement == "ideal":
        raise UserError(f"a device measures with encoders, the scenario {chosen.name} says {chosen.plant.measurement}")
    _check_device(chosen)
    system = build_system(chosen, fmus, folder, controller)
    component, plant = system.components
    say_notes(remarks(system, chosen))
    settings = Settings(
        rate=rate,
        duration=duration,
        sign_test=sign_test,
        on_fall="stop" if on_fall == "stop" else "swing-up",
        real_time=real_time,
        stop_on_misses=device in BOARDS if stop_on_misses is None else stop_on_misses,
    )
    _check_options(device, lockstep=lockstep, faults=faults, stop_on_misses=settings.stop_on_misses)
    chosen_device = _device(device, plant, faults, lockstep=lockstep, watchdog=watchdog, identifier=identifier)
    if check:
        _check(chosen_device, component, settings)
    else:
        _run(chosen_device, component, settings, chosen, output, status)


BOARDS = ("qube", "qlabs")
DEVICES = (*BOARDS, "sim")


def _check_options(device: str, *, lockstep: bool, faults: str, stop_on_misses: bool) -> None:
    if faults and device != "sim":
        raise UserError(f"--faults is for the device sim (`qube-ihc device` has its own), found --device {device}")
    if (lockstep or not stop_on_misses) and device in BOARDS:
        option = "--lockstep" if lockstep else "--allow-misses"
        raise UserError(f"{option} is for simulated devices, found --device {device}")


def _device(
    text: str, plant: Component, faults: str, *, lockstep: bool, watchdog: bool, identifier: str | None
) -> Device:
    if text == "sim":
        from .faults import parse
        from .simulated import Board, SimulatedDevice

        return SimulatedDevice(Board(plant, parse(faults)), real_time=not lockstep)
    if text in BOARDS:
        from .quanser import QuanserDevice

        return QuanserDevice(text, watchdog=watchdog, identifier=identifier)
    if text.startswith("udp://"):
        from .udp import UdpDevice, address_of

        return UdpDevice(address_of(text.removeprefix("udp://")), real_time=not lockstep)
    raise UserError(
        f"--device must be {', '.join(DEVICES)} or udp://HOST:PORT, found {text!r}{did_you_mean(text, DEVICES)}"
    )


def _check(device: Device, component: Component, settings: Settings) -> None:
    from .diagnosis import diagnose

    good = True
    colours = {"ok": "green", "note": "yellow", "wrong": "bold red"}
    for verdict, text in diagnose(device, component, settings):
        console.print(f"[{colours[verdict]}]{verdict:5}[/]  {escaped(text)}", soft_wrap=True)
        good = good and verdict != "wrong"
    if not good:
        raise typer.Exit(FAILED)


def _run(
    device: Device, component: Component, settings: Settings, scenario: Scenario, output: Path, status: bool | None
) -> None:
    from .log import free_path, recover
    from .loop import Loop

    output.mkdir(parents=True, exist_ok=True)
    for path, rows in recover(output):
        if isinstance(rows, str):
            problems.print(f"[yellow]note:[/] {escaped(rows)}; the file stays as it is")
        else:
            console.print(f"recovered {rows} rows of a run that was killed: {escaped(path)}")
    path = free_path(output, "run")
    loop = Loop(
        device,
        component,
        settings,
        path,
        {"scenario": scenario.model_dump(mode="json"), **_judged(component)},
        say=lambda text: problems.print(f"[dim]{escaped(text)}[/]"),
    )
    live = None
    if status or (status is None and sys.stderr.isatty()):
        live = subprocess.Popen([sys.executable, "-m", "cosim.hil.status", str(loop.log.path)])
    try:
        report = loop.run()
    finally:
        loop.log.close()
        if live is not None:
            live.wait()
    with uninterrupted():
        try:
            if len(report.result.time):
                report.result.save(path)
        except UserError:
            where = escaped(loop.log.path)
            problems.print(f"the rows are safe in {where}; the next run into this folder makes a result of them")
            raise
        loop.log.discard()
    _print_report(report, path)
    if report.stop == "signal" and not report.failures:
        raise typer.Exit(128 + report.signal)
    if report.stop == "fault" or report.failures:
        raise typer.Exit(FAILED)


def _print_report(report: Report, path: Path) -> None:
    from ..metrics import can_evaluate
    from ..plots import save_overview

    result, about = report.result, report.result.metadata["hil"]
    colour = {"complete": "green", "signal": "yellow", "fault": "bold red"}[report.stop]
    how = "stopped at 0 V" if not report.failures else "stopped, but not all of the stop worked"
    console.print(
        f"[{colour if not report.failures else 'bold red'}]{how}:[/] {escaped(report.reason)}", soft_wrap=True
    )
    for text, time in about["warnings"].items():
        console.print(f"[yellow]warning:[/] {escaped(text)} (at {time:.3f} s)")
    for text in report.failures:
        console.print(f"[bold red]while stopping:[/] {escaped(text)}", soft_wrap=True)
    for text in about["environment"]:
        console.print(escaped(text), soft_wrap=True)
    if not len(result.time):
        console.print("no sample was taken, so there is no log to look at")
        return
    names = {"lateness": "sample read late", "latency": "sample to command", "step_time": "controller's step"}
    timing = {text: about["timing"][name] for name, text in names.items() if about["timing"][name]}
    rows = [[text, *(f"{1e6 * value:.1f}" for value in values.values())] for text, values in timing.items()]
    show_table("timing of the run [us]", ("", "p50", "p99", "p99.9", "max"), rows)
    console.print(
        f"missed periods: {about['missed']} of {len(result.time) - 1 + about['missed']}{_elsewhere(result)}",
        highlight=False,
        soft_wrap=True,
    )
    for name, count in about["counters"].items():
        if count:
            console.print(f"{escaped(name)}: {count}", highlight=False)
    console.print(f"wrote {escaped(path)} and {escaped(path.with_suffix('.json'))}", soft_wrap=True)
    if can_evaluate(result) and len(result.time) > 1:
        if "controller.homogeneous_norm" in result.signals:
            picture = save_overview(result, path.with_suffix(".png"), about["device"])
            console.print(f"wrote {escaped(picture)}", soft_wrap=True)
        print_metrics(result)


def _elsewhere(result: Result) -> str:
    """Return what a bare loop missed on another machine at the same rate, for comparison."""
    from .realtime import REFERENCE_MISSES, REFERENCE_TIME

    rate = result.metadata["hil"]["rate"]
    if (rate, True) not in REFERENCE_MISSES:
        return ""
    scale = (result.time[-1] - result.time[0]) / REFERENCE_TIME
    default, real_time = (REFERENCE_MISSES[rate, wanted] * scale for wanted in (False, True))
    return f" (a bare loop on another machine: {default:.0f}, with real-time scheduling {real_time:.0f})"


def _judged(component: Component) -> dict[str, Any]:
    """Return the log's word on what it is judged by, where the controller is to hold the arm at another angle than 0."""
    from ..evaluation import ARM_SET_POINT, pendulum_evaluation
    from ..fmu import start_values_of
    from .replay import MEASURED

    arm = float({**start_values_of(Path(component.path)), **component.start}.get(ARM_SET_POINT, 0.0))
    return {"evaluation": pendulum_evaluation(MEASURED, arm).model_dump(mode="json")} if arm else {}


def _check_device(scenario: Scenario) -> None:
    """Raise UserError for a scenario that is more, or less, than a controller and a plant in the device's place."""
    if list(scenario.parts) != ["controller", "plant"] or scenario.wires is not None or scenario.signals:
        raise UserError(
            f"a device is one plant with one controller; the scenario {scenario.name} has other components, wires or signals"
        )


def device(
    listen: Annotated[str, typer.Option(help="Address to listen at, HOST:PORT.")] = "127.0.0.1:18950",
    scenario: Annotated[str, typer.Option(help=f"The plant. {SCENARIO_HELP}")] = "device",
    change: SetOption = None,
    fmus: FmusOption = Path("fmus"),
    faults: Annotated[str, typer.Option(help="Faults, as for `hil --device sim`.")] = "",
    record: Annotated[
        Path | None,
        typer.Option(help="CSV file for the device's own record of its voltage, written at each session's end."),
    ] = None,
    once: Annotated[bool, typer.Option("--once", help="End after one session.")] = False,
    real_time: Annotated[bool, typer.Option(help="Ask for real-time scheduling and locked memory.")] = True,
) -> None:
    """Simulate the device in a process of its own, for `hil --device udp://HOST:PORT`; Ctrl-C ends it.

    It has its own clock, or goes in lockstep where `hil --lockstep` asks for it, and cuts its voltage where it hears nothing
    for 20 ms.
    """
    from ..interrupts import second_ends
    from ..scenario import build_system, load_scenario
    from .faults import parse
    from .loop import stop_signals
    from .realtime import undisturbed
    from .simulated import Board
    from .udp import Server, address_of, beyond_loopback

    chosen, folder = load_scenario(scenario)
    chosen = chosen.changed(dict(assignments(change)))
    _check_device(chosen)
    _, plant = build_system(chosen, fmus, folder).components
    board = Board(plant, parse(faults))
    if record is not None:
        check_replaceable(record)

    def say(text: str) -> None:
        console.print(escaped(text), soft_wrap=True)
        if record is not None and board.record:
            board.save_record(record)

    with stop_signals() as received, second_ends():
        server = Server(board, address_of(listen), say)
        say(f"listening at {server.address[0]}:{server.address[1]}")
        if beyond_loopback(server.address):
            problems.print(
                "[yellow]warning:[/] whoever reaches this address over the network can use the device, and the messages are "
                "neither signed nor secret; 127.0.0.1 is for this machine alone",
                soft_wrap=True,
            )
        with undisturbed(real_time=real_time):
            server.serve(lambda: bool(received) or (once and server.sessions > 0))
    if record is not None:
        board.save_record(record)
    if received:
        raise typer.Exit(128 + signal.Signals(received[0]))


def replay(run: RunArgument, controller: ControllerOption = None, fmus: FmusOption = Path("fmus")) -> None:
    """Feed a log's measurements to the controller FMU again and check that it commands the same, bit for bit."""
    from ..results import Result
    from .replay import controller_of
    from .replay import replay as run_replay

    result = Result.load(run)
    found = run_replay(result, controller_of(result, controller, fmus))
    if not found.same_fmu:
        say_notes([OTHER_FMU])
    if found.first is None:
        console.print(f"exact: {found.samples} samples replayed, every output as in the log to the last bit")
        return
    first = found.first
    console.print(
        f"not exact: {found.differing} of {found.samples} rows differ, the first at {first.time:g} s: "
        f"{escaped(first.name)} is {first.logged!r} in the log and {first.replayed!r} in the replay",
        soft_wrap=True,
    )
    raise typer.Exit(FAILED)


def overlay(
    run: RunArgument,
    parameters: Annotated[
        str | None,
        typer.Option(help="Parameter set of the simulated plant, by name or TOML file; none: the run's own."),
    ] = None,
    begin: Annotated[float, typer.Option(min=0.0, help="Time in the log from which to simulate [s].")] = 0.0,
    controller: ControllerOption = None,
    fmus: FmusOption = Path("fmus"),
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder to write to; none: `NAME_overlay` beside the run.")
    ] = None,
) -> None:
    """Re-simulate a run from where its log begins and lay the simulation over the hardware: pictures, metrics."""
    from ..plots import COMPARISON, save_comparison
    from ..provenance import provenance
    from ..results import Result
    from .overlay import as_seen, differences, resimulate
    from .replay import controller_of, is_own
    from .scaling import RESOLUTION

    result = Result.load(run)
    folder = output or run.with_name(f"{run.stem}_overlay")
    pictures = (f"{name}.png" for name in COMPARISON)
    check_replaceable(*(folder / name for name in ("simulation.csv", "simulation.json", *pictures)))
    plant, own = fmus / provenance(result).scenario.plant.fmu, controller_of(result, controller, fmus)
    if not is_own(result, own):
        say_notes([OTHER_FMU])
    with progress() as bar:
        task = bar.add_task("simulation", total=None)
        found = resimulate(
            result,
            (plant, own),
            parameters,
            begin,
            lambda done, total: bar.update(task, completed=done, total=total),
        )
    measured, simulated = found.measured, found.simulated
    both = {"device": measured, "simulation": as_seen(simulated, measured)}
    with staging(folder) as place:
        simulated.save(place / "simulation.csv")
        save_comparison(both, place, f"{run.name} and its simulation with {parameters or 'its own plant'}")
    print_results(both)
    for name, value in differences(measured, simulated).items():
        console.print(f"RMS difference of {name}: {value:.4g} {escaped(measured.units[name])}", highlight=False)
    console.print(
        f"over stretches of 0.25 s the model is {1e3 * found.beginning.rms:.3g} mrad RMS off; counting alone gives "
        f"{1e3 * RESOLUTION / math.sqrt(12.0):.3g} mrad",
        highlight=False,
        soft_wrap=True,
    )
    console.print(f"simulation and pictures in {escaped(folder)}", soft_wrap=True)


def identify(
    run: RunArgument,
    names: Annotated[str, typer.Option("--fit", help="Parameters to fit, separated by commas.")] = "D_r,D_p,T_r",
    parameters: Annotated[
        str, typer.Option(help="Parameter set to start from, by name or TOML file; what is not fitted stays.")
    ] = "ident",
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="TOML file to write; none: `NAME_parameters.toml` beside the run."),
    ] = None,
) -> None:
    """Fit damping and friction of the plant to a log and write them as a parameter set, with confidence intervals.

    The file goes into `--parameters` of `export` and `overlay`, or `plant.parameters` of a scenario.
    """
    from plant_fmu.parameters import QubeParameters

    from .. import parameter_files
    from ..results import Result
    from .identify import LIKE_VOLTAGE
    from .identify import identify as run_identify
    from .scaling import RESOLUTION

    result = Result.load(run)
    start = parameter_files.chosen(parameters)
    path = output or run.with_name(f"{run.stem}_parameters.toml")
    check_replaceable(path)
    with console.status("identification") as shown:
        found = run_identify(
            result,
            start,
            tuple(name.strip() for name in names.split(",")),
            progress=lambda trials, rms: shown.update(f"trial {trials}: residual {rms:.3g} rad"),
        )
    parameter_files.save(path, found.parameters)
    headings, rows = ("parameter", "fitted", "from", "to", f"in {start.name}", "unit"), []
    units = {f.name: f.metadata["unit"] for f in fields(QubeParameters)}
    for name, e in found.estimates.items():
        numbers = (e.value, e.low, e.high, getattr(start.parameters, name))
        rows.append([name, *(f"{number:.4g}" for number in numbers), units[name]])
    show_table(f"{run.name}: parameters and 95 % confidence intervals", headings, rows)
    unknown = [name for name, e in found.estimates.items() if not e.identifiable]
    if found.disturbed:
        p = found.parameters.parameters
        problems.print(
            f"[yellow]note:[/] the residuals show a disturbance that the model lacks, like {found.disturbance:.2g} V RMS at "
            f"the motor, {found.disturbance * p.k_m / p.R_m:.2g} N.m: the arm's damping and friction cannot be told from "
            "it, whatever their intervals say"
        )
        unknown = [name for name in unknown if name not in LIKE_VOLTAGE]
    if unknown:
        problems.print(f"[yellow]note:[/] this log does not tell {', '.join(unknown)}; leave it out of --fit")
    console.print(
        f"RMS residual {found.rms_before:.3g} rad before, {found.rms_after:.3g} rad after, from {found.samples} samples in "
        f"{found.segments} segments; one encoder count is {RESOLUTION:.3g} rad",
        soft_wrap=True,
    )
    console.print(f"wrote {escaped(path)}", soft_wrap=True)
