"""Section V of the paper from simulation: its experiments repeated with the FMUs, its claims judged, a report."""
