"""Build hook: compiles a platform's binaries with the package ziglang and puts them into the wheel.

The platform is this machine's, or what the environment variable QUBE_IHC_PLATFORM names: `make dist` makes all wheels so.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

VARIABLE = "QUBE_IHC_PLATFORM"
TAGS = {
    "linux64": "manylinux_2_17_x86_64",
    "aarch64-linux": "manylinux_2_17_aarch64",
    "win64": "win_amd64",
    "darwin64": "macosx_11_0_universal2",
}


class NativeBinaries(BuildHookInterface):
    """Runs `cosim.build` before the wheel, or the editable installation, is put together."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build, and tell the wheel which platform it is for; raises SystemExit for a platform that is none."""
        root = Path(self.root)
        sys.path[:0] = [str(root / "src"), str(root)]
        from cosim.build import build  # noqa: PLC0415
        from fmu_export.native_build import PLATFORMS, host_platform  # noqa: PLC0415

        name = os.environ.get(VARIABLE) or host_platform().name
        if name not in TAGS:
            raise SystemExit(f"{VARIABLE} must be one of {', '.join(TAGS)}, found {name}")
        paths = build(PLATFORMS[name])
        build_data["artifacts"] += sorted({path.parent.relative_to(root).as_posix() for path in paths})
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{TAGS[name]}"
