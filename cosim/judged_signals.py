"""What of a result is judged, at each row: errors with their set-points, controls, modes, as `evaluation` says."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterable, Sequence
from functools import lru_cache

import numpy as np

from fmu_export.files import FilePath
from ihc_fmu.arrays import QUIET
from ihc_fmu.pendulum.supervisor import Mode

from .errors import UserError
from .evaluation import ACTING, ErrorSignal, Evaluation, pendulum_evaluation
from .recording import Recording
from .typed import checked

Array = np.ndarray

STABILIZING = int(Mode.STABILIZING)
"""Value of the output `mode` of the pendulum's controller while the stabilizing law acts."""

MOST = math.sqrt(sys.float_info.max)
"""Magnitude of a signal whose square is finite."""


def wrapped(angle: Array) -> Array:
    """Return angles [rad] wrapped to (-pi, pi]."""
    turned = math.pi - angle
    if not (np.min(turned, initial=0.0) >= 0.0 and np.max(turned, initial=0.0) < 2.0 * math.pi):
        turned = turned % (2.0 * math.pi)  # which costs most of it, and leaves those in the range as they are
    return -(turned - math.pi)


def missing_signals(known: Iterable[str], evaluation: Evaluation | None = None) -> list[str]:
    """Return which signals the metrics need besides the `known` ones; without an evaluation the pendulum's."""
    there = dict.fromkeys(known)
    needed = (evaluation or pendulum_evaluation(there)).signals
    return [name for name in needed if name not in there]


def evaluation_in(result: Recording) -> Evaluation:
    """Return what a result is judged by: what its metadata keep, the pendulum's where they keep nothing."""
    if result.judged_by is not None:
        return result.judged_by
    kept = result.metadata.get("evaluation")
    return pendulum_evaluation(result.signals) if kept is None else _kept(json.dumps(kept, sort_keys=True))


@lru_cache(maxsize=64)
def _kept(text: str) -> Evaluation:
    return checked(Evaluation, json.loads(text), "the result's metadata: evaluation")


def check_judged(known: Iterable[str], evaluation: Evaluation | None, fmus: FilePath) -> None:
    """Raise UserError where a run with the `known` signals has nothing to judge, or lacks what the metrics need.

    `evaluation` None: the pendulum's; `fmus` is the folder of the FMUs, to be named.
    """
    if evaluation is not None and not evaluation.errors:
        raise UserError(
            "there is nothing to judge: the controller gets no signal of the plant; evaluate.errors names some"
        )
    missing = missing_signals(known, evaluation)
    if missing:
        raise UserError(
            f"the metrics need {', '.join(missing)}, which the FMUs in {fmus} do not have as outputs, or the scenario does "
            "not record; `export --outputs` can name them"
        )


def can_evaluate(result: Recording) -> bool:
    """Return whether `result` has the signals that its metrics need."""
    evaluation = evaluation_in(result)
    if not evaluation.errors or missing_signals(result.signals, evaluation):
        return False
    if evaluation.mode is None:
        return True
    mode = result[evaluation.mode.signal]
    return bool(np.all(np.isfinite(mode)) and np.array_equal(mode, np.rint(mode)))  # another's may be anything


@QUIET
def at_rest(result: Recording) -> bool:
    """Return whether no error and no control changes in a run, and each error is 0 but for rounding; needs a judged one."""
    evaluation = evaluation_in(result)
    if not can_evaluate(result):
        return False
    signals = [result[s.signal] for s in (*evaluation.errors, *evaluation.controls)]
    errors = [(error(result, e), given(result, e)) for e in evaluation.errors]
    return all(np.ptp(s) == 0.0 for s in signals) and all(np.all(np.abs(e) <= 1e-12 * np.abs(y)) for e, y in errors)


