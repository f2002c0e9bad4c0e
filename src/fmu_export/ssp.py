"""A system of FMUs as one System Structure and Parameterization file (SSP 1.0): the FMUs and the wires between them."""

from __future__ import annotations

import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from xml.etree import ElementTree as ET

from .archive import write_zip
from .errors import UserError
from .files import FilePath
from .origin import ANONYMOUS, Origin
from .units import base_unit

SSD = "http://ssp-standard.org/SSP1/SystemStructureDescription"
SSC = "http://ssp-standard.org/SSP1/SystemStructureCommon"
OMS = "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd"


def write_ssp(
    path: FilePath,
    name: str,
    components: Mapping[str, FilePath],
    wires: Iterable[tuple[str, str]],
    origin: Origin = ANONYMOUS,
) -> Path:
    """Write the SSP `path` of the FMU files `components` by instance name and the `wires`; return `path`.

    A wire is (output, input), each as `instance.variable`; a variable's name may have dots, an instance's not. All outputs
    become connectors, and those inputs that a wire ends at; other inputs keep their start values. An annotation gives
    OMSimulator its master: fixed steps, as long as the FMUs that cannot vary theirs want. The same files give the same
    bytes. `origin` is who makes the file. Raises UserError for a wire from what is no output or to what is no input, an
    instance's name with a dot and different files of one name.
    """
    ends = [(*_parts(a), *_parts(b)) for a, b in wires]
    path, fmus = Path(path), {instance: Path(fmu) for instance, fmu in components.items()}
    _check_components(fmus)
    ET.register_namespace("ssd", SSD)
    ET.register_namespace("ssc", SSC)
    ET.register_namespace("oms", OMS)
    root = ET.Element(f"{{{SSD}}}SystemStructureDescription", name=name, version="1.0", generationTool=origin.software)
    system = ET.SubElement(root, f"{{{SSD}}}System", name=name)
    elements = ET.SubElement(system, f"{{{SSD}}}Elements")
    files: dict[str, bytes] = {}
    units: set[str] = set()
    descriptions = {instance: _description(fmu) for instance, fmu in fmus.items()}
    causalities = {
        (instance, v.get("name")): v.get("causality")
        for instance, d in descriptions.items()
        for v in d.iter("ScalarVariable")
    }
    for a, x, b, y in ends:
        for owner, variable, causality in ((a, x, "output"), (b, y, "input")):
            if causalities.get((owner, variable)) != causality:
                raise UserError(f"the wire {a}.{x} -> {b}.{y} needs the {causality} {owner}.{variable}")
    for instance, fmu in fmus.items():
        source = f"resources/{fmu.name}"
        files[source] = fmu.read_bytes()
        component = ET.SubElement(
            elements, f"{{{SSD}}}Component", name=instance, type="application/x-fmu-sharedlibrary", source=source
        )
        wired = {variable for _, _, owner, variable in ends if owner == instance}
        units |= _add_connectors(component, descriptions[instance], wired)
    connections = ET.Element(f"{{{SSD}}}Connections")
    for a, x, b, y in ends:
        ET.SubElement(
            connections, f"{{{SSD}}}Connection", startElement=a, startConnector=x, endElement=b, endConnector=y
        )
    _append(system, connections)
    _add_master(system, min(_steps(descriptions.values())))
    _add_units(root, units)
    ET.indent(root)
    files["SystemStructure.ssd"] = ET.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"
    write_zip(path, files, origin.software)
    return path


def _check_components(components: Mapping[str, Path]) -> None:
    paths: dict[str, Path] = {}
    for instance, path in components.items():
        if "." in instance:
            raise UserError(f"an instance's name must have no dot, found {instance!r}")
        if paths.setdefault(path.name, path) != path:
            raise UserError(f"FMU files must have different names, found {paths[path.name]} and {path}")


def _parts(end: str) -> tuple[str, str]:
    instance, _, variable = end.partition(".")
    return instance, variable


def _description(fmu: Path) -> ET.Element:
    with zipfile.ZipFile(fmu) as archive:
        return ET.fromstring(archive.read("modelDescription.xml"))


def _steps(descriptions: Iterable[ET.Element]) -> list[float]:
    """Return the step sizes [s] that the FMUs want which cannot vary theirs; where all can, those of all."""
    steps: dict[bool, list[float]] = {False: [], True: []}
    for root in descriptions:
        stepped = root.find("CoSimulation")
        free = stepped is None or stepped.get("canHandleVariableCommunicationStepSize") == "true"
        experiment = root.find("DefaultExperiment")
        steps[free].append(float("nan" if experiment is None else experiment.get("stepSize", "nan")))
    return steps[False] or steps[True]


def _add_master(system: ET.Element, step: float) -> None:
    """Add what OMSimulator wants to know of its master; other tools ignore it."""
    annotations = ET.SubElement(system, f"{{{SSD}}}Annotations")
    annotation = ET.SubElement(annotations, f"{{{SSC}}}Annotation", type="org.openmodelica")
    information = ET.SubElement(ET.SubElement(annotation, f"{{{OMS}}}Annotations"), f"{{{OMS}}}SimulationInformation")
    ET.SubElement(
        information,
        f"{{{OMS}}}FixedStepMaster",
        description="oms-ma",
        stepSize=repr(step),
        absoluteTolerance="1e-4",
        relativeTolerance="1e-4",
    )


def _add_connectors(component: ET.Element, description: ET.Element, wired: set[str]) -> set[str]:
    """Add the FMU's outputs and wired inputs as connectors; return the units that they use.

    SSP wants every unit in base units: a connector of another unit has none.
    """
    connectors = ET.Element(f"{{{SSD}}}Connectors")
    units = set()
    for variable in description.iter("ScalarVariable"):
        kind, name = variable.get("causality", "local"), variable.get("name", "")
        if kind != "output" and name not in wired:
            continue
        connector = ET.SubElement(connectors, f"{{{SSD}}}Connector", name=name, kind=kind)
        declared = variable[0]
        kind_of_value = declared.tag.replace("Enumeration", "Integer")  # as FMI reads it; libcosim refuses the other
        own = ET.SubElement(connector, f"{{{SSC}}}{kind_of_value}")
        unit = declared.get("unit")
        if declared.tag == "Real" and unit is not None and base_unit(unit) is not None:
            own.set("unit", unit)
            units.add(unit)
    _append(component, connectors)
    return units


def _append(parent: ET.Element, items: ET.Element) -> None:
    """Append a list unless it is empty, which SSP does not admit."""
    if len(items) > 0:
        parent.append(items)


def _add_units(root: ET.Element, units: set[str]) -> None:
    definitions = ET.Element(f"{{{SSD}}}Units")
    for name in sorted(units):
        unit, base = ET.SubElement(definitions, f"{{{SSC}}}Unit", name=name), base_unit(name)
        assert base is not None  # as _add_connectors has seen
        ET.SubElement(unit, f"{{{SSC}}}BaseUnit", base.attributes)
    _append(root, definitions)
