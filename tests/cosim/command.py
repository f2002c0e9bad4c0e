"""The command line: in this process, or where signals or the operating system matter, as a process of its own."""

from __future__ import annotations

import contextlib
import io
import os
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from unittest import mock

from cosim import cli, signals
from cosim.cli import display

PLAIN = {"COLUMNS": "200", "NO_COLOR": "1", "TERM": "dumb"}
"""The environment for plain text in stdout and stderr."""

for console in (display.console, display.problems):
    console.width = int(PLAIN["COLUMNS"])  # they have read the environment already


def journal_rows(path):
    """Return the rows of a journal in their order; none while it does not exist."""
    if not path.exists():
        return []
    file = sqlite3.connect(path, timeout=60)
    try:
        return file.execute("SELECT digest, numbers FROM runs ORDER BY rowid").fetchall()
    except sqlite3.OperationalError:  # made, but without its tables yet
        return []
    finally:
        file.close()


def ended(*args: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run the command line in this process as `qube-ihc` does; return how it ended and what it said.

    What the operating system does at the end of a process is not there; what `main` does is, a fault's exit code 70 for one.
    """
    out, err = io.StringIO(), io.StringIO()
    with _place(args, cwd), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            cli.main()
            code = 0
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else int(end.code is not None)
    return subprocess.CompletedProcess([*map(str, args)], code, out.getvalue(), err.getvalue())


@contextlib.contextmanager
def _place(args: tuple[object, ...], cwd: Path) -> Iterator[None]:
    """Give this process arguments, environment and working folder; afterwards everything is as before, handlers too."""
    handlers = {number: signal.getsignal(number) for number in signals.STOPPING}
    with (
        mock.patch.object(sys, "argv", ["qube-ihc", *map(str, args)]),
        mock.patch.dict(os.environ, PLAIN),
        contextlib.chdir(cwd),
    ):
        os.environ.pop("FORCE_COLOR", None)
        try:
            yield
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)


def started(*args: object, cwd: Path, **options) -> subprocess.Popen[str]:
    """Start the command line with plain text in stdout and stderr, in a session of its own, open to Ctrl-C."""
    plain = {**os.environ, **PLAIN}
    plain.pop("FORCE_COLOR", None)
    return subprocess.Popen(
        [sys.executable, "-m", "cosim", *map(str, args)],
        cwd=cwd,
        env=plain,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        **options,
    )


def finished(process: subprocess.Popen[str], timeout: float = 120.0) -> subprocess.CompletedProcess[str]:
    """Return how a started command ended and what it said."""
    try:
        out, err = process.communicate(timeout=timeout)
    finally:
        process.kill()
    return subprocess.CompletedProcess(process.args, process.returncode, out, err)


def sentence(done: subprocess.CompletedProcess[str], code: int = 2) -> str:
    """Return the one sentence of a refusal."""
    lines = done.stderr.strip().splitlines()
    assert (done.returncode, len(lines)) == (code, 1), done.stderr
    assert lines[0].startswith("error: ")
    return lines[0].removeprefix("error: ")


def files(folder: Path) -> list[str]:
    """Return the files in a folder and below it, by their paths from there."""
    return sorted(str(file.relative_to(folder)) for file in folder.rglob("*") if file.is_file())