@QUIET
def overflow(result: Recording) -> list[str]:
    """Return in a sentence which judged signal or control first leaves the range of numbers; nothing where none does.

    Beyond MOST its square is infinite, and so are the metrics. Nothing either where the result cannot be evaluated.
    """
    if not can_evaluate(result):
        return []
    evaluation = evaluation_in(result)
    signals = [(e.signal, error(result, e)) for e in evaluation.errors]
    signals += [(c.signal, np.asarray(result[c.signal])) for c in evaluation.controls]
    rows = [(np.flatnonzero(~(np.abs(s) < MOST)), name) for name, s in signals]
    first = [(float(result.time[beyond[0]]), name) for beyond, name in rows if beyond.size]
    return [
        f"the numbers overflow: {name} is not finite, or beyond {MOST:.2g}, whose square is not, from {time:g} s on"
        for time, name in sorted(first)[:1]
    ]


def can_draw(result: Recording) -> bool:
    """Return whether a result that can be evaluated has what its pictures need besides: the pendulum's the norm."""
    evaluation = evaluation_in(result)
    return evaluation.kind != "pendulum" or evaluation.norm in result.signals


@QUIET
def error(result: Recording, signal: ErrorSignal) -> Array:
    """Return an error at each row: what the controller is given of a signal, less its set-point."""
    e, point = given(result, signal), set_point(result, signal)
    if point is not None:
        e = e - point
    return wrapped(e) if signal.wraps else e


def given(result: Recording, signal: ErrorSignal) -> Array:
    """Return a judged signal at each row, as the controller is given it."""
    return _converted(result[signal.signal], signal.factor, signal.offset)


def set_point(result: Recording, signal: ErrorSignal) -> Array | None:
    """Return an error's set-point at each row; None where it has none."""
    if signal.set_point is not None:
        return _converted(result[signal.set_point], signal.point_factor, signal.point_offset)
    return np.full(len(result.time), signal.constant) if signal.constant else None


def _converted(signal: Array, factor: float, offset: float) -> Array:
    plain = np.asarray(signal, dtype=float)
    return plain if factor == 1.0 and offset == 0.0 else factor * plain + offset


@QUIET
def error_norm(result: Recording, evaluation: Evaluation, group: Sequence[int]) -> Array:
    """Return |e| of a group of errors at each row, each over its scale where there are scales."""
    errors = [error(result, evaluation.errors[k]) for k in group]
    if evaluation.scales is not None:
        errors = [e / evaluation.scales[k] for k, e in zip(group, errors, strict=True)]
    if len(errors) == 1:
        return np.abs(errors[0])
    return np.hypot(*errors) if len(errors) == 2 else np.sqrt(sum(e**2 for e in errors))


def angle_norm(result: Recording) -> Array:
    """Return |q| [rad] of the pendulum at each row: of the true angles where the result has them, else of the measured."""
    evaluation = evaluation_in(result)
    check_angles(result, evaluation)
    return error_norm(result, evaluation, (0, 1))


def check_angles(result: Recording, evaluation: Evaluation) -> None:
    """Raise UserError for a result without a pair of the pendulum's angles."""
    if evaluation.kind != "pendulum" or any(e.signal not in result.signals for e in evaluation.errors):
        raise UserError("the result has neither plant.theta and plant.delta nor the encoders' angles")


def takeovers(mode: Array, stabilizing: int = STABILIZING) -> Array:
    """Return the rows at which the stabilizing law takes over, from the controller's output `mode` and its value then."""
    acts = mode == stabilizing
    rows = np.flatnonzero(acts[1:] & ~acts[:-1]) + 1
    return np.concatenate([[0], rows]) if len(acts) and acts[0] else rows


def kept_upright(result: Recording) -> bool:
    """Return whether the stabilizing law took over once and acts at the end; without such a mode, whether all is finite."""
    evaluation = evaluation_in(result)
    acts = None if evaluation.mode is None else evaluation.mode.value(ACTING)
    if evaluation.mode is None or acts is None:
        return all(bool(np.all(np.isfinite(result[name]))) for name in evaluation.signals)
    mode = result[evaluation.mode.signal]
    return takeovers(mode, acts).size == 1 and bool(mode[-1] == acts)
