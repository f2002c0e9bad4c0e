"""Where the C of the controllers is, the headers that both are built on, and the numbers in them that Python has.

Standard library only: this module also runs while the package is being built.
"""

from __future__ import annotations

from pathlib import Path

from . import homogeneity, laws, linear_algebra, sampled_unit

FOLDER = Path(__file__).parent / "native"
HEADERS = ("homogeneous.h", "sample_clock.h", "sample_clock_fmu.h")

CONSTANTS: dict[str, int | float] = {
    "MOST_SAMPLES": sampled_unit.MAX_SAMPLES,
    "MOST_BISECTIONS": homogeneity.MOST_BISECTIONS,
    "NEWTON_LIMIT": homogeneity.NEWTON_LIMIT,
    "REFINEMENTS": linear_algebra.REFINEMENTS,
    "FAR_APART": homogeneity.FAR,
    "SHIFT": homogeneity.SHIFT,
    "SMALL": 2.0**-homogeneity.SHIFT,
    "LARGE": 2.0**homogeneity.SHIFT,
    "LEAST": sampled_unit.LEAST,
    "LEAST_ESTIMATE": sampled_unit.LEAST_ESTIMATE,
    "LEAST_GUESS": homogeneity.GUESSES[0],
    "LARGEST_GUESS": homogeneity.GUESSES[1],
    "LEAST_ORDINARY": homogeneity.ORDINARY[0],
    "MOST_ORDINARY": homogeneity.ORDINARY[1],
    "NEGLIGIBLE": homogeneity.NEGLIGIBLE,
    "UNBOUNDED": homogeneity.UNBOUNDED,
    "CONVERGED": homogeneity.CONVERGED,
    "CANCELLED": linear_algebra.CANCELLED,
    "MOST_EXACT": linear_algebra.MOST_EXACT,
    "SPLIT": linear_algebra.SPLIT,
    "MOST": laws.MOST,
    "STA_PROPORTIONAL": laws.PROPORTIONAL,
    "STA_INTEGRAL": laws.INTEGRAL,
}
"""By their names in C; what each means is told where Python has it."""
