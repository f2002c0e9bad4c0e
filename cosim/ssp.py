"""System Structure and Parameterization files (SSP 1.0) as scenarios, and scenarios as such files.

A file has FMUs, connections between them, start values in sets of parameters (inside, or as files *.ssv) and the run's
duration. Whatever else the standard has (systems inside systems, mappings of parameters and values, URLs) is refused.
An SSP is a stranger's archive: it is unpacked as `archives` does, and nothing outside it is read.
"""

from __future__ import annotations

import math
import re
import shutil
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Any, NoReturn
from urllib.parse import unquote
from xml.etree import ElementTree as ET

from fmpy.model_description import ModelDescription

from filing.origin import origin
from filing.ownership import check_replaceable
from fmu_export.archive import write_zip
from fmu_export.errors import shown
from fmu_export.files import FilePath
from fmu_export.ssp import OMS, SSC, SSD, write_ssp

from .archives import UnpackedArchive
from .errors import UserError
from .fmu_files import describe, start_values_of
from .integration import INTERFACES, interface_of
from .names import is_plain
from .start_values import StartValue
from .structure import SystemStructure
from .unit_definitions import conversion, scale_of
from .wiring import CONTROLLER, PLANT

SSV = "http://ssp-standard.org/SSP1/SystemStructureParameterValues"
SUFFIX = ".ssp"
DESCRIPTION = "SystemStructure.ssd"
FMU_TYPE = "application/x-fmu-sharedlibrary"

STEP, DURATION = 1e-3, 10.0
"""Where neither the file nor its FMUs say others [s]."""


class _NoDoctype(ET.TreeBuilder):
    """Refuses XML with a document type: its entities can read other files, and grow without end."""

    def doctype(self, *_: object) -> NoReturn:
        raise UserError("a document type has no place in it")


def _parsed(content: bytes, source: str) -> ET.Element:
    try:
        parser = ET.XMLParser(target=_NoDoctype())
        parser.feed(content)
        return parser.close()
    except (ET.ParseError, ValueError, LookupError) as error:
        raise UserError(f"{source} is not a system description: {error}") from None


@lru_cache(maxsize=16)
def _unpacked(path: Path, _time: int, _size: int) -> UnpackedArchive:
    return UnpackedArchive(path)


def read(path: FilePath) -> tuple[dict[str, Any], Path]:
    """Return (a scenario's data, the folder of its FMUs) of an SSP file.

    Raises UserError for what is no such file, or has what this reader does not take.
    """
    path = Path(path)
    try:
        status = path.stat()
    except OSError as error:
        raise UserError(f"SSP file {path} cannot be read: {error.strerror}") from None
    if not zipfile.is_zipfile(path):
        raise UserError(f"{path} is not an SSP file: it is not a zip file")
    archive = _unpacked(path.absolute(), status.st_mtime_ns, status.st_size)
    folder, description = archive.folder, archive.folder / DESCRIPTION
    if not description.is_file():
        raise UserError(f"{path} is not an SSP file: it has no {DESCRIPTION}")
    try:
        return _Reader(folder, _parsed(description.read_bytes(), DESCRIPTION)).data(), folder / FMUS
    except UserError as error:
        raise UserError(f"{path}: {error}") from None


FMUS = "fmus of the system"
"""The folder that all FMUs of an unpacked SSP are put into, beside its own."""


