"""Build hook: compiles the host's binaries with the package ziglang and puts them into the wheel."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

TAGS = {
    "linux64": "manylinux_2_17_x86_64",
    "aarch64-linux": "manylinux_2_17_aarch64",
    "win64": "win_amd64",
    "darwin64": "macosx_11_0_universal2",
}


class NativeBinaries(BuildHookInterface):
    """Runs `cosim.build` before the wheel, or the editable installation, is put together."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build, and tell the wheel which platform it is for."""
        root = Path(self.root)
        sys.path[:0] = [str(root / "src"), str(root)]
        from cosim.build import build  # noqa: PLC0415
        from fmu_export.native_build import host_platform  # noqa: PLC0415

        build()
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{TAGS[host_platform().name]}"
