"""Everything native for this machine: the binaries of all units and the master's loop.

The installation runs this; `python -m cosim.build` does it again after a change of the C sources. Standard library only.
"""

from __future__ import annotations

import sys
from pathlib import Path

from fmu_export.native_build import BINARIES, BuildError, Platform, host_platform, install_library, installed_library

LOOP = "loop"
LOOP_BINARIES = Path(__file__).parent / "binaries"


def build(platform: Platform | None = None) -> list[Path]:
    """Build what is missing or older than its sources; return the paths. Raises BuildError where the compiler fails."""
    from fmu_export.native_unit import unit_files  # noqa: PLC0415 - a run needs the loop only
    from ihc_fmu.pendulum.native_unit import NATIVE as CONTROLLER  # noqa: PLC0415
    from ihc_fmu.regulator.native_unit import NATIVE as REGULATOR  # noqa: PLC0415
    from plant_fmu.linear.native_unit import NATIVE as LINEAR_PLANT  # noqa: PLC0415
    from plant_fmu.native_unit import NATIVE as PLANT  # noqa: PLC0415

    platform = platform or host_platform()
    units = (PLANT, LINEAR_PLANT, CONTROLLER, REGULATOR)
    paths = [install_library(BINARIES, unit_files(unit), unit.interface.name, platform) for unit in units]
    return [*paths, install_library(LOOP_BINARIES, loop_files(), LOOP, platform)]


def loop_files() -> dict[str, bytes]:
    """Return the files that the master's loop is made of, by name."""
    folder = Path(__file__).parent / "native"
    return {file.name: file.read_bytes() for file in sorted(folder.glob("loop.[ch]"))}


def loop_library() -> Path:
    """Return the path of the master's loop; raise BuildError where it is missing or outdated."""
    return installed_library(LOOP_BINARIES, loop_files(), LOOP, host_platform())


if __name__ == "__main__":
    try:
        print(*build(), sep="\n")
    except BuildError as error:
        sys.exit(f"error: {error}")