@dataclass
class _Reader:
    """An unpacked SSP with its parsed description."""

    folder: Path
    root: ET.Element

    def data(self) -> dict[str, Any]:
        """Return a scenario's data."""
        system = self.root.find(f"{{{SSD}}}System")
        if self.root.tag != f"{{{SSD}}}SystemStructureDescription" or system is None:
            raise UserError(f"{DESCRIPTION} must be a SystemStructureDescription of SSP 1.0 with a System")
        elements = list(system.iterfind(f"{{{SSD}}}Elements/*"))
        for element in elements:
            if element.tag != f"{{{SSD}}}Component":
                raise UserError(f"the element {element.get('name')!r} must be a component, found {_local(element.tag)}")
        self.names = self._names([element.get("name", "") for element in elements])
        self.interfaces = {self.names[e.get("name", "")]: _interface(e) for e in elements}
        self.paths = self._placed({self.names[element.get("name", "")]: element for element in elements})
        start = {self.names[e.get("name", "")]: self._values(e) for e in elements}
        for name, value in self._values(system).items():
            component, _, variable = name.partition(".")
            if component not in self.names:
                raise UserError(f"the parameter {name!r} of the system names no component")
            start[self.names[component]][variable] = value
        wires = [wire for c in system.iterfind(f"{{{SSD}}}Connections/{{{SSD}}}Connection") for wire in self._wire(c)]
        self._fill(start, wires)
        return self._scenario(system, start, wires)

    def _names(self, given: list[str]) -> dict[str, str]:
        """Return the components' names here by those there: letters, digits and underscores."""
        names = {name: re.sub(r"\W", "_", name, flags=re.ASCII) for name in given}
        names = {name: f"_{own}" if not own or own[0].isdigit() else own for name, own in names.items()}
        if not given or len(set(names.values())) < len(given):
            raise UserError(f"components need different names, found {', '.join(given) or 'none'}")
        return names

    def _placed(self, components: Mapping[str, ET.Element]) -> dict[str, Path]:
        """Put the components' FMUs into one folder; return their paths there."""
        sources = {name: self._source(element) for name, element in components.items()}
        place, placed = self.folder / FMUS, {}
        place.mkdir(exist_ok=True)
        for name, source in sources.items():
            twins = {other for other in sources.values() if other.name.casefold() == source.name.casefold()}
            plain = is_plain(source.name) and len(twins) == 1
            placed[name] = place / (source.name if plain else f"{name}.fmu")
            if not placed[name].exists():
                shutil.copyfile(source, placed[name])
        return placed

    def _source(self, element: ET.Element) -> Path:
        """Return the path of a component's FMU."""
        name, kind = element.get("name"), element.get("type", FMU_TYPE)
        if kind != FMU_TYPE:
            raise UserError(f"the component {name!r} must be an FMU, found {kind}")
        return self._inside(element.get("source", ""), f"the component {name!r}")

    def _inside(self, source: str, what: str) -> Path:
        """Return the path of a file of the archive; raise UserError for another place."""
        relative = PurePosixPath(unquote(source))
        inside = source and not relative.is_absolute() and ".." not in relative.parts and ":" not in source
        path = self.folder / relative
        if not inside or "\0" in unquote(source) or not path.is_file():
            raise UserError(f"{what} must have its file inside the archive, found {shown(source)}")
        return path

    def _values(self, element: ET.Element) -> dict[str, StartValue]:
        """Return the start values of an element's parameter bindings, later ones before earlier ones."""
        values: dict[str, StartValue] = {}
        for binding in element.iterfind(f"{{{SSD}}}ParameterBindings/{{{SSD}}}ParameterBinding"):
            if binding.find(f"{{{SSD}}}ParameterMapping") is not None:
                raise UserError(
                    f"the parameters of {element.get('name')!r} are mapped, which this reader does not take"
                )
            for parameter in self._set(binding).iterfind(f"{{{SSV}}}Parameters/{{{SSV}}}Parameter"):
                name = binding.get("prefix", "") + parameter.get("name", "")
                values[name] = _value(name, parameter)
        return values

    def _set(self, binding: ET.Element) -> ET.Element:
        """Return the parameter set of a binding: inside it, or its file."""
        inline = binding.find(f"{{{SSD}}}ParameterValues/{{{SSV}}}ParameterSet")
        if inline is not None:
            return inline
        source = binding.get("source", "")
        path = self._inside(source, "a set of parameters")
        root = _parsed(path.read_bytes(), source)
        if root.tag != f"{{{SSV}}}ParameterSet":
            raise UserError(f"{source} must be a ParameterSet, found {_local(root.tag)}")
        return root

    def _wire(self, connection: ET.Element) -> Iterator[dict[str, Any]]:
        """Yield the wire of a connection; none where it ends at the system's own border, which nothing is behind."""
        ends = [(connection.get(f"{end}Element"), connection.get(f"{end}Connector", "")) for end in ("start", "end")]
        if any(component is None for component, _ in ends):
            return
        for component, connector in ends:
            if component not in self.names:
                raise UserError(f"a connection must end at components, found {component!r}.{connector!r}")
        (a, x), (b, y) = ((self.names[component or ""], connector) for component, connector in ends)
        changes = self._conversion(connection, (a, x), (b, y))
        yield {"source": f"{a}.{x}", "target": f"{b}.{y}", **changes}

    def _conversion(self, connection: ET.Element, source: tuple[str, str], target: tuple[str, str]) -> dict[str, float]:
        """Return factor and offset of a connection: its own, or as the standard has it those between its ends' units."""
        others = [child for child in connection if child.tag.startswith(f"{{{SSC}}}")]
        for child in others:
            if child.tag != f"{{{SSC}}}LinearTransformation":
                raise UserError(
                    f"the connection to {'.'.join(target)} has a {_local(child.tag)}, which this reader does not take"
                )
            return {
                name: _number(child.get(name, default), name) for name, default in (("factor", "1"), ("offset", "0"))
            }
        if connection.get("suppressUnitConversion", "false") in ("true", "1"):
            return {}
        scales = [scale_of(self._description(name), self._unit(name, variable)) for name, variable in (source, target)]
        converted = None if None in scales else conversion(*(scale for scale in scales if scale is not None))
        return {} if converted is None else {"factor": converted[0], "offset": converted[1]}

    def _description(self, name: str) -> ModelDescription:
        return describe(self.paths[name])

    def _unit(self, component: str, variable: str) -> str:
        units = (v.unit for v in self._description(component).modelVariables if v.name == variable)
        return next(units, None) or ""

    def _fill(self, start: dict[str, dict[str, StartValue]], wires: list[dict[str, Any]]) -> None:
        """Give the inputs of a controller that nothing is connected to the start values that they have by the standard."""
        if CONTROLLER not in self.paths:
            return
        targets, own = {wire["target"] for wire in wires}, start_values_of(self.paths[CONTROLLER])
        for variable in self._description(CONTROLLER).modelVariables:
            free = variable.causality == "input" and f"{CONTROLLER}.{variable.name}" not in targets
            if free and variable.name in own:
                start[CONTROLLER].setdefault(variable.name, own[variable.name])

    def _scenario(
        self, system: ET.Element, start: Mapping[str, dict[str, StartValue]], wires: list[dict[str, Any]]
    ) -> dict[str, Any]:
        parts = {
            name: {"fmu": path.name, "interface": self.interfaces[name], "start": start[name]}
            for name, path in self.paths.items()
        }
        both = {name: parts.pop(name, {"fmu": "none"}) for name in (CONTROLLER, PLANT)}
        experiments = [
            d.defaultExperiment for d in map(self._description, self.paths) if d.defaultExperiment is not None
        ]
        stops = [float(e.stopTime) for e in experiments if e.stopTime is not None]
        steps = [float(e.stepSize) for e in experiments if e.stepSize is not None]
        master = system.find(
            f"{{{SSD}}}Annotations/{{{SSC}}}Annotation/{{{OMS}}}Annotations/*/{{{OMS}}}FixedStepMaster"
        )
        own = None if master is None else master.get("stepSize")
        step = min(steps, default=STEP) if own is None else _number(own, "stepSize")
        experiment = self.root.find(f"{{{SSD}}}DefaultExperiment")
        stop = None if experiment is None else experiment.get("stopTime")
        duration = max(stops, default=DURATION) if stop is None else _number(stop, "stopTime")
        if experiment is not None and _number(experiment.get("startTime", "0"), "startTime") != 0.0:
            raise UserError(f"the run must begin at 0 s, found startTime {experiment.get('startTime')}")
        described = {"description": self.root.get("description", "") or self.root.get("name", "")}
        run = {"step": step if math.isfinite(step) else STEP, "duration": duration}
        return {**described, "run": run, "wires": wires, **both, "components": parts}


