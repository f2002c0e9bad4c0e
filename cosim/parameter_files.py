"""Parameter sets of the plant in TOML files: a file's name can stand where the name of a set can.

    source = "identified from run.csv"
    back_emf = true
    m_p = 0.024

and so on, a key for each field of `QubeParameters`, in its unit; keys of fields with a default (`T_r`) may be missing.
"""

from __future__ import annotations

from dataclasses import MISSING, asdict, fields
from pathlib import Path
from typing import Any

from pydantic import ConfigDict, StrictBool, StrictFloat, StrictStr, create_model

from filing.files import write_file
from filing.origin import WRITTEN
from fmu_export.files import FilePath, is_file
from fmu_export.reading import read_toml
from plant_fmu.parameters import PARAMETER_SETS, ParameterSet, QubeParameters, parameter_set

from .errors import UserError
from .typed import checked

SUFFIX = ".toml"

_NUMBERS: dict[str, Any] = {
    f.name: (StrictFloat, ... if f.default is MISSING else f.default) for f in fields(QubeParameters)
}
_File = create_model(
    "_File", __config__=ConfigDict(extra="forbid"), source=(StrictStr, ...), back_emf=(StrictBool, ...), **_NUMBERS
)
"""What a file holds; the rules for the numbers are those of `QubeParameters`."""


def load(path: FilePath) -> ParameterSet:
    """Read a parameter set, named as the file without its suffix.

    Raises UserError that names the file and the key for a missing file, unknown or missing keys, values outside their
    rule.
    """
    path = Path(path)
    entries = checked(_File, read_toml(path, "parameter"), path).model_dump()
    source, back_emf = entries.pop("source"), entries.pop("back_emf")
    try:
        parameters = QubeParameters(**entries)
    except ValueError as error:
        raise UserError(f"{path}: {error}") from None
    return ParameterSet(path.stem, parameters, source, f"read from {path.name}", back_emf)


def save(path: FilePath, parameters: ParameterSet) -> None:
    """Write the numbers, the source and the back-EMF of a set; `load` reads them back to the last bit.

    The set's name and use are the file's. Raises UserError for a file that is not named *.toml.
    """
    import tomli_w  # noqa: PLC0415

    path = Path(path)
    if path.suffix != SUFFIX:
        raise UserError(f"a parameter set goes into a file named *{SUFFIX}, found {path}")
    entries = {"source": parameters.source, "back_emf": parameters.back_emf, **asdict(parameters.parameters)}
    write_file(path, f"# {WRITTEN}\n" + tomli_w.dumps(entries))


def named_set(name_or_file: str, folder: FilePath | None = None) -> ParameterSet:
    """Return the named set, or that of a file as `file_of` finds it; raises UserError where there is neither."""
    path = file_of(name_or_file, folder)
    if path is not None:
        return load(path)
    check_name(name_or_file)
    return parameter_set(name_or_file)


def file_of(name_or_file: str | None, folder: FilePath | None = None) -> Path | None:
    """Return the path where the name is that of a file (*.toml): in `folder` if it is there, else in the current one."""
    if name_or_file is None or not name_or_file.endswith(SUFFIX):
        return None
    beside = Path(folder or "") / name_or_file
    return beside if is_file(beside) else Path(name_or_file)


def check_name(name_or_file: str, entry: str = "parameter set") -> None:
    """Raise UserError for what is neither the name of a set nor of a file (*.toml); the file need not exist.

    `entry` is what the message calls it.
    """
    if not name_or_file.endswith(SUFFIX) and name_or_file not in PARAMETER_SETS:
        sets = ", ".join(PARAMETER_SETS)
        raise UserError(f"{entry} must be one of {sets} or a file *{SUFFIX}, found {name_or_file!r}")
