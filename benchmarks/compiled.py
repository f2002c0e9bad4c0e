"""C programs around the units' own code, compiled for this machine with the designs' numbers in them."""

from __future__ import annotations

import ctypes
import tempfile
from collections.abc import Mapping
from pathlib import Path

from fmu_export.native_build import build_library, host_platform

_BEGIN = '#include <math.h>\n#pragma clang diagnostic ignored "-Wmissing-braces"\n'


def compiled(name: str, core: Mapping[str, bytes], start_values: str) -> ctypes.CDLL:
    """Return the library of `name`.c in this folder with the files of `core`; it includes start_values.h, the text."""
    files = dict(core)
    files[f"{name}.c"] = Path(__file__).with_name(f"{name}.c").read_bytes()
    files["start_values.h"] = (_BEGIN + start_values).encode()
    platform = host_platform()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{name}{platform.suffix}"
        path.write_bytes(build_library(files, name, platform))
        return ctypes.CDLL(str(path))