def _interface(component: ET.Element) -> str | None:
    """Return how a component wants its FMU to be run; None: as the FMU can."""
    name, wanted = component.get("name"), component.get("implementation", "any")
    if wanted not in ("any", *INTERFACES):
        raise UserError(
            f"the implementation of the component {name!r} must be any, {' or '.join(INTERFACES)}, found {shown(wanted)}"
        )
    return None if wanted == "any" else wanted


def _local(tag: str) -> str:
    return tag.rpartition("}")[2]


def _number(text: str, what: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise UserError(f"{what} must be a number, found {shown(text)}") from None


def _value(name: str, parameter: ET.Element) -> StartValue:
    """Return the value of a parameter in a set, in its type."""
    typed = next((child for child in parameter if child.tag.startswith(f"{{{SSV}}}")), None)
    kind, text = ("none", "") if typed is None else (_local(typed.tag), typed.get("value", ""))
    if kind == "Boolean" and text in ("true", "false", "1", "0"):
        return text in ("true", "1")
    if kind in ("String", "Enumeration"):
        return int(text) if kind == "Enumeration" and re.fullmatch(r"[0-9]{1,9}", text) else text
    if kind == "Integer" and re.fullmatch(r"[-+]?[0-9]{1,15}", text):
        return int(text)
    if kind == "Real":
        return _number(text, f"the parameter {name!r}")
    raise UserError(
        f"the parameter {name!r} must be a Real, Integer, Boolean, String or Enumeration, found {kind} {shown(text)}"
    )


def write(path: FilePath, name: str, system: SystemStructure, duration: float, step: float) -> Path:
    """Write a system as an SSP file: FMUs, wires with their conversions, start values, the run's duration; return `path`.

    Signals have no place in it: their inputs keep their start values. Raises UserError as `write_ssp`.
    """
    path = Path(path)
    check_replaceable(path)
    components = {c.name: c.path for c in system.components}
    with tempfile.TemporaryDirectory(prefix="qube-ihc-") as folder:
        wires = [(w.source, w.target) for w in system.wires]
        plain = write_ssp(Path(folder) / path.name, name, components, wires, origin())
        with zipfile.ZipFile(plain) as archive:
            contents = {entry: archive.read(entry) for entry in archive.namelist()}
    root = ET.fromstring(contents[DESCRIPTION])
    ET.register_namespace("ssv", SSV)
    for component in system.components:
        element = root.find(f".//{{{SSD}}}Component[@name='{component.name}']")
        assert element is not None
        element.set("implementation", interface_of(component.path, component.interface))
        _add_values(element, component.path, component.start)
    connections = root.findall(f".//{{{SSD}}}Connection")
    for wire, connection in zip(system.wires, connections, strict=True):
        if wire.converts:
            attributes = {"factor": repr(wire.factor), "offset": repr(wire.offset)}
            ET.SubElement(connection, f"{{{SSC}}}LinearTransformation", attributes)
    for master in root.iter(f"{{{OMS}}}FixedStepMaster"):
        master.set("stepSize", repr(step))
    ET.SubElement(root, f"{{{SSD}}}DefaultExperiment", startTime="0.0", stopTime=repr(duration))
    ET.indent(root)
    contents[DESCRIPTION] = ET.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"
    write_zip(path, contents, origin().software)
    return path


def _add_values(element: ET.Element, fmu: Path, start: Mapping[str, StartValue]) -> None:
    """Add start values to a component: a set of parameters, and a connector for each that has none."""
    if not start:
        return
    variables = {v.name: v for v in describe(fmu).modelVariables}
    connectors = element.find(f"{{{SSD}}}Connectors")
    assert connectors is not None
    known = {connector.get("name") for connector in connectors}
    bindings = ET.SubElement(element, f"{{{SSD}}}ParameterBindings")
    values = ET.SubElement(ET.SubElement(bindings, f"{{{SSD}}}ParameterBinding"), f"{{{SSD}}}ParameterValues")
    parameters = ET.SubElement(
        ET.SubElement(values, f"{{{SSV}}}ParameterSet", version="1.0", name="start values"), f"{{{SSV}}}Parameters"
    )
    for name, value in start.items():
        variable = variables[name]
        if name not in known:
            kind = "input" if variable.causality == "input" else "parameter"
            connector = ET.SubElement(connectors, f"{{{SSD}}}Connector", name=name, kind=kind)
            ET.SubElement(connector, f"{{{SSC}}}{variable.type.replace('Enumeration', 'Integer')}")
        text = str(value).lower() if isinstance(value, bool) else str(value)
        parameter = ET.SubElement(parameters, f"{{{SSV}}}Parameter", name=name)
        ET.SubElement(parameter, f"{{{SSV}}}{variable.type.replace('Enumeration', 'Integer')}", value=text)
