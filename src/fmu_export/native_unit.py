"""A unit's native side: where its C sources are, and what C text follows from its interface.

Standard library only: this module also runs while the package is being built.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from pathlib import Path

from .errors import UserError, shown
from .model_description import ModelExchange
from .variables import LONGEST_NAME, Interface, Value, Variable

ADAPTER = Path(__file__).parent / "adapter"
ADAPTER_SOURCES = ("fmi2_adapter.c", "fmu_instance.c")
FROM_FILE = "start_values_file.c"
"""How prebuilt binaries find their start values; an FMU's own sources have them compiled in instead."""

GUID_SIZE = 64
_ROLES = {"parameter": "params", "input": "inputs", "output": "outputs", "local": "outputs"}


@dataclass(frozen=True)
class NativeUnit:
    """A unit written in C.

    `folder` holds `<stem>.h`, `<stem>.c` and `<stem>_fmu.c`; `common` are further files that it is made of, which others may
    share, as names in `folder` or as paths, those of its FMI part ending with `_fmu.h`. `prefix` begins the names of its
    structs. The fields of the structs are named as the variables; consecutive variables NAME_1, NAME_2, ... are an array
    NAME, and so are NAME_1_1, NAME_1_2, ... by rows. `twin` is the same unit in Python, whose construction refuses start
    values that contradict each other. `model_exchange` tells its structure for given start values, None for co-simulation
    only.

    An FMU shows all variables of `interface`, or some of them under other names (`Variable.slot`); `twin` and
    `model_exchange` always get the start values of all, and speak of them, by the names in `interface`.

    `<stem>.h` may include `<stem>_constants.h`, which is generated: the values of each enumeration as PREFIX_VARIABLE_ITEM,
    in capitals, and `constants` by their names in C, so that no number stands in both languages.
    """

    interface: Interface
    twin: Callable[[Mapping[str, Value]], object]
    folder: Path
    stem: str
    prefix: str
    model_exchange: Callable[[Mapping[str, Value]], ModelExchange] | None = None
    largest_model_exchange: ModelExchange | None = None
    common: tuple[str | Path, ...] = ()
    constants: Mapping[str, int | float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for variable in self.interface.variables:
            if not is_c_identifier(variable.name) or variable.slot:
                raise ValueError(f"variable name {variable.name!r} is not a C identifier")

    @cached_property
    def places(self) -> dict[str, tuple[str, int]]:
        """Field and position in it of each variable."""
        return _places(self.interface)

    @property
    def core(self) -> dict[str, bytes]:
        """The unit's files by name that know nothing of FMI."""
        name = f"{self.stem}_constants.h"
        own = {file.name: file.read_bytes() for file in self._paths if not _is_of_fmi(file)}
        return own | {name: self.generated[name].encode()}

    @property
    def _paths(self) -> list[Path]:
        names = (f"{self.stem}.c", f"{self.stem}_fmu.c", f"{self.stem}.h", *self.common)
        return [self.folder / name for name in names]

    @property
    def sources(self) -> dict[str, Path]:
        """Hand-written source files by name, the adapter's included, headers too."""
        shared = [ADAPTER / name for name in (*ADAPTER_SOURCES, "fmu_instance.h", "fmu_names.h", "fmu_unit.h")]
        return {file.name: file for file in (*self._paths, *shared)}

    @property
    def generated(self) -> dict[str, str]:
        """Texts of the generated headers by name."""
        return self.headers(self.interface.name)

    def headers(self, identifier: str) -> dict[str, str]:
        """Return the generated headers by name for sources whose functions begin with `identifier`."""
        return {
            f"{self.stem}_constants.h": constants_header(self),
            f"{self.stem}_table.h": variable_table(self),
            "fmu_model.h": model_header(identifier),
        }


def _is_of_fmi(file: Path) -> bool:
    return file.stem.endswith("_fmu")


def unit_files(unit: NativeUnit) -> dict[str, bytes]:
    """Return all files that a prebuilt binary of `unit` is made of, by name."""
    headers = sorted((ADAPTER / "fmi2").glob("*.h"))
    files = {f.name: f.read_bytes() for f in (*unit.sources.values(), ADAPTER / FROM_FILE, *headers)}
    return files | {name: text.encode() for name, text in unit.generated.items()}


def is_c_identifier(name: str) -> bool:
    """Return whether `name` can be the name of something in C; keywords count as such."""
    return re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name) is not None


def checked_identifier(name: str) -> str:
    """Return `name`; raise UserError where it cannot be an FMU's modelIdentifier."""
    if not is_c_identifier(name) or len(name) > LONGEST_NAME:
        raise UserError(
            f"an FMU's identifier must be letters, digits and underscores, without a digit at its beginning and at most "
            f"{LONGEST_NAME} of them, found {shown(name)}"
        )
    return name


