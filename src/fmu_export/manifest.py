"""What the manifest among a Python FMU's resources says: which code it bundles, and what it shows of the slave's variables.

Standard library only: this module travels inside the Python FMUs.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .shown import Showing
from .variables import Interface, Value

MANIFEST = "manifest.json"


def code_digest(code: Mapping[str, bytes]) -> str:
    """Return the SHA-256 of Python files, by name and content."""
    digest = hashlib.sha256()
    for name in sorted(code):
        digest.update(name.encode() + b"\0" + code[name] + b"\0")
    return digest.hexdigest()


def manifest_of(showing: Showing, start: Mapping[str, Value], hidden: Mapping[str, Value | str]) -> dict[str, Any]:
    """Return what a slave needs to know of its FMU's interface, as JSON types; `showing_in` reads it.

    `start` by shown names, `hidden` by those of the slave's interface.
    """
    shown = showing.interface
    return {
        "name": shown.name,
        "shown": {v.compiled: {"name": v.name, "unit": v.unit} for v in shown.variables},
        "start_values": dict(start),
        "hidden_values": dict(hidden),
    }


def showing_in(table: Interface, manifest: Mapping[str, Any]) -> Showing:
    """Return what a manifest says that the FMU shows of the slave's interface `table`."""
    variables = [table.by_name[slot].shown_as(v["name"], unit=v["unit"]) for slot, v in manifest["shown"].items()]
    return Showing(table, table.showing(variables, name=manifest["name"], step_parameter=None))


def check_bundle(instance: str, running: str, resources: Path, manifest: Mapping[str, Any]) -> None:
    """Raise ImportError where the package `running`, or its code, is not the one that the FMU was exported with."""
    package = manifest["package"]
    if running != package:
        raise ImportError(f"{instance}: this FMU bundles {package}, but Python runs {running}")
    folder = resources / package
    digest = code_digest({f.relative_to(folder).as_posix(): f.read_bytes() for f in folder.rglob("*.py")})
    if digest != manifest["code_digest"]:
        raise ImportError(
            f"{instance}: the code in {package} is not the code that was exported "
            f"(SHA-256 {digest[:12]}, expected {manifest['code_digest'][:12]})"
        )
