"""Who makes an FMU."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Origin:
    """What an FMU or an SSP says of those who made it; empty: nothing.

    `license` is the licence's name and `license_text` the file that travels inside. An export replaces only files that
    name the same `software`.
    """

    software: str = "fmu_export"
    version: str = ""
    author: str = ""
    license: str = ""
    license_text: bytes = b""

    @property
    def tool(self) -> str:
        """The software with its version."""
        return f"{self.software} {self.version}".rstrip()


ANONYMOUS = Origin()
