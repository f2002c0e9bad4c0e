"""Draw the pictures of docs/images that explain the law: `python docs/make_pictures.py`.

Both are of one double integrator with a linear controller, with what a user has at hand: `synthesize`, `Controller`,
`norm_of`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ihc_fmu import Controller, Design, System, norm_of, settling_time_bound, synthesize

IMAGES = Path(__file__).parent / "images"
COLOURS = {"LC": "tab:blue", "IHC": "tab:red"}
STEP, DURATION = 0.005, 9.0
"""Sample time and end of the runs [s]."""
START = (1.2, 0.0)


def design() -> Design:
    """Return the design of a double integrator whose linear controller has the poles -1 and -1."""
    body = System(
        A=[[0, 1], [0, 0]], B=[[0], [1]], K=[[-1, -2]], states=("position [m]", "velocity [m/s]"), name="body"
    )
    return synthesize(body)


def run(made: Design, law: str) -> tuple[np.ndarray, np.ndarray]:
    """Return times (k,) [s] and states (k, 2) of the double integrator under a law, exact under held commands."""
    controller = Controller(made, sample_time=STEP, law=law, a_min=0.001)
    states = [np.array(START)]
    for _ in range(round(DURATION / STEP)):
        x, (u,) = states[-1], controller(states[-1])
        states.append(np.array([x[0] + STEP * x[1] + STEP**2 / 2.0 * u, x[1] + STEP * u]))
    return STEP * np.arange(len(states)), np.array(states)


def homogeneous_law(made: Design) -> Figure:
    """Draw states and norm of both laws: the level sets of the norm, and how it falls."""
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    plane, falling = figure.subplots(1, 2)
    position, velocity = np.meshgrid(np.linspace(-1.4, 1.4, 141), np.linspace(-1.4, 1.4, 141))
    norms = np.array(
        [[norm_of(made, x) for x in zip(*row, strict=True)] for row in zip(position, velocity, strict=True)]
    )
    rings = plane.contour(position, velocity, norms, levels=[0.25, 0.5, 1.0], colors="0.6", linewidths=[1, 1, 2])
    plane.clabel(rings, fmt="r = %g", fontsize=8)
    for law, colour in COLOURS.items():
        time, states = run(made, law)
        plane.plot(*states.T, color=colour, label=law)
        falling.semilogy(time, [norm_of(made, x) for x in states], color=colour, label=law)
    bound = settling_time_bound(made, START)
    falling.axvline(bound, color="0.4", ls="--", lw=1)
    falling.text(bound, 1.2, "proven bound ", ha="right", va="center", fontsize=8, color="0.3")
    falling.set(ylim=(1e-3, 2.0), xlabel="time [s]", ylabel="homogeneous norm r", xlim=(0.0, DURATION))
    plane.set(xlabel="position [m]", ylabel="velocity [m/s]")
    _finish(plane, falling)
    return figure


def gains(made: Design, a_min: float = 0.3) -> Figure:
    """Draw the gains over r beside the linear controller's, between a_min and b_max."""
    figure = Figure(figsize=(6.0, 3.2), layout="constrained")
    axis = figure.subplots()
    r = np.geomspace(0.05, 3.0, 400)
    limited = np.clip(r, a_min, 1.0)
    for power, state, colour in ((2.0 * made.mu, "position", "tab:purple"), (made.mu, "velocity", "tab:green")):
        axis.loglog(r, r**-power, color=colour, ls=":", lw=1)
        axis.loglog(r, limited**-power, color=colour, label=f"of the {state}")
    for limit, name in ((a_min, "a_min"), (1.0, "b_max")):
        axis.axvline(limit, color="0.6", lw=1)
        axis.text(limit, 150.0, f" {name}", fontsize=8, color="0.3")
    axis.set(xlabel="homogeneous norm r", ylabel="gain over the LC's", ylim=(0.2, 300.0))
    _finish(axis)
    return figure


def _finish(*axes: Axes) -> None:
    for axis in axes:
        axis.grid(alpha=0.3, which="both")
        axis.legend(loc="lower left", fontsize=8)


def main() -> None:
    """Write the pictures."""
    made = design()
    for name, figure in (("homogeneous_law", homogeneous_law(made)), ("gains", gains(made))):
        figure.savefig(IMAGES / f"{name}.png", dpi=110, metadata={"Software": None})


if __name__ == "__main__":
    main()