def constants_header(unit: NativeUnit) -> str:
    """Return the header with the unit's constants and the values of its enumerations."""
    guard = f"{unit.stem}_constants_h".upper()
    lines = [
        f"/* Generated from the interface of {unit.interface.name}: what Python and C have in common. */",
        f"#ifndef {guard}",
        f"#define {guard}",
        "",
        *(_constant(name, value) for name, value in unit.constants.items()),
    ]
    for v in unit.interface.variables:
        if v.type == "Enumeration":
            names = [f"{unit.prefix}_{v.name}_{item}".upper() for item in v.items]
            values = ", ".join(f"{_checked(name)} = {i}" for i, name in enumerate(names, 1))
            lines.append(f"enum {{ {values} }}; /* {v.name} */")
    return "\n".join([*lines, "", "#endif", ""])


def _constant(name: str, value: float) -> str:
    _checked(name)
    if not math.isfinite(value) or (isinstance(value, int) and not -(2**31) < value < 2**31):
        raise ValueError(f"the constant {name} must be finite, or an integer of 32 bits, found {value}")
    return f"enum {{ {name} = {value} }};" if isinstance(value, int) else f"#define {name} {value!r}"


def _checked(name: str) -> str:
    if not is_c_identifier(name):
        raise ValueError(f"the name {name!r} of a constant is not a C identifier")
    return name


def model_header(identifier: str) -> str:
    """Return the header with the name with which FMI wants the functions of a source FMU to begin."""
    return f"""/* Generated: the name of this FMU. A shared library has the plain names of FMI: compile it with
 * FMI2_OVERRIDE_FUNCTION_PREFIX (FMI 2.0.5, section 2.1.1).
 */
#ifndef FMU_MODEL_H
#define FMU_MODEL_H

#define FMU_PREFIX {identifier}_
#if !defined FMI2_FUNCTION_PREFIX
#define FMI2_FUNCTION_PREFIX {identifier}_
#endif

#endif
"""


def variable_table(unit: NativeUnit) -> str:
    """Return the header with the unit's name and its table of variables, for its `<stem>_fmu.c`."""
    exchange = unit.largest_model_exchange
    index = {v.name: i for i, v in enumerate(unit.interface.variables)}
    lines = [
        f"/* Generated from the interface of {unit.interface.name}: its variables, in the order of their references. */",
        "#include <float.h>",
        "",
        f'#define UNIT_NAME "{unit.interface.name}"',
        "",
        "static const fmu_variable VARIABLES[] = {",
        *(f"    {_entry(unit, v)}," for v in unit.interface.variables),
        "};",
        "",
        f"enum {{ VARIABLE_COUNT = {len(unit.interface.variables)} }};",
        "",
        "/* The reference of each field's first variable. */",
        "enum {",
        *(f"    VR_{unit.places[name][0]} = {i}," for name, i in index.items() if unit.places[name][1] == 0),
        "};",
        "",
    ]
    if exchange is not None:
        for name, members in (("STATES", exchange.states), ("DERIVATIVES", exchange.derivatives)):
            numbers = ", ".join(str(index[m]) for m in members)
            lines.append(f"static const unsigned {name}[] = {{{numbers}}};")
        lines.append(f"typedef char few_states[{len(exchange.states)} <= FMU_MOST_STATES ? 1 : -1];")
    lines += _size_assertions(unit)
    lines += [
        f"typedef char small_inputs[sizeof({unit.prefix}_inputs) <= FMU_MOST_BYTES ? 1 : -1];",
        f"typedef char small_outputs[sizeof({unit.prefix}_outputs) <= FMU_MOST_BYTES ? 1 : -1];",
        "",
    ]
    return "\n".join(lines)


def _places(interface: Interface) -> dict[str, tuple[str, int]]:
    """Return (field, position in it) by variable: entries of an array are NAME_1, NAME_2, ... or NAME_1_1, NAME_1_2, ...

    Raises ValueError for entries that are not next to each other, in the order of their numbers and of one type.
    """
    groups: dict[str, list[tuple[int, Variable, list[int]]]] = {}
    for i, variable in enumerate(interface.variables):
        match = re.fullmatch(r"(.+?)((?:_\d+)+)", variable.name)
        if match:
            numbers = [int(number) for number in match[2].split("_")[1:]]
            groups.setdefault(match[1], []).append((i, variable, numbers))
    places = {v.name: (v.name, 0) for v in interface.variables}
    for name, entries in groups.items():
        if len(entries) == 1:
            continue
        for (i, a, before), (j, b, behind) in pairwise(entries):
            if j != i + 1 or not before < behind or len(before) != len(behind) or _kind(a) != _kind(b):
                raise ValueError(f"{a.name} and {b.name} must be neighbouring entries of one array {name}, by rows")
        places |= {v.name: (name, position) for position, (_, v, _) in enumerate(entries)}
    return places


