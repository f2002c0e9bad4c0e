"""Python FMUs: a unit's step code, PythonFMU's slave class and its compiled wrapper, in one reproducible file.

PythonFMU's own builder bundles modules under their plain names, so that two FMUs, or an FMU and its host, that have a
module of the same name silently run one another's code; it also writes a new GUID and new time stamps in each build.
Here the code, PythonFMU's slave class included, becomes one package whose name carries a hash of its content.
"""

from __future__ import annotations

import ast
import importlib.metadata
import json
import re
import sys
from collections.abc import Collection, Mapping
from importlib.util import find_spec
from pathlib import Path, PurePosixPath

from .archive import content_guid, further_resources, license_of, write_zip
from .documentation import documents
from .files import FilePath
from .guarded_slave import GuardedSlave
from .manifest import MANIFEST, code_digest, manifest_of
from .model_description import Capabilities, model_description
from .native_unit import checked_identifier
from .origin import ANONYMOUS, Origin
from .shown import Showing
from .variables import Interface, Value

SHARED = ("fmu_export", "pythonfmu")
"""Packages that every unit's code may import besides its own and those that its slave names."""

SCRIPT = """import ctypes

from {package}.{module} import {name}

# With each instantiation the wrapper runs this script and releases its globals, which it does not own.
ctypes.pythonapi.Py_IncRef(ctypes.py_object(globals()))
"""
"""What the wrapper loads: it looks for a slave class among the names of this script."""


def export_python_fmu(
    slave: type[GuardedSlave],
    path: FilePath,
    changes: Mapping[str, Value | str] | None = None,
    notes: str = "",
    outputs: Collection[str] | None = None,
    *,
    interface: Interface | None = None,
    hidden: Mapping[str, Value | str] | None = None,
    identifier: str | None = None,
    origin: Origin = ANONYMOUS,
    resources: Mapping[str, bytes] | None = None,
) -> Path:
    """Write the FMU of `slave` to `path`, with the start values of its interface and `changes` to them; return `path`.

    `interface` is what the FMU shows of the slave's variables (`Variable.slot`), None: all of them as they are; `hidden` are
    start values of others, by the slave's names. `identifier` is the modelIdentifier, None: the name of the slave's
    interface. `notes` is HTML for the FMU's documentation. `outputs` names those that are outputs, None: all; the others
    become local variables. `origin` is who makes the FMU. `resources` are further files of its folder `resources`, by name,
    which its code does not read. The same arguments give the same bytes. The file is written beside and renamed, so an
    interrupted export leaves an earlier file as it was. Raises UserError for start values that the interface does not admit
    or that contradict each other and for an identifier that is none in C, ValueError for an interface that does not fit the
    slave's and for a resource that is no file of its own.
    """
    path, showing = Path(path), Showing(slave.interface, slave.interface if interface is None else interface)
    identifier = checked_identifier(slave.interface.name if identifier is None else identifier)
    start = showing.interface.start_values(changes)
    showing.admitted(slave.unit_class, start, hidden or {})
    shown = showing.interface if outputs is None else showing.interface.exposing(outputs)
    files = _resources(slave, identifier, manifest_of(showing, start, hidden or {}))
    files |= further_resources(resources, [PurePosixPath(name).parts[1] for name in files])
    version = importlib.metadata.version("pythonfmu")
    capabilities = Capabilities(
        identifier=identifier,
        needs_execution_tool=True,
        generation_tool=f"{origin.tool} with PythonFMU {version}",
        origin=origin,
    )
    files |= _binaries(identifier)
    files |= documents(shown, start, notes, origin, {"PythonFMU.txt": ("PythonFMU", license_of("pythonfmu"))})
    references = showing.references
    guid = content_guid(files, model_description(shown, start, "", capabilities, references))
    files["modelDescription.xml"] = model_description(shown, start, guid, capabilities, references)
    write_zip(path, files, origin.software)
    return path


