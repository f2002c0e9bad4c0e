"""Where the equation of motion stands in C: a header that native units are made of.

Standard library only: this module also runs while the package is being built.
"""

from __future__ import annotations

from pathlib import Path

from .equation import FRICTION_SPEED

HEADER = Path(__file__).parent / "native" / "rotary_pendulum.h"

CONSTANTS = {"PENDULUM_FRICTION_SPEED": FRICTION_SPEED}
"""What a unit that includes it needs among its generated constants."""
