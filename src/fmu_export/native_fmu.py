"""Native FMUs: a unit's binaries, its C sources and its start values in one reproducible file; no Python inside.

The binaries do not depend on the design: they read their start values from the FMU's resources. Among the sources the
start values are compiled in, so that an importer that rebuilds them needs no file at run time.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from pathlib import Path

from .archive import content_guid, further_resources, write_zip
from .documentation import documents
from .errors import UserError
from .files import FilePath
from .model_description import Capabilities, ModelExchange, model_description
from .native_build import (
    BINARIES,
    PLATFORMS,
    BuildError,
    Platform,
    build_library,
    host_platform,
    installed_library,
)
from .native_unit import ADAPTER, NativeUnit, checked_identifier, start_value_file, start_value_source, unit_files
from .origin import ANONYMOUS, Origin
from .shown import Showing
from .variables import Interface, Value

START_VALUES_SOURCE = "start_values.c"
VALUES = "start_values.bin"
"""The start values among the resources, which an importer that has the binary reads."""
LICENSES = {
    "FMI.txt": ("the header files of FMI", ADAPTER / "fmi2" / "LICENSE.txt"),
    "Zig.txt": ("what Zig's C compiler adds to binaries", Path(__file__).parent / "licenses" / "Zig.txt"),
    "mingw-w64.txt": ("the runtime in binaries for Windows", Path(__file__).parent / "licenses" / "mingw-w64.txt"),
}
"""Of what native FMUs hold beside their own code: what it is, and the text."""
ALL = "all"
"""In place of the names of all platforms."""


def export_native_fmu(
    unit: NativeUnit,
    path: FilePath,
    changes: Mapping[str, Value | str] | None = None,
    notes: str = "",
    platforms: Iterable[str] | None = None,
    building: Callable[[str], object] | None = None,
    outputs: Collection[str] | None = None,
    *,
    interface: Interface | None = None,
    hidden: Mapping[str, Value | str] | None = None,
    identifier: str | None = None,
    origin: Origin = ANONYMOUS,
    resources: Mapping[str, bytes] | None = None,
) -> Path:
    """Write the FMU of `unit` to `path`, with the start values of its interface and `changes` to them; return `path`.

    `interface` is what the FMU shows of the unit's compiled variables (`Variable.slot`), None: all of them as they are;
    `hidden` are start values of others, by compiled names. `identifier` is the modelIdentifier, also the name of the binary
    inside and of the functions of the sources, None: the unit's name. `origin` is who makes the FMU. `resources` are further
    files of its folder `resources`, by name, which its code does not read.

    `platforms` names what to hold binaries for, "all" among them: every one, None: this machine, which the installation
    has built; others are compiled now, by the package ziglang; `building` is told which, before each. `outputs` names
    those that are outputs, None: all; the others become local variables. `notes` is HTML for the FMU's documentation. The
    same arguments give the same bytes. The file is written beside and renamed. Raises UserError for start values that the
    interface does not admit or that contradict each other, for an identifier that is none in C and for unknown platforms,
    BuildError where there is no binary, ValueError for an interface that does not fit the unit's table and for a resource
    that is no file of its own.
    """
    path, showing = Path(path), Showing(unit.interface, unit.interface if interface is None else interface)
    identifier = checked_identifier(unit.interface.name if identifier is None else identifier)
    start = showing.interface.start_values(changes)
    values = showing.admitted(unit.twin, start, hidden or {})
    shown = showing.interface if outputs is None else showing.interface.exposing(outputs)
    sources = {name: file.read_bytes() for name, file in unit.sources.items()}
    sources |= {name: text.encode() for name, text in unit.headers(identifier).items()}
    capabilities = Capabilities(
        identifier=identifier,
        needs_execution_tool=False,
        generation_tool=origin.tool,
        origin=origin,
        sources=tuple(sorted([name for name in sources if name.endswith(".c")] + [START_VALUES_SOURCE])),
        model_exchange=None if unit.model_exchange is None else _shown_exchange(showing, unit.model_exchange(values)),
    )
    files = {f"sources/{name}": text for name, text in sources.items()} | further_resources(resources, (VALUES,))
    for platform in _platforms(platforms):
        if building is not None:
            building(f"{identifier} for {platform.name}")
        name = f"{identifier}{platform.suffix}"
        files[f"binaries/{platform.name}/{name}"] = _binary(unit, platform)
        if platforms is None and platform.name == "aarch64-linux":
            files[f"binaries/linux64/{name}"] = files[f"binaries/{platform.name}/{name}"]  # where FMPy looks on ARM
    files |= documents(
        shown, start, notes, origin, {n: (what, text.read_bytes()) for n, (what, text) in LICENSES.items()}
    )
    references = showing.references
    digested = {**files, "values": start_value_file(unit.interface, "", values, showing.names)}
    guid = content_guid(digested, model_description(shown, start, "", capabilities, references))
    files[f"resources/{VALUES}"] = start_value_file(unit.interface, guid, values, showing.names)
    files[f"sources/{START_VALUES_SOURCE}"] = start_value_source(unit.interface, guid, values, showing.names).encode()
    files["modelDescription.xml"] = model_description(shown, start, guid, capabilities, references)
    write_zip(path, files, origin.software)
    return path


def _shown_exchange(showing: Showing, compiled: ModelExchange) -> ModelExchange:
    """Return the structure for model exchange in shown names; raise ValueError where a state is not shown."""
    names = showing.names
    for name in (*compiled.states, *compiled.derivatives):
        if name not in names:
            raise ValueError(f"model exchange needs {name} of {showing.table.name} to be shown")

    def shown(variables: Iterable[str]) -> tuple[str, ...]:
        return tuple(names[name] for name in variables if name in names)

    def translated(dependencies: Mapping[str, tuple[str, ...]]) -> dict[str, tuple[str, ...]]:
        return {names[name]: shown(known) for name, known in dependencies.items() if name in names}

    return ModelExchange(
        shown(compiled.states),
        shown(compiled.derivatives),
        translated(compiled.dependencies),
        translated(compiled.initial_dependencies),
    )


def _platforms(names: Iterable[str] | None) -> list[Platform]:
    if names is None:
        return [host_platform()]
    wanted = list(dict.fromkeys(names))
    for name in wanted:
        if name not in PLATFORMS and name != ALL:
            raise UserError(f"a platform must be one of {', '.join(PLATFORMS)}, found {name!r}")
    return list(PLATFORMS.values()) if ALL in wanted else [PLATFORMS[name] for name in wanted]


def _binary(unit: NativeUnit, platform: Platform) -> bytes:
    """Return the installed binary, or for another machine's platform a new one."""
    try:
        is_host = platform == host_platform()
    except BuildError:
        is_host = False
    if is_host:
        return installed_library(BINARIES, unit_files(unit), unit.interface.name, platform).read_bytes()
    return build_library(unit_files(unit), unit.interface.name, platform)