def _resources(slave: type[GuardedSlave], identifier: str, values: Mapping[str, object]) -> dict[str, bytes]:
    """Return the bundled package, the script that the wrapper loads, and the manifest with `values`."""
    code = {name.replace(".", "/") + ".py": text for name, text in _modules(slave.__module__, slave.packages).items()}
    folders = {str(parent) for name in code for parent in PurePosixPath(name).parents} - {"."}
    code |= {f"{folder}/__init__.py": b"" for folder in folders} | {"__init__.py": b""}
    digest = code_digest(code)
    script = f"{identifier}_{digest[:12]}"
    package = f"{script}_code"
    files = {f"resources/{package}/{name}": text for name, text in code.items()}
    files[f"resources/{script}.py"] = SCRIPT.format(
        package=package, module=slave.__module__, name=slave.__name__
    ).encode()
    files["resources/slavemodule.txt"] = script.encode()
    manifest = {
        "script": script,
        "package": package,
        "code_digest": digest,
        "identifier": identifier,
        **values,
    }
    files[f"resources/{MANIFEST}"] = json.dumps(manifest, indent=1).encode()
    return files


def _modules(root: str, packages: Collection[str]) -> dict[str, bytes]:
    """Return the module `root` and all it imports, by name, with imports made relative to the bundling package.

    Raises ImportError where a module imports anything but its own package, `packages`, the shared ones and the standard
    library.
    """
    unit_package = root.split(".", maxsplit=1)[0]
    own = {unit_package, *packages, *SHARED}
    bundled_modules: dict[str, bytes] = {}
    queue = [root]
    while queue:
        name = queue.pop()
        if name in bundled_modules:
            continue
        spec = find_spec(name)
        if spec is None or spec.origin is None:
            raise ImportError(f"module {name} cannot be found, so it cannot be bundled")
        source = Path(spec.origin).read_text(encoding="utf-8")
        for imported in _imports(source, name, own):
            top = imported.split(".")[0]
            if top in own:
                queue.append(imported)
            elif top not in sys.stdlib_module_names:
                raise ImportError(
                    f"{name} imports {imported}: code that runs in an FMU imports the standard library only"
                )
        pattern = rf"^(\s*)from ({'|'.join(sorted(own))})(?=[. ])"
        dots = "." * (name.count(".") + 1)
        bundled = re.sub(pattern, rf"\1from {dots}\2", source, flags=re.MULTILINE)
        left = [imported for imported in _absolute_imports(bundled) if imported.split(".")[0] in own]
        if left:
            raise ImportError(f"{name} must import {left[0]} as `from {left[0]} import NAME` to be bundled")
        bundled_modules[name] = bundled.encode()
    return bundled_modules


def _absolute_imports(source: str) -> set[str]:
    """Return the names of the modules that `source` imports absolutely."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names.add(node.module or "")
    return names


def _imports(source: str, module: str, own: Collection[str]) -> set[str]:
    """Return the full names of the modules that `source` imports; from a package in `own` these are its members."""
    names = _absolute_imports(source) - set(own)
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.ImportFrom):
            continue
        members = [node.module] if node.module else [alias.name for alias in node.names]
        if node.level:
            package = module.rsplit(".", node.level)[0]
            names |= {f"{package}.{member}" for member in members}
        elif node.module in own:
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def _binaries(model_identifier: str) -> dict[str, bytes]:
    """Return PythonFMU's compiled wrapper for every platform that it has, under the FMU's name."""
    spec = find_spec("pythonfmu")
    assert spec is not None and spec.origin is not None  # noqa: PT018
    folder = Path(spec.origin).parent / "resources" / "binaries"
    return {
        f"binaries/{file.parent.name}/{model_identifier}{file.suffix}": file.read_bytes()
        for file in sorted(folder.rglob("*"))
        if file.suffix in {".so", ".dll", ".dylib"}
    }
