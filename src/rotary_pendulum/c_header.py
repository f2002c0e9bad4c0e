"""The equation of motion in C: a header that native units are made of, and what it has from Python.

Standard library only: this module also runs while the package is being built.
"""

from __future__ import annotations

from pathlib import Path

from .equation import FRICTION_SPEED

HEADER = Path(__file__).parent / "native" / "rotary_pendulum.h"
CONSTANTS = {"PENDULUM_FRICTION_SPEED": FRICTION_SPEED}
"""Of the generated header that a unit includes before."""
