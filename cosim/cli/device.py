"""The command `device`."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Annotated

import typer

from filing.ownership import check_replaceable

from .display import console, escaped, problems
from .hil import check_device
from .options import SCENARIO_HELP, FmusOption, SetOption, assignments


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
    from ..hil.faults import parse
    from ..hil.loop import stop_signals
    from ..hil.realtime import undisturbed
    from ..hil.simulated import Board
    from ..hil.udp_messages import address_of, beyond_loopback
    from ..hil.udp_server import Server
    from ..interrupts import second_ends
    from ..scenario import load_scenario
    from ..scenario_system import build_system

    loaded_scenario, folder = load_scenario(scenario)
    loaded_scenario = loaded_scenario.changed(dict(assignments(change)))
    check_device(loaded_scenario)
    _, plant = build_system(loaded_scenario, fmus, folder).components
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
