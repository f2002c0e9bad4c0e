"""A unit's native side: where its C sources are, and what C text follows from its interface.

Standard library only: this module also runs while the package is being built.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from .model_description import ModelExchange
from .variables import Interface, Value, Variable

ADAPTER = Path(__file__).parent / "adapter"
ADAPTER_SOURCES = ("fmi2_adapter.c", "fmu_instance.c")
FROM_FILE = "start_values_file.c"
"""How prebuilt binaries find their start values; an FMU's own sources have them compiled in instead."""

GUID_SIZE = 64

_ROLES = {"parameter": "params", "input": "inputs", "output": "outputs", "local": "outputs"}


@dataclass(frozen=True)
class NativeUnit:
    """A unit written in C.

    `folder` holds `<stem>.h`, `<stem>.c`, `<stem>_fmu.c` and the `headers` that the unit shares with others, those of its
    FMI part ending with `_fmu.h`; `prefix` begins the names of its structs. The fields of the structs are named as the
    variables; consecutive variables NAME_1, NAME_2, ... are an array NAME. `twin` is the same unit in Python, whose
    construction refuses start values that contradict each other. `model_exchange` tells its structure for given start
    values, None for co-simulation only.
    """

    interface: Interface
    twin: Callable[[Mapping[str, Value]], object]
    folder: Path
    stem: str
    prefix: str
    model_exchange: Callable[[Mapping[str, Value]], ModelExchange] | None = None
    largest_model_exchange: ModelExchange | None = None
    headers: tuple[str, ...] = ()

    @property
    def core(self) -> dict[str, Path]:
        """The unit's source files by name that know nothing of FMI."""
        names = [f"{self.stem}.c", f"{self.stem}.h", *(name for name in self.headers if not name.endswith("_fmu.h"))]
        return {name: self.folder / name for name in names}

    @property
    def sources(self) -> dict[str, Path]:
        """Hand-written source files by name, the adapter's included, headers too."""
        own = [*self.core.values(), self.folder / f"{self.stem}_fmu.c"]
        own += [self.folder / name for name in self.headers if name.endswith("_fmu.h")]
        shared = [ADAPTER / name for name in (*ADAPTER_SOURCES, "fmu_instance.h", "fmu_names.h", "fmu_unit.h")]
        return {file.name: file for file in (*own, *shared)}

    @property
    def generated(self) -> dict[str, str]:
        """Texts of the generated headers by name."""
        return {f"{self.stem}_table.h": variable_table(self), "fmu_model.h": model_header(self.interface)}


def unit_files(unit: NativeUnit) -> dict[str, bytes]:
    """Return all files that a prebuilt binary of `unit` is made of, by name."""
    headers = sorted((ADAPTER / "fmi2").glob("*.h"))
    files = {f.name: f.read_bytes() for f in (*unit.sources.values(), ADAPTER / FROM_FILE, *headers)}
    return files | {name: text.encode() for name, text in unit.generated.items()}


def model_header(interface: Interface) -> str:
    """Return the header with the unit's name, with which FMI wants the functions of a source FMU to begin."""
    return f"""/* Generated: the name of this unit. A shared library has the plain names of FMI: compile it with
 * FMI2_OVERRIDE_FUNCTION_PREFIX (FMI 2.0.5, section 2.1.1).
 */
#ifndef FMU_MODEL_H
#define FMU_MODEL_H

#define MODEL_IDENTIFIER "{interface.name}"
#define FMU_PREFIX {interface.name}_
#if !defined FMI2_FUNCTION_PREFIX
#define FMI2_FUNCTION_PREFIX {interface.name}_
#endif

#endif
"""


def variable_table(unit: NativeUnit) -> str:
    """Return the header with the unit's table of variables, for its `<stem>_fmu.c`."""
    exchange = unit.largest_model_exchange
    index = {v.name: i for i, v in enumerate(unit.interface.variables)}
    arrays = _arrays(unit.interface)
    lines = [
        f"/* Generated from the interface of {unit.interface.name}: its variables, in the order of their references. */",
        "#include <float.h>",
        "",
        "static const fmu_variable VARIABLES[] = {",
        *(f"    {_entry(unit, v, arrays)}," for v in unit.interface.variables),
        "};",
        "",
        f"enum {{ VARIABLE_COUNT = {len(unit.interface.variables)} }};",
    ]
    if exchange is not None:
        for name, members in (("STATES", exchange.states), ("DERIVATIVES", exchange.derivatives)):
            numbers = ", ".join(str(index[m]) for m in members)
            lines.append(f"static const unsigned {name}[] = {{{numbers}}};")
        lines.append(f"typedef char few_states[{len(exchange.states)} <= FMU_MOST_STATES ? 1 : -1];")
    lines += _size_assertions(unit, arrays)
    lines += [
        f"typedef char small_inputs[sizeof({unit.prefix}_inputs) <= FMU_MOST_BYTES ? 1 : -1];",
        f"typedef char small_outputs[sizeof({unit.prefix}_outputs) <= FMU_MOST_BYTES ? 1 : -1];",
        "",
    ]
    return "\n".join(lines)


