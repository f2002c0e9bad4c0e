"""The default design, solved once and shipped as data: the solver's last digits depend on the processor.

    python -m ihc_fmu.pendulum.default_design

solves it anew and writes `default_design.json` beside this file.
"""

from __future__ import annotations

from pathlib import Path

from ..design import Design
from ..inverse import inverse_design
from ..options import Options
from .paper_system import paper_system

FILE = Path(__file__).with_name("default_design.json")


def solved() -> Design:
    """Return the IHC for the paper's A, b and k_lin: mu = 1, alpha = 0.2 1/s, |k x| <= 1.5 V on the unit ball."""
    return inverse_design(paper_system(), Options())


def default_design() -> Design:
    """Return the shipped design of `solved`; its certificate is computed anew."""
    return Design.load(FILE)


if __name__ == "__main__":
    solved().save(FILE)
    print(f"wrote {FILE}")
