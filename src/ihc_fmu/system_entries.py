"""The entries of a system file, and the fields of `System` that they mean.

name = "crane"
A = [[0, 1, 0, 0], [0, -0.5, 2.4, 0], [0, 0, 0, 1], [0, -1.1, -27.0, -0.1]]
B = [[0], [1.0], [0], [2.2]]            # b = [...] for one input
K = [[-3.2, -4.1, 9.0, 0.6]]            # u = K x, k_lin = [...] for one input; or lqr = { Q = [...], R = [...] }
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from filing.origin import WRITTEN
from fmu_export.errors import UserError, shown
from fmu_export.variables import did_you_mean

from .arguments import as_names
from .arrays import Array, are_numbers, check_numbers, check_weights, is_row, matrix
from .observer_wish import ObserverWish
from .system_rules import DIRECT, EQUILIBRIUM

ALIASES = {"b": "B", "k_lin": "K"}
"""Names for one input, whose values are rows."""
VECTORS = ("resolutions", "deviations")
TEXTS = ("states", "inputs", "outputs", "set_points", "biases")
ENTRIES = (
    *("name", "A", "B", "b", "C", "K", "k_lin", "lqr", *TEXTS, "limits", *VECTORS),
    *("sample_time", "equilibrium", "bandwidth", "integral", "observer"),
)
"""Entries of a system file."""


def fields_of(data: object) -> tuple[dict[str, Any], dict[str, Array]]:
    """Return the fields that entries mean, and the weights Q and R of `lqr`, none without it.

    Raises UserError that names the entry, the rule and the value.
    """
    if not isinstance(data, Mapping):
        raise UserError(f"a system must be a table of entries, found {shown(data)}")
    for name in data:
        if name not in ENTRIES:
            raise UserError(f"a system has no entry {shown(name)}{did_you_mean(str(name), ENTRIES)}")
    for short, long in (*ALIASES.items(), ("lqr", "K"), ("lqr", "k_lin")):
        if short in data and long in data:
            raise UserError(f"a system has {short} or {long}, found both")
    for name, other in (("A", "A"), ("B", "b")):
        if name not in data and other not in data:
            raise UserError(f"a system must have {name}")
    fields = {ALIASES.get(name, name): read(name, data[name]) for name, read in _READERS.items() if name in data}
    fields |= _limits(data.get("limits")) | _equilibrium(data.get("equilibrium", {}))
    return fields, _weights(data["lqr"]) if "lqr" in data else {}


def called_as_given(message: str, data: Mapping[Any, Any]) -> str:
    """Return a message about a field by the name that the file has for it: k_lin for K, b for B."""
    name, blank, rest = message.partition(" ")
    short = {long: short for short, long in ALIASES.items() if short in data}.get(name, name)
    return f"{short}{blank}{rest}"


def entries_of(s: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entries that mean the fields of a system, in plain types; what is as by default is left out."""
    measured = s["measures_state"]
    entries: dict[str, Any] = {"name": s["name"], "A": s["A"].tolist(), "B": s["B"].tolist()}
    if not measured:
        entries["C"] = s["C"].tolist()
    if s["K"] is not None:
        entries["K"] = s["K"].tolist()
    kinds = ("states", "inputs") if measured else ("states", "inputs", "outputs")
    entries |= {kind: [str(q) for q in s[kind]] for kind in kinds}
    if np.isfinite(s["lower"]).any() or np.isfinite(s["upper"]).any():
        entries["limits"] = [[float(low), float(high)] for low, high in zip(s["lower"], s["upper"], strict=True)]
    entries |= {name: s[name].tolist() for name in VECTORS if s[name].any()}
    entries["sample_time"] = s["sample_time"]
    if any(s[name].any() for name in EQUILIBRIUM.values()):
        entries["equilibrium"] = {kind: s[EQUILIBRIUM[kind]].tolist() for kind in kinds}
    entries |= {name: list(s[name]) for name in ("set_points", "biases") if s[name]}
    if s["bandwidth"] is not None:
        entries["bandwidth"] = s["bandwidth"]
    if s["integral"] is not None:
        entries["integral"] = s["integral"] if isinstance(s["integral"], str) else s["integral"].tolist()
    if s["observer"] is not None:
        entries["observer"] = s["observer"].as_table()
    return entries


