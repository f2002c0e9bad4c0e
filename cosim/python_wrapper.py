"""FMUs of PythonFMU in this process: what their compiled wrapper gives back although it does not own it, kept for it.

The wrapper (PythonFMU 0.7.0, `PySlaveInstance.cpp`) has two faults where Python is the host, each of which writes to memory
that is free by then. Its state is destroyed twice when the process ends: by the destructor of the static pointer to it, then
by `finalizePythonInterpreter`, which the library calls when it is unloaded. And each instantiation releases the globals of
the FMU's script, a borrowed reference. Where the wrapper does neither, what is done here changes nothing.
"""

from __future__ import annotations

import atexit
import ctypes
import importlib
import sys
from contextlib import suppress
from pathlib import Path


def finalize_at_exit(library: ctypes.CDLL) -> bool:
    """Have the wrapper let go of its state before the process ends; return whether the library is one.

    What comes later then finds no state.
    """
    finalize = getattr(library, "finalizePythonInterpreter", None)
    if finalize is not None:
        atexit.register(finalize)
    return finalize is not None


def keep_globals(folder: Path) -> None:
    """Add the reference to the script's globals that the next instantiation of the FMU unpacked in `folder` takes away.

    The script is imported first, as the wrapper would: with no function in it, its module holds the only reference.
    """
    resources = folder / "resources"
    try:
        name = (resources / "slavemodule.txt").read_text(encoding="utf-8").partition("\n")[0]
    except (OSError, ValueError):  # not one of PythonFMU
        return
    sys.path.insert(0, str(resources))
    try:
        module = importlib.import_module(name)
    except (Exception, SystemExit):  # the wrapper meets the same, and says so in the FMU's log
        return
    finally:
        with suppress(ValueError):  # the script may have removed it
            sys.path.remove(str(resources))
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(vars(module)))
