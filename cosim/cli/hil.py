"""The command `hil`."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fmu_export.files import uninterrupted
from fmu_export.variables import did_you_mean

from ..errors import UserError
from .display import (
    console,
    escaped,
    interruptible,
    print_metrics,
    problems,
    remove_earlier,
    say_notes,
    show_table,
)
from .options import (
    FAILED,
    SCENARIO_HELP,
    ControllerOption,
    FmusOption,
    Page,
    ReportFileOption,
    ReportOption,
    SetOption,
    assignments,
    page_wanted,
)

if TYPE_CHECKING:
    from ..hil.device import Device
    from ..hil.loop import HardwareRun
    from ..hil.settings import Settings
    from ..results import Result
    from ..scenario import Scenario
    from ..structure import Component, Signal


BOARDS = ("qube", "qlabs")
DEVICES = (*BOARDS, "sim")

LOWEST_RATE, HIGHEST_RATE = 100.0, 10_000.0
"""Sampling rates [Hz]: below, a device takes two periods for a loop that has died."""


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
        str,
        typer.Option(
            help=f"Controller's start values and signals, and the plant of a simulated device. {SCENARIO_HELP}"
        ),
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
    report: ReportOption = False,
    report_file: ReportFileOption = None,
) -> None:
    """Run the controller FMU on the QUBE-Servo 2, real or simulated: check, swing up, balance, log, stop at 0 V.

    Ctrl-C stops at 0 V after the current sample. The log has a simulation's columns and units, and the timing beside.
    """
    from ..hil.settings import Settings
    from ..remarks import remarks_before
    from ..scenario import load_scenario
    from ..scenario_system import build_system, controller_design

    if check and (report or report_file is not None):
        raise UserError("--check makes no run that a page could show; it takes neither --report nor --report-file")
    if on_fall not in ("swing-up", "stop"):
        raise UserError(f"--on-fall must be swing-up or stop, found {on_fall!r}")
    if not LOWEST_RATE <= rate <= HIGHEST_RATE:
        raise UserError(f"--rate must lie in [{LOWEST_RATE:g}, {HIGHEST_RATE:g}] Hz, found {rate:g} Hz")
    loaded_scenario, folder = load_scenario(scenario)
    loaded_scenario = loaded_scenario.changed(
        {**dict(assignments(change)), "run.step": 1.0 / rate, "run.duration": duration}
    )
    if loaded_scenario.plant.measurement == "ideal":
        raise UserError(
            f"a device measures with encoders, the scenario {loaded_scenario.name} says {loaded_scenario.plant.measurement}"
        )
    check_device(loaded_scenario)
    system = build_system(loaded_scenario, fmus, folder, controller)
    component, plant = system.components
    signals = system.signals
    notes = remarks_before(system, loaded_scenario)
    say_notes(notes)
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
        _check(chosen_device, component, settings, signals)
    else:
        about = {"scenario": loaded_scenario.model_dump(mode="json"), **_judged(component, signals)}
        page = page_wanted(report, report_file, None)
        if page is not None:
            design, uncovered = controller_design(system, loaded_scenario, folder)
            page = replace(page, notes=[*dict.fromkeys([*notes, *uncovered])], design=design)
        with interruptible(output):
            _run(chosen_device, component, settings, signals, about, output, status, page)


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
        from ..hil.faults import parse
        from ..hil.simulated import Board, SimulatedDevice

        return SimulatedDevice(Board(plant, parse(faults)), real_time=not lockstep)
    if text in BOARDS:
        from ..hil.quanser import QuanserDevice

        return QuanserDevice(text, watchdog=watchdog, identifier=identifier)
    if text.startswith("udp://"):
        from ..hil.udp import UdpDevice
        from ..hil.udp_messages import address_of

        return UdpDevice(address_of(text.removeprefix("udp://")), real_time=not lockstep)
    raise UserError(
        f"--device must be {', '.join(DEVICES)} or udp://HOST:PORT, found {text!r}{did_you_mean(text, DEVICES)}"
    )


def _check(device: Device, component: Component, settings: Settings, signals: Sequence[Signal]) -> None:
    from ..hil.diagnosis import diagnose

    good = True
    colours = {"ok": "green", "note": "yellow", "wrong": "bold red"}
    for verdict, text in diagnose(device, component, settings, signals):
        console.print(f"[{colours[verdict]}]{verdict:5}[/]  {escaped(text)}", soft_wrap=True)
        good = good and verdict != "wrong"
    if not good:
        raise typer.Exit(FAILED)


def _run(
    device: Device,
    component: Component,
    settings: Settings,
    signals: Sequence[Signal],
    metadata: Mapping[str, Any],
    output: Path,
    status: bool | None,
    page: Page | None,
) -> None:
    from ..hil.log import free_path, recover
    from ..hil.loop import Loop

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
        metadata,
        say=lambda text: problems.print(f"[dim]{escaped(text)}[/]"),
        signals=signals,
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
    if page is not None and len(report.result.time):
        _write_page(report, path, page)
    elif page is not None and page.path is not None:
        remove_earlier(page.path, "report")
    if report.stop == "signal" and not report.failures:
        raise typer.Exit(128 + report.signal)
    if report.stop == "fault" or report.failures:
        raise typer.Exit(FAILED)


def _print_report(report: HardwareRun, path: Path) -> None:
    from ..judged_signals import can_evaluate
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
    show_table(*_timing(result))
    console.print(_missed(result), highlight=False, soft_wrap=True)
    for name, count in about["counters"].items():
        if count:
            console.print(f"{escaped(name)}: {count}", highlight=False)
    console.print(f"wrote {escaped(path)} and {escaped(path.with_suffix('.json'))}", soft_wrap=True)
    if can_evaluate(result) and len(result.time) > 1:
        if "controller.homogeneous_norm" in result.signals:
            picture = save_overview(result, path.with_suffix(".png"), about["device"])
            console.print(f"wrote {escaped(picture)}", soft_wrap=True)
        print_metrics(result)


def _timing(result: Result) -> tuple[str, Sequence[str], list[list[str]]]:
    """Return title, headings and rows of the table of a run's timing."""
    names = {"lateness": "sample read late", "latency": "sample to command", "step_time": "controller's step"}
    timing = result.metadata["hil"]["timing"]
    rows = [
        [text, *(f"{1e6 * value:.1f}" for value in timing[name].values())]
        for name, text in names.items()
        if timing[name]
    ]
    return "timing of the run [us]", ("", "p50", "p99", "p99.9", "max"), rows


