"""modelDescription.xml of FMI 2.0 (version 2.0.5 of the standard) from an interface table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree as ET

from .origin import ANONYMOUS, Origin
from .units import DISPLAY, base_unit
from .variables import Interface, Value, Variable


@dataclass(frozen=True, slots=True)
class ModelExchange:
    """What model exchange needs to know of a unit: its continuous states, and what depends on what.

    `states` and their `derivatives` are names of variables, in order. `dependencies` maps outputs and derivatives to the
    states and inputs that they depend on, `initial_dependencies` those of them that in initialization depend on more than
    in co-simulation to what that is.
    """

    states: tuple[str, ...]
    derivatives: tuple[str, ...]
    dependencies: Mapping[str, tuple[str, ...]]
    initial_dependencies: Mapping[str, tuple[str, ...]]


@dataclass(frozen=True, slots=True)
class Capabilities:
    """What of an FMU depends on how it is made.

    `identifier` is the modelIdentifier: the name of its binary, a C identifier.
    """

    identifier: str
    needs_execution_tool: bool
    generation_tool: str
    origin: Origin = ANONYMOUS
    sources: tuple[str, ...] = ()
    model_exchange: ModelExchange | None = None


def model_description(
    interface: Interface,
    start: Mapping[str, Value],
    guid: str,
    capabilities: Capabilities,
    references: Sequence[int] | None = None,
) -> bytes:
    """Return modelDescription.xml as UTF-8, the same bytes for the same arguments.

    `start` maps parameters and inputs to their start values. `references` are the value references of the variables; None:
    their positions.
    """
    origin = capabilities.origin
    said = {
        "author": origin.author,
        "version": origin.version,
        "license": origin.license,
        "generationTool": capabilities.generation_tool,
    }
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=interface.name,
        guid=guid,
        description=interface.description,
    )
    for name, text in said.items():
        if text:
            root.set(name, text)
    root.set("variableNamingConvention", "flat")
    root.set("numberOfEventIndicators", "0")
    _add_kinds(root, interface, capabilities)
    _add_units(root, interface)
    types = _add_types(root, interface)
    _add_log_categories(root)
    ET.SubElement(
        root,
        "DefaultExperiment",
        startTime="0",
        stopTime=repr(interface.stop_time),
        stepSize=repr(interface.default_step(start)),
    )
    variables = ET.SubElement(root, "ModelVariables")
    exchange = capabilities.model_exchange
    index = {v.name: i for i, v in enumerate(interface.variables, start=1)}
    for reference, variable in zip(references or range(len(index)), interface.variables, strict=True):
        scalar = _add_variable(variables, variable, reference, start.get(variable.name), types)
        if exchange is not None and variable.name in exchange.derivatives:
            state = exchange.states[exchange.derivatives.index(variable.name)]
            scalar[0].set("derivative", str(index[state]))
    _add_structure(root, interface, exchange)
    ET.indent(root)
    return ET.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"


def _add_kinds(root: ET.Element, interface: Interface, capabilities: Capabilities) -> None:
    """Add the elements ModelExchange, where the unit is for it, and CoSimulation."""
    common = {
        "modelIdentifier": capabilities.identifier,
        "needsExecutionTool": _boolean(capabilities.needs_execution_tool),
        "canBeInstantiatedOnlyOncePerProcess": "false",
        "canNotUseMemoryManagementFunctions": "true",
        "canGetAndSetFMUstate": "true",
        "canSerializeFMUstate": "true",
    }
    kinds = []
    if capabilities.model_exchange is not None:
        common["providesDirectionalDerivative"] = "true"
        kinds.append(ET.SubElement(root, "ModelExchange", common, completedIntegratorStepNotNeeded="true"))
    variable_step = _boolean(interface.variable_step)
    kinds.append(
        ET.SubElement(
            root,
            "CoSimulation",
            common,
            canHandleVariableCommunicationStepSize=variable_step,
            canInterpolateInputs="false",
        )
    )
    for kind in kinds:
        if capabilities.sources:
            files = ET.SubElement(kind, "SourceFiles")
            for name in capabilities.sources:
                ET.SubElement(files, "File", name=name)


def _boolean(value: bool) -> str:
    return "true" if value else "false"


def _literal(value: Value) -> str:
    return _boolean(value) if isinstance(value, bool) else repr(value)


def _add_units(root: ET.Element, interface: Interface) -> None:
    definitions = ET.SubElement(root, "UnitDefinitions")
    for name in sorted({v.unit for v in interface.variables if v.type == "Real"}):
        unit = ET.SubElement(definitions, "Unit", name=name)
        base = base_unit(name)
        if base is not None:
            ET.SubElement(unit, "BaseUnit", base.attributes)
        if name in DISPLAY:
            display, factor = DISPLAY[name]
            ET.SubElement(unit, "DisplayUnit", name=display, factor=repr(factor))


def _type_name(variable: Variable, interface: Interface) -> str:
    name = f"{variable.name}_type"
    while name in interface.by_name:
        name += "_"
    return name


def _add_types(root: ET.Element, interface: Interface) -> dict[str, str]:
    """Add the enumerations' types; return their names, which no variable has, by variable."""
    enumerations = [v for v in interface.variables if v.type == "Enumeration"]
    if not enumerations:
        return {}
    types = {v.name: _type_name(v, interface) for v in enumerations}
    definitions = ET.SubElement(root, "TypeDefinitions")
    for variable in enumerations:
        simple = ET.SubElement(definitions, "SimpleType", name=types[variable.name])
        enumeration = ET.SubElement(simple, "Enumeration")
        for value, item in enumerate(variable.items, start=1):
            ET.SubElement(enumeration, "Item", name=item, value=str(value))
    return types


