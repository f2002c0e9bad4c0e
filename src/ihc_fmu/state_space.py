"""What a `control.StateSpace`, or any object like it, says of a system."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fmu_export.errors import UserError

from .arrays import Array, reals

GAIN_CONVENTIONS = ("u = K x", "u = -K x")
"""How a gain may be meant."""
LABELS = {"states": "state_labels", "inputs": "input_labels", "outputs": "output_labels"}


def fields_of_model(model: Any, K: ArrayLike | None, law: str | None) -> dict[str, Any]:
    """Return the fields of `System` that a model in continuous time and its gain mean; raise UserError for another model.

    A C that is the unit matrix stands for measured states. `law` is how K is meant.
    """
    if not all(hasattr(model, name) for name in "ABCD"):
        raise UserError(f"the model must have A, B, C and D, found a {type(model).__name__}")
    if getattr(model, "dt", None) not in (None, 0):
        raise UserError(f"the model must be in continuous time, found dt = {model.dt}")
    _check_no_feedthrough(model)
    C = reals("C", model.C, "rows of numbers")
    given: dict[str, Any] = {"A": np.asarray(model.A), "B": np.asarray(model.B), "K": _gain(K, law)}
    if C.shape != np.shape(model.A) or not np.array_equal(C, np.eye(len(C))):
        given["C"] = C
    for name, label in LABELS.items():
        if getattr(model, label, None) and not (name == "outputs" and "C" not in given):
            given[name] = tuple(getattr(model, label))
    return given


def _check_no_feedthrough(model: Any) -> None:
    D = reals("D", model.D, "rows of numbers")
    for i, j in np.argwhere(D)[:1]:
        inputs, outputs = (getattr(model, LABELS[kind], None) for kind in ("inputs", "outputs"))
        u, y = inputs[j] if inputs else f"u{j + 1}", outputs[i] if outputs else f"y{i + 1}"
        raise UserError(f"the model must have D = 0, found {D[i, j]:g} from {u} to {y}")


def _gain(K: ArrayLike | None, law: str | None) -> Array | None:
    """Return the gain of u = K x, given one and how it is meant, "u = K x", also "u = +K x", or "u = -K x".

    Raises UserError where a gain comes without `law`: toolboxes differ, and a sign is not guessed.
    """
    if K is None:
        return None
    if law == "u = +K x":
        law = GAIN_CONVENTIONS[0]
    if law not in GAIN_CONVENTIONS:
        raise UserError(f"law must say how K is meant, {' or '.join(map(repr, GAIN_CONVENTIONS))}, found {law!r}")
    gain = reals("K", K, "rows of numbers")
    return gain if law == GAIN_CONVENTIONS[0] else -gain
