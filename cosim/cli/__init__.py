"""The command line `qube-ihc`, also `python -m cosim`: a module for each command, over libraries that do not print."""

from __future__ import annotations

import errno
import importlib.metadata
import os
import sys
from typing import Annotated

import typer
from pydantic import TypeAdapter  # noqa: F401 - Typer loads it to parse, and would make a silent end of Ctrl-C meanwhile

from .. import signals
from ..errors import UserError
from .compare import compare
from .demo import demo
from .design import design
from .device import device
from .display import console, degrade_output, say_error, say_fault
from .explore import explore
from .export import export
from .hil import hil
from .identify import identify
from .linearize import linearize
from .new import new
from .options import FAILED
from .overlay import overlay
from .paper import paper
from .region import region
from .replay import replay
from .run import run
from .ssp import ssp
from .sweep import sweep
from .tune import tune

USAGE, FAULT = 2, 70
"""Exit codes, and FAILED, 1; 70 is EX_SOFTWARE of sysexits.h."""

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
    help="From a linear controller to an implicit homogeneous one: **linearize** a plant, **design** with a proof, "
    "**export** plant and controller as FMUs, **run** scenarios with them, **compare** the laws, **sweep** what is "
    "uncertain, map the **region** that is attracted, **tune** the controller; **new** begins with a plant of your own. "
    "Built in is the QUBE-Servo 2: **demo** "
    "does all of it, **paper** repeats the paper's experiments, **hil** runs the controller on the device.",
)

OUTPUT_LOST = (errno.ENOSPC, errno.EIO)
"""What writing to a full disk or to a terminal that is gone ends with; a file that has a name is named by UserError."""

for _command in (
    linearize,
    new,
    design,
    export,
    ssp,
    run,
    compare,
    sweep,
    tune,
    region,
    explore,
    paper,
    demo,
    hil,
    device,
    replay,
    overlay,
    identify,
):
    app.command()(_command)


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


COMMAND = typer.main.get_command(app)
"""The command line, made when it is loaded, which takes a while."""


def main() -> None:
    """Run the command line; its exit code says how it ended.

    0: well; 1: a run, a device or a compiler failed; 2: the user's mistake, in one sentence; 70: a fault of this program,
    with its traceback; 128 + n: signal n. The option --debug may stand anywhere and shows the traceback of every error.
    """
    arguments = [argument for argument in sys.argv[1:] if argument != "--debug"]
    debug = len(arguments) < len(sys.argv) - 1
    try:
        signals.as_ctrl_c()
        degrade_output()
        try:
            COMMAND(arguments)
        finally:
            sys.stdout.flush()
    except (KeyboardInterrupt, SystemExit) as end:  # Typer makes a SystemExit of a KeyboardInterrupt
        interrupt = signals.interrupt_behind(end)
        if interrupt is None:
            raise
        signals.say(interrupt)
        sys.exit(signals.exit_code())
    except UserError as error:
        say_error(error, traceback=debug)
        sys.exit(USAGE)
    except Exception as error:
        sentence = _failure(error)
        if sentence is None:
            say_fault(error)
            sys.exit(FAULT)
        say_error(error, sentence, traceback=debug)
        sys.exit(FAILED)


def _failure(error: Exception) -> str | None:
    """Return the sentence of a run, a device or a compiler that failed, None for a fault of this program."""
    from fmu_export.native_build import BuildError, CompilerMissingError

    from ..fmu import FmuError
    from ..hil.device import DeviceError
    from ..results import SimulationError

    if isinstance(error, CompilerMissingError):
        return f"{error}; pip install 'qube-ihc[cross]'"
    if isinstance(error, SimulationError | FmuError | BuildError | DeviceError):
        return str(error)
    if isinstance(error, MemoryError):
        return "there is not enough memory"
    if isinstance(error, OSError) and error.filename is None and error.errno in OUTPUT_LOST:
        _discard_output()
        return f"the output cannot be written: {error.strerror}"
    return None


def _discard_output() -> None:
    """Drop what is left to be written to an output that takes no more; to a terminal, the error output stays."""
    nothing = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            os.dup2(nothing, stream.fileno())
