"""Every test: Ctrl-C can be sent to its process, and the whole run leaves no temporary file and no process behind."""

from __future__ import annotations

import atexit
import gc
import os
import shutil
import signal
import tempfile
import time
from pathlib import Path

import pytest

FOLDER = pytest.StashKey[Path]()
PATIENCE = 30.0
"""Longest time for workers to end [s]."""


def pytest_configure(config) -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background inherits that it is ignored
    if hasattr(config, "workerinput"):
        return
    os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", tempfile.gettempdir())  # pytest tidies its own folder
    config.stash[FOLDER] = Path(tempfile.mkdtemp(prefix="qube-ihc-tests-"))
    atexit.register(shutil.rmtree, config.stash[FOLDER], ignore_errors=True)
    tempfile.tempdir = os.environ["TMPDIR"] = str(config.stash[FOLDER])  # of the workers and of their processes, too


def pytest_collection_finish() -> None:
    """Thousands of tests live to the end: the garbage collector does not go through them again and again."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(wrapper=True)
def pytest_sessionfinish(session):
    """Fail the run for what its workers left, once they have had the time to end and tidy up.

    In a process without workers this comes too early.
    """
    result = yield
    folder = session.config.stash.get(FOLDER, None)
    if folder is None or not session.config.pluginmanager.hasplugin("dsession"):
        return result
    deadline = time.monotonic() + PATIENCE
    while (left := [path.name for path in folder.iterdir()]) + (running := using(folder)):
        if time.monotonic() > deadline:
            break
        time.sleep(0.1)
    if left or running:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
        reporter = session.config.pluginmanager.get_plugin("terminalreporter")
        reporter.write_line(f"\nleft by the tests: temporary files {left}, processes {running}", red=True)
    return result


def using(folder: Path) -> list[str]:
    """Return the command lines of the processes whose temporary folder is this one, where /proc tells."""
    commands = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            environment, command = ((process / name).read_bytes() for name in ("environ", "cmdline"))
        except OSError:
            continue  # it has ended, or is another's
        if f"TMPDIR={folder}\0".encode() in environment and int(process.name) != os.getpid():
            commands.append(command.replace(b"\0", b" ").decode())
    return commands