def _missed(result: Result) -> str:
    missed = result.metadata["hil"]["missed"]
    return f"missed periods: {missed} of {len(result.time) - 1 + missed}{_elsewhere(result)}"


def _write_page(report: HardwareRun, path: Path, page: Page) -> None:
    from ..report.pages import Findings, Table, Verdict, write_result

    result, about = report.result, report.result.metadata["hil"]
    good = report.stop != "fault" and not report.failures
    how = "stopped at 0 V" if not report.failures else "not all of the stop worked"
    file = page.path or path.with_suffix(".html")
    write_result(
        file,
        result,
        title=f"{about['device']}: {path.stem}",
        notes=[
            *page.notes,
            *(f"{text} (at {time:.3f} s)" for text, time in about["warnings"].items()),
            *(f"while stopping: {text}" for text in report.failures),
        ],
        design=page.design,
        table=path,
        more=Findings(
            [Verdict(how, report.reason, "good" if good else "bad")],
            [Table(*_timing(result))],
            remarks=[
                *about["environment"],
                _missed(result),
                *(f"{name}: {count}" for name, count in about["counters"].items() if count),
            ],
        ),
    )
    console.print(f"wrote {escaped(file)}", soft_wrap=True)


def _elsewhere(result: Result) -> str:
    """Return what a bare loop missed on another machine at the same rate, for comparison."""
    from ..hil.realtime import REFERENCE_MISSES, REFERENCE_TIME

    rate = result.metadata["hil"]["rate"]
    if (rate, True) not in REFERENCE_MISSES:
        return ""
    scale = (result.time[-1] - result.time[0]) / REFERENCE_TIME
    default, real_time = (REFERENCE_MISSES[rate, wanted] * scale for wanted in (False, True))
    return f" (a bare loop on another machine: {default:.0f}, with real-time scheduling {real_time:.0f})"


def _judged(component: Component, signals: Sequence[Signal]) -> dict[str, Any]:
    """Return the log's word on what it is judged by, where the controller is to hold the arm at another angle than 0."""
    from ..evaluation import ARM_SET_POINT, pendulum_evaluation
    from ..fmu_files import start_values_of
    from ..hil.replay import MEASURED
    from ..wiring import CONTROLLER

    driven = (s.target for s in signals if s.target == f"{CONTROLLER}.{ARM_SET_POINT}")
    start = {**start_values_of(Path(component.path)), **component.start}
    arm = next(driven, None) or float(start.get(ARM_SET_POINT, 0.0))
    return {"evaluation": pendulum_evaluation(MEASURED, arm).model_dump(mode="json")} if arm else {}


def check_device(scenario: Scenario) -> None:
    """Raise UserError for a scenario that is more, or less, than a controller and a plant in the device's place."""
    from ..wiring import CONTROLLER

    if list(scenario.parts) != ["controller", "plant"] or scenario.wires is not None:
        raise UserError(
            f"a device is one plant with one controller; the scenario {scenario.name} has other components or wires"
        )
    elsewhere = [s.input for s in scenario.signals if not s.input.startswith(f"{CONTROLLER}.")]
    if elsewhere or (scenario.disturbance.sines and scenario.disturbance.gain):
        unusable = f"a signal on {elsewhere[0]}" if elsewhere else "a disturbance of the plant"
        raise UserError(
            f"on a device signals can act on the controller's inputs only, and the scenario {scenario.name} has {unusable}"
        )