def toml_of(entries: Mapping[str, Any], comment: str = "") -> str:
    """Return entries as the text of a file, with the lines of a comment at its head."""
    import tomli_w  # noqa: PLC0415

    head = [f"# {line}".rstrip() for line in (WRITTEN, *comment.splitlines())]
    rows = {}
    for name in ("A", "B", "C", "K"):  # a row a line, which no writer of TOML does
        if name in entries:
            lines = ",\n".join(f"    [{', '.join(map(repr, row))}]" for row in entries[name])
            rows[name] = f"{name} = [\n{lines},\n]\n"
    rest = {name: value for name, value in entries.items() if name not in rows}
    text = tomli_w.dumps({"name": rest.pop("name")}) + "".join(rows.values()) + tomli_w.dumps(rest)
    return "\n".join(head) + "\n" + text


def _read_text(name: str, value: object) -> str:
    if not isinstance(value, str):
        raise UserError(f"{name} must be a text, found {shown(value)}")
    return value


def _read_rows(name: str, value: Any) -> Any:
    return check_numbers(name, value, 2)


def _read_row_or_rows(name: str, value: Any) -> Any:
    return check_numbers(name, value, 1 if is_row(value) else 2)


def _read_integral(name: str, value: Any) -> Any:
    if isinstance(value, str):
        return value
    return check_numbers(name, value, 1 if is_row(value) else 2, f'or "{DIRECT}"')


def _read_number(name: str, value: Any) -> float:
    return float(check_numbers(name, value, 0))


def _limits(value: Any) -> dict[str, Any]:
    """Return lower and upper from `limits`: per input a number for both sides, or [lower, upper]."""
    if value is None:
        return {}
    if not isinstance(value, list) or not all(
        are_numbers(entry, 0) or (are_numbers(entry, 1) and len(entry) == 2) for entry in value
    ):
        raise UserError(f"limits must be a number or [lower, upper] per input, found {shown(value)}")
    for entry in value:
        if not isinstance(entry, list) and not entry > 0.0:
            raise UserError(f"limits must be positive where one number is for both sides, found {entry:g}")
    pairs = [entry if isinstance(entry, list) else [-entry, entry] for entry in value]
    return {"lower": [low for low, _ in pairs], "upper": [high for _, high in pairs]}


def _equilibrium(value: Any) -> dict[str, Any]:
    if not isinstance(value, dict) or not set(value) <= set(EQUILIBRIUM):
        raise UserError(f"equilibrium must be a table of states, inputs, outputs, found {shown(value)}")
    return {EQUILIBRIUM[kind]: check_numbers(f"equilibrium.{kind}", entry, 1) for kind, entry in value.items()}


def _weights(value: Any) -> dict[str, Array]:
    if not isinstance(value, dict) or set(value) != {"Q", "R"}:
        raise UserError(f"lqr must be a table of Q and R, found {shown(value)}")
    weights = {name: check_weights(f"lqr.{name}", W) for name, W in value.items()}
    return {name: matrix(f"lqr.{name}", W, flat=True) for name, W in weights.items()}


_READERS: dict[str, Callable[[str, Any], Any]] = {
    "name": _read_text,
    **dict.fromkeys(("A", "C"), _read_rows),
    **dict.fromkeys(("B", "b", "K", "k_lin"), _read_row_or_rows),
    "integral": _read_integral,
    "observer": lambda _, value: ObserverWish.from_table(value),
    **dict.fromkeys(VECTORS, partial(check_numbers, levels=1)),
    **dict.fromkeys(TEXTS, as_names),
    **dict.fromkeys(("sample_time", "bandwidth"), _read_number),
}
"""How the entries of a file become fields of the same names, or those of ALIASES."""