def _kind(variable: Variable) -> tuple[str, str]:
    """Return the C type of a variable, and the end of the name of the struct that it is in."""
    return "double" if variable.type == "Real" else "int", _ROLES[variable.causality]


def _size_assertions(unit: NativeUnit) -> list[str]:
    """Return a declaration per field that does not compile where the struct differs from the interface."""
    sizes: dict[tuple[str, str], list[str]] = {}
    for v in unit.interface.variables:
        kind, role = _kind(v)
        sizes.setdefault((f"{unit.prefix}_{role}", unit.places[v.name][0]), []).append(kind)
    return [
        f"typedef char {struct}_{field}_fits[sizeof((({struct} *)0)->{field}) == {len(k)} * sizeof({k[0]}) ? 1 : -1];"
        for (struct, field), k in sizes.items()
    ]


def _entry(unit: NativeUnit, variable: Variable) -> str:
    c_type, struct_role = _kind(variable)
    struct = f"{unit.prefix}_{struct_role}"
    field, position = unit.places[variable.name]
    offset = f"offsetof({struct}, {field})" + (f" + {position} * sizeof({c_type})" if position else "")
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
    fields: dict[str, list[str]] = {}
    for v in unit.interface.of("parameter"):
        number = _number(float(start[v.name])) if v.type == "Real" else str(int(start[v.name]))
        fields.setdefault(unit.places[v.name][0], []).append(number)
    texts = {name: v[0] if len(v) == 1 else "{" + ", ".join(v) + "}" for name, v in fields.items()}
    return "{" + ", ".join(f".{name} = {text}" for name, text in texts.items()) + "}"


def start_value_source(table: Interface, guid: str, start: Mapping[str, Value], names: Mapping[str, str]) -> str:
    """Return the C source that has the GUID, the start values and the shown names compiled in.

    `start` and `names` are by the names of the compiled variables; those without a name are not shown.
    """
    numbers = "\n".join(f"    {_number(_start(v, start))}, /* {v.name} */" for v in table.variables)
    texts = "\n".join(f"    {_c_string(names[v.name]) if v.name in names else 'NULL'}," for v in table.variables)
    return f"""/* Generated: GUID, start values and names of this FMU's variables, in the order of the value references. */
#include <stdio.h>
#include <string.h>

#include "fmu_unit.h"

static const double START[] = {{
{numbers}
}};

/* NULL for what is not shown. */
static const char *const NAMES[] = {{
{texts}
}};

int fmu_load_start_values(const char *resource_location, fmu_start *start, size_t count, char *problem,
                          size_t problem_size)
{{
    (void)resource_location;
    if (count != sizeof START / sizeof START[0]) {{
        snprintf(problem, problem_size, "the sources of this FMU do not belong together");
        return -1;
    }}
    memcpy(start->values, START, sizeof START);
    memcpy(start->names, NAMES, sizeof NAMES);
    snprintf(start->guid, FMU_GUID_SIZE, {_c_string(guid)});
    return 0;
}}
"""


def _c_string(text: str) -> str:
    """Return the C literal of a text in UTF-8, itself in plain ASCII; octal escapes end where they must."""
    plain = (byte if 32 <= byte < 127 and chr(byte) not in '"\\?' else None for byte in text.encode())
    coded = zip(plain, text.encode(), strict=True)
    return '"' + "".join(chr(byte) if kept is not None else f"\\{byte:03o}" for kept, byte in coded) + '"'


def start_value_file(table: Interface, guid: str, start: Mapping[str, Value], names: Mapping[str, str]) -> bytes:
    """Return the bytes of `resources/start_values.bin`: see `start_values_file.c`, which reads them.

    `start` and `names` as in `start_value_source`.
    """
    numbers = [_start(v, start) for v in table.variables]
    identity = guid.encode("ascii")
    if len(identity) >= GUID_SIZE:
        raise ValueError(f"a GUID must be shorter than {GUID_SIZE} characters, found {guid}")
    texts = b"".join(names.get(v.name, "").encode() + b"\0" for v in table.variables)
    head = b"FMUstart" + struct.pack("<II", 2, len(numbers)) + identity.ljust(GUID_SIZE, b"\0")
    return head + struct.pack(f"<{len(numbers)}d", *numbers) + struct.pack("<I", len(texts)) + texts


def _start(variable: Variable, start: Mapping[str, Value]) -> float:
    return float(start.get(variable.name, 0.0))
