"""How a run is made, and how it may end."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from .guards import Limits

Fall = Literal["swing-up", "stop"]
Ending = Literal["complete", "signal", "fault"]


@dataclass(frozen=True)
class Settings:
    """How a run is made.

    rate [Hz]; duration [s]; still [s] the device must rest before; sign_test: whether the signs are tested at low voltage
    before; on_fall: what follows when a balanced pendulum falls, the controller's own swing-up or the stop; real_time:
    whether to ask for real-time scheduling; stop_on_misses: whether too many missed periods end the run, or are a warning.
    """

    rate: float = 1000.0
    duration: float = 20.0
    still: float = 0.5
    sign_test: bool = True
    on_fall: Fall = "swing-up"
    real_time: bool = True
    stop_on_misses: bool = True
    limits: Limits = field(default_factory=Limits)

    @property
    def period(self) -> float:
        """The sample time [s]."""
        return 1.0 / self.rate


class Stopped(Exception):  # noqa: N818 - not an error where the user asked for it
    """The run ends here; `kind` as in HardwareRun.stop."""

    def __init__(self, reason: str, kind: Ending = "fault") -> None:
        super().__init__(reason)
        self.kind: Ending = kind
