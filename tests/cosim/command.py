"""The command line as a process of its own."""

import os
import signal
import sqlite3
import subprocess
import sys


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


def started(*args, cwd, **options):
    """Start the command line with plain text in stdout and stderr, in a session of its own, open to Ctrl-C."""
    plain = {**os.environ, "COLUMNS": "200", "NO_COLOR": "1", "TERM": "dumb"}
    plain.pop("FORCE_COLOR", None)
    earlier = signal.signal(signal.SIGINT, signal.default_int_handler)  # a process inherits that it ignores one
    try:
        return subprocess.Popen(
            [sys.executable, "-m", "cosim", *args],
            cwd=cwd,
            env=plain,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            **options,
        )
    finally:
        signal.signal(signal.SIGINT, earlier)
