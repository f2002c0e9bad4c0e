"""A system of FMUs as one System Structure and Parameterization file (SSP 1.0): the FMUs and the wires between them."""

from __future__ import annotations

import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from xml.etree import ElementTree as ET

from .archive import write_zip
from .model_description import UNITS
from .ownership import SOFTWARE

SSD = "http://ssp-standard.org/SSP1/SystemStructureDescription"
SSC = "http://ssp-standard.org/SSP1/SystemStructureCommon"


def write_ssp(path: Path, name: str, components: Mapping[str, Path], wires: Iterable[tuple[str, str]]) -> Path:
    """Write the SSP `path` of the FMU files `components` by instance name and the `wires`; return `path`.

    A wire is (output, input), each as `instance.variable`. All outputs become connectors, and those inputs that a wire
    ends at; other inputs keep their start values. The same files give the same bytes.
    """
    ends = [(*a.split("."), *b.split(".")) for a, b in wires]
    ET.register_namespace("ssd", SSD)
    ET.register_namespace("ssc", SSC)
    root = ET.Element(f"{{{SSD}}}SystemStructureDescription", name=name, version="1.0", generationTool=SOFTWARE)
    system = ET.SubElement(root, f"{{{SSD}}}System", name=name)
    elements = ET.SubElement(system, f"{{{SSD}}}Elements")
    files: dict[str, bytes] = {}
    units: set[str] = set()
    for instance, fmu in components.items():
        source = f"resources/{fmu.name}"
        files[source] = fmu.read_bytes()
        component = ET.SubElement(
            elements, f"{{{SSD}}}Component", name=instance, type="application/x-fmu-sharedlibrary", source=source
        )
        wired = {variable for _, _, owner, variable in ends if owner == instance}
        units |= _add_connectors(component, fmu, wired)
    connections = ET.SubElement(system, f"{{{SSD}}}Connections")
    for a, x, b, y in ends:
        ET.SubElement(
            connections, f"{{{SSD}}}Connection", startElement=a, startConnector=x, endElement=b, endConnector=y
        )
    _add_units(root, units)
    ET.indent(root)
    files["SystemStructure.ssd"] = ET.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"
    write_zip(path, files)
    return path


def _add_connectors(component: ET.Element, fmu: Path, wired: set[str]) -> set[str]:
    """Add the FMU's outputs and wired inputs as connectors; return the units that they use."""
    with zipfile.ZipFile(fmu) as archive:
        description = ET.fromstring(archive.read("modelDescription.xml"))
    connectors = ET.SubElement(component, f"{{{SSD}}}Connectors")
    units = set()
    for variable in description.iter("ScalarVariable"):
        kind, name = variable.get("causality", "local"), variable.get("name", "")
        if kind != "output" and name not in wired:
            continue
        connector = ET.SubElement(connectors, f"{{{SSD}}}Connector", name=name, kind=kind)
        declared = variable[0]
        unit = declared.get("unit")
        if declared.tag == "Real" and unit is not None:
            ET.SubElement(connector, f"{{{SSC}}}Real", unit=unit)
            units.add(unit)
        else:  # an enumeration's items stay in its FMU
            ET.SubElement(connector, f"{{{SSC}}}{declared.tag.replace('Enumeration', 'Integer')}")
    return units


def _add_units(root: ET.Element, units: set[str]) -> None:
    definitions = ET.SubElement(root, f"{{{SSD}}}Units")
    for name in sorted(units):
        unit = ET.SubElement(definitions, f"{{{SSC}}}Unit", name=name)
        ET.SubElement(unit, f"{{{SSC}}}BaseUnit", {base: str(exponent) for base, exponent in UNITS[name].items()})
