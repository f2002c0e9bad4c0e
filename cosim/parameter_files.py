"""Parameter sets of the plant in TOML files: a file's name can stand where the name of a set can.

    source = "identified from run.csv"
    back_emf = true
    m_p = 0.024

and so on, a key for each field of `QubeParameters`, in its unit; keys of fields with a default (`T_r`) may be missing.
"""

from __future__ import annotations

import sys
from dataclasses import MISSING, asdict, fields
from pathlib import Path

from filing.files import write_file
from filing.origin import WRITTEN
from fmu_export.errors import shown
from fmu_export.files import FilePath, is_file
from fmu_export.reading import read_toml
from fmu_export.variables import did_you_mean
from plant_fmu.parameters import PARAMETER_SETS, ParameterSet, QubeParameters, parameter_set

from .errors import UserError

SUFFIX = ".toml"

_NUMBERS = {f.name: f.default is MISSING for f in fields(QubeParameters)}
"""The keys that hold numbers, and whether a file must have them."""


def load(path: FilePath) -> ParameterSet:
    """Read a parameter set, named as the file without its suffix.

    Raises UserError that names the file and the key for a missing file, unknown or missing keys, values outside their
    rule.
    """
    path = Path(path)
    data = read_toml(path, "parameter")
    known = {"source": True, "back_emf": True, **_NUMBERS}
    for key in data:
        if key not in known:
            raise UserError(f"{path}: there is no parameter {shown(key)}{did_you_mean(key, known)}")
    missing = [key for key, required in known.items() if required and key not in data]
    if missing:
        raise UserError(f"{path}: {', '.join(missing)} missing; a parameter file has {', '.join(known)}")
    if not isinstance(data["source"], str):
        raise UserError(f"{path}: source must be a text, found {shown(data['source'])}")
    if not isinstance(data["back_emf"], bool):
        raise UserError(f"{path}: back_emf must be true or false, found {shown(data['back_emf'])}")
    numbers = {key: _number(path, key, data[key]) for key in _NUMBERS if key in data}
    try:
        parameters = QubeParameters(**numbers)
    except ValueError as error:
        raise UserError(f"{path}: {error}") from None
    return ParameterSet(path.stem, parameters, data["source"], f"read from {path.name}", data["back_emf"])


def save(path: FilePath, chosen: ParameterSet) -> None:
    """Write the numbers, the source and the back-EMF of a set; `load` reads them back to the last bit.

    The set's name and use are the file's. Raises UserError for a file that is not named *.toml.
    """
    import tomli_w  # noqa: PLC0415

    path = Path(path)
    if path.suffix != SUFFIX:
        raise UserError(f"a parameter set goes into a file named *{SUFFIX}, found {path}")
    about = {"source": chosen.source, "back_emf": chosen.back_emf}
    write_file(path, f"# {WRITTEN}\n" + tomli_w.dumps({**about, **asdict(chosen.parameters)}))


def chosen(name_or_file: str, folder: FilePath | None = None) -> ParameterSet:
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


def _number(path: Path, key: str, value: object) -> float:
    large = isinstance(value, int) and abs(value) > sys.float_info.max
    if isinstance(value, bool) or not isinstance(value, int | float) or large:
        raise UserError(f"{path}: {key} must be a number, found {shown(value)}")
    return float(value)
