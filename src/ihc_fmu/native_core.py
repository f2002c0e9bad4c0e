"""Where the C of the controllers is, and the headers that both are built on.

Standard library only: this module also runs while the package is being built.
"""

from __future__ import annotations

from pathlib import Path

FOLDER = Path(__file__).parent / "native"
HEADERS = ("homogeneous.h", "sample_clock.h", "sample_clock_fmu.h")
