"""The files that a plant of one's own begins with: a plant in Python, a system file, a scenario. They run as written."""

from __future__ import annotations

import keyword
import re
import sys
from importlib.util import find_spec
from pathlib import Path
from string import Template

from filing.files import staging
from filing.origin import WRITTEN
from fmu_export.errors import shown
from fmu_export.files import FilePath

from .errors import UserError
from .names import is_plain
from .system_file import LINE

TEMPLATES = Path(__file__).parent / "templates"
FILES = {"{name}.py": "plant.py.txt", "{name}.toml": "system.toml.txt", "{name}_run.toml": "scenario.toml.txt"}
"""What is written, and the template of each."""
LONGEST = 40


def new(name: str, folder: FilePath) -> list[Path]:
    """Write the files of the plant `name` to `folder` and return their paths.

    Raises UserError for a name that cannot be that of a Python module and of a C function, and where one of the files is
    there already, whoever wrote it.
    """
    _check_name(name)
    folder = Path(folder)
    paths = {folder / file.format(name=name): TEMPLATES / template for file, template in FILES.items()}
    for path in paths:
        if path.exists() or path.is_symlink():
            raise UserError(f"{path} exists and stays; choose another name or --output")
    words = {"name": name, "class_name": class_name(name), "written": WRITTEN, "line": LINE}
    with staging(folder) as place:
        for path, template in paths.items():
            text = Template(template.read_text(encoding="utf-8")).substitute(words)
            (place / path.name).write_text(text, encoding="utf-8", newline="\n")
    return list(paths)


def class_name(name: str) -> str:
    """Return the name of the Python class, which PythonFMU makes the model identifier: a_crane becomes ACrane."""
    return "".join(part[:1].upper() + part[1:] for part in name.split("_"))


def _is_installed(name: str) -> bool:
    """Return whether Python finds a module of that name, which it would take for the plant's, outside the current folder."""
    spec = find_spec(name)
    return spec is not None and spec.origin is not None and Path.cwd() not in Path(spec.origin).parents[:2]


def _check_name(name: str) -> None:
    """Raise UserError for a name that is no identifier, or that Python would take for another module."""
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name) or len(name) > LONGEST:
        raise UserError(
            f"the name must be at most {LONGEST} letters, digits and underscores, a letter first, found {shown(name)}"
        )
    taken = keyword.iskeyword(name) or name.lower() in sys.stdlib_module_names or name.lower() == "pythonfmu"
    if (
        taken
        or _is_installed(name)
        or not is_plain(name)
        or class_name(name) in ("Fmi2Slave", "Fmi2Causality", "Fmi2Variability", "Real")
    ):
        raise UserError(f"the name must not be one that Python has already, found {shown(name)}")