def _add_log_categories(root: ET.Element) -> None:
    categories = ET.SubElement(root, "LogCategories")
    for name, description in (
        ("logStatusWarning", "what the unit wants known: faults, changes of mode under a fault"),
        ("logStatusError", "why a call failed, with time and inputs"),
        ("logAll", "everything else"),
    ):
        ET.SubElement(categories, "Category", name=name, description=description)


def _add_variable(
    parent: ET.Element, variable: Variable, reference: int, start: Value | None, types: Mapping[str, str]
) -> ET.Element:
    variability = variable.variability
    if variability == "continuous" and variable.type != "Real":
        variability = "discrete"
    scalar = ET.SubElement(
        parent,
        "ScalarVariable",
        name=variable.name,
        valueReference=str(reference),
        description=variable.description,
        causality=variable.causality,
        variability=variability,
    )
    if variable.calculated:
        scalar.set("initial", "calculated")
    elif variable.causality == "parameter":
        scalar.set("initial", "exact")
    kind = ET.SubElement(scalar, variable.type)
    if variable.type == "Enumeration":
        kind.set("declaredType", types[variable.name])
    if variable.type == "Real":
        kind.set("unit", variable.unit)
    for bound in ("min", "max"):
        limit = getattr(variable, bound)
        if limit is not None:
            kind.set(bound, repr(int(limit)) if variable.type == "Integer" else repr(limit))
    if start is not None:
        kind.set("start", _literal(start))
    return scalar


def _add_structure(root: ET.Element, interface: Interface, exchange: ModelExchange | None) -> None:
    """Add ModelStructure, with all that each unknown depends on, in a run and in initialization."""
    index = {v.name: i for i, v in enumerate(interface.variables, start=1)}
    outputs = {v.name: v.dependencies for v in interface.of("output")}
    initial = {v.name: v.initial_dependencies for v in interface.calculated}
    derivatives: tuple[str, ...] = ()
    states: tuple[str, ...] = ()
    if exchange is not None:
        outputs = {name: exchange.dependencies[name] for name in outputs}
        initial = {name: (*known, *exchange.initial_dependencies.get(name, ())) for name, known in initial.items()}
        derivatives, states = exchange.derivatives, exchange.states
    sections = {
        "Outputs": outputs,
        "Derivatives": {name: exchange.dependencies[name] for name in derivatives} if exchange else {},
        "InitialUnknowns": {
            name: initial[name] for name in sorted({*outputs, *derivatives, *states}, key=index.__getitem__)
        },
    }
    structure = ET.SubElement(root, "ModelStructure")
    for section, unknowns in sections.items():
        if not unknowns:
            continue
        parent = ET.SubElement(structure, section)
        for name, dependencies in unknowns.items():
            known = sorted({index[d] for d in dependencies})
            ET.SubElement(
                parent,
                "Unknown",
                index=str(index[name]),
                dependencies=" ".join(map(str, known)),
                dependenciesKind=" ".join("dependent" for _ in known),
            )