def _arrays(interface: Interface) -> dict[str, tuple[str, int]]:
    """Return (array, position) for each variable that is an entry of one: NAME_1, NAME_2 or NAME_11, NAME_12, ..."""
    groups: dict[str, list[str]] = {}
    for variable in interface.variables:
        match = re.fullmatch(r"(.+)_\d{1,2}", variable.name)
        if match and variable.type == "Real":
            groups.setdefault(match[1], []).append(variable.name)
    return {name: (stem, i) for stem, names in groups.items() if len(names) > 1 for i, name in enumerate(names)}


def _size_assertions(unit: NativeUnit, arrays: Mapping[str, tuple[str, int]]) -> list[str]:
    """Return a declaration per field that does not compile where the struct differs from the interface."""
    sizes: dict[tuple[str, str], list[str]] = {}
    for v in unit.interface.variables:
        field = arrays.get(v.name, (v.name, 0))[0]
        kind = "double" if v.type == "Real" else "int"
        sizes.setdefault((f"{unit.prefix}_{_ROLES[v.causality]}", field), []).append(kind)
    return [
        f"typedef char {struct}_{field}_fits[sizeof((({struct} *)0)->{field}) == {len(k)} * sizeof({k[0]}) ? 1 : -1];"
        for (struct, field), k in sizes.items()
    ]


def _entry(unit: NativeUnit, variable: Variable, arrays: Mapping[str, tuple[str, int]]) -> str:
    struct = f"{unit.prefix}_{_ROLES[variable.causality]}"
    field, position = arrays.get(variable.name, (variable.name, 0))
    offset = f"offsetof({struct}, {field})" + (f" + {position} * sizeof(double)" if position else "")
    kind = {"Real": "FMU_REAL", "Boolean": "FMU_BOOLEAN"}.get(variable.type, "FMU_INTEGER")
    if variable.calculated:
        role = "FMU_OUTPUT"
    elif variable.causality == "input":
        role = "FMU_INPUT"
    else:
        role = f"FMU_{variable.variability.upper()}"
    low, high = (_number(limit) for limit in _limits(variable))
    return f'{{"{variable.name}", {kind}, {role}, {int(variable.fault_on_non_finite)}, {offset}, {low}, {high}}}'


def _limits(variable: Variable) -> tuple[float, float]:
    return (0.0, 1.0) if variable.type == "Boolean" else variable.limits()


def _number(value: float) -> str:
    """Return the C literal, for no bound the largest number: INFINITY is no constant expression for every compiler."""
    if value in (float("inf"), float("-inf")):
        return "DBL_MAX" if value > 0 else "-DBL_MAX"
    return repr(float(value))


def struct_initializer(unit: NativeUnit, start: Mapping[str, Value]) -> str:
    """Return the C initializer of the unit's parameter struct with the start values."""
    arrays = _arrays(unit.interface)
    fields: dict[str, list[str]] = {}
    for v in unit.interface.of("parameter"):
        number = _number(float(start[v.name])) if v.type == "Real" else str(int(start[v.name]))
        fields.setdefault(arrays.get(v.name, (v.name, 0))[0], []).append(number)
    texts = {name: v[0] if len(v) == 1 else "{" + ", ".join(v) + "}" for name, v in fields.items()}
    return "{" + ", ".join(f".{name} = {text}" for name, text in texts.items()) + "}"


def start_value_source(interface: Interface, guid: str, start: Mapping[str, Value]) -> str:
    """Return the C source that has the GUID and the start values compiled in."""
    numbers = "\n".join(f"    {_number(_start(v, start))}, /* {v.name} */" for v in interface.variables)
    return f"""/* Generated: the GUID and the start values of this FMU, in the order of the value references. */
#include <stdio.h>
#include <string.h>

#include "fmu_unit.h"

static const double START[] = {{
{numbers}
}};

int fmu_load_start_values(const char *resource_location, char guid[FMU_GUID_SIZE], double *values, size_t count,
                          char *problem, size_t problem_size)
{{
    (void)resource_location;
    if (count != sizeof START / sizeof START[0]) {{
        snprintf(problem, problem_size, "the sources of this FMU do not belong together");
        return -1;
    }}
    memcpy(values, START, sizeof START);
    snprintf(guid, FMU_GUID_SIZE, "{guid}");
    return 0;
}}
"""


def start_value_file(interface: Interface, guid: str, start: Mapping[str, Value]) -> bytes:
    """Return the bytes of `resources/start_values.bin`: see `start_values_file.c`, which reads them."""
    numbers = [_start(v, start) for v in interface.variables]
    name = guid.encode("ascii")
    if len(name) >= GUID_SIZE:
        raise ValueError(f"a GUID must be shorter than {GUID_SIZE} characters, found {guid}")
    head = b"FMUstart" + struct.pack("<II", 1, len(numbers)) + name.ljust(GUID_SIZE, b"\0")
    return head + struct.pack(f"<{len(numbers)}d", *numbers)


def _start(variable: Variable, start: Mapping[str, Value]) -> float:
    return float(start.get(variable.name, 0.0))
