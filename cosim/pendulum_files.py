"""The names of the pendulum's FMUs, as `qube-ihc export` writes them."""

from __future__ import annotations

PENDULUM_FMUS = ("QubeServo2.fmu", "IhcController.fmu")
"""Plant and controller."""
