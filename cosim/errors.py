"""What a run can end with: errors that are the user's to mend, failed runs, Ctrl-C.

Light to import: the command line knows these before it knows what it will do.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fmu_export.errors import UserError

if TYPE_CHECKING:
    from .results import Result


__all__ = ["Interrupted", "SimulationError", "UserError"]


class SimulationError(RuntimeError):
    """A run failed on the way; `result` holds everything recorded until then, `time` and `instance` say where."""

    def __init__(self, message: str, result: Result, time: float, instance: str) -> None:
        super().__init__(message)
        self.result, self.time, self.instance = result, time, instance


class Interrupted(KeyboardInterrupt):
    """Ctrl-C during a run; `result` holds everything recorded until then."""

    def __init__(self, result: Result) -> None:
        super().__init__("interrupted")
        self.result = result
