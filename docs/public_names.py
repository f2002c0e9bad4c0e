"""The public names of the packages, those of their `__all__`, for the pages that are made from the code."""

from __future__ import annotations

import inspect
from importlib import import_module
from typing import Any

PACKAGES = ("ihc_fmu", "cosim")
"""In the order in which they document what both have."""


def public(package: str) -> dict[str, Any]:
    """Return the package's public things by their names; raise TypeError where a module has taken the place of one."""
    module = import_module(package)
    found = {name: getattr(module, name) for name in getattr(module, "__all__", []) if not name.startswith("__")}
    for name, value in found.items():
        if inspect.ismodule(value):
            raise TypeError(f"{package}.{name} must be a public class or function, found the module {value.__name__}")
    return found


def listing(package: str) -> str:
    """Return a package's text and its names, as autodoc makes them in a page in Markdown."""
    kinds: dict[str, list[str]] = {"Classes": [], "Functions": [], "Errors": []}
    for name, value in public(package).items():
        kinds[_kind(value)].append(_entry(package, name, value))
    parts = [_made(f"automodule:: {package}\n   :no-members:")]
    for title, entries in kinds.items():
        if entries:
            parts += [f"## {title}\n", *entries]
    return "\n".join(parts)


def _entry(package: str, name: str, value: Any) -> str:
    home = next(known for known in PACKAGES if public(known).get(name) is value)
    directive = "autoclass" if inspect.isclass(value) else "autofunction"
    if home != package:
        role = directive.removeprefix("auto").removesuffix("tion")
        return _made(f"``{name}`` is :py:{role}:`{home}.{name}`.", "")
    return _made(f"{directive}:: {package}.{name}")


def _kind(value: object) -> str:
    if not inspect.isclass(value):
        return "Functions"
    return "Errors" if issubclass(value, BaseException) else "Classes"


def _made(text: str, mark: str = ".. ") -> str:
    return f"```{{eval-rst}}\n{mark}{text}\n```\n"
