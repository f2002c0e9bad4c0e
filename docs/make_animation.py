"""Draw docs/images/swing_up.svg, the README's animation of a run of the IHC's FMUs: `python docs/make_animation.py`.

An SVG with keyframes in CSS: a few ten kB, sharp, light or dark as the reader has it. For readers who want no motion, and in
programs that show none, it is the end of the run.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

import cosim
from cosim import Result
from ihc_fmu.pendulum.default_design import default_design
from plant_fmu.parameters import parameter_set

Array = np.ndarray

PICTURE = Path(__file__).parent / "images" / "swing_up.svg"
CHANGES = {
    "run.duration": 4.0,
    "controller.start.velocity_source": "kalman",
    "controller.start.norm_solver": "exact",
    "controller.start.discretization": "semi_implicit",
    "controller.start.a_min": 0.5,
}
"""Of the scenario `swing_up`: the controller as in `tilt_kalman`, and 4 s."""
REST, RATE, EVERY = 1.0, 30, 5
"""How long the end is shown [s]; keyframes a second; rows to a point of a curve."""
AZIMUTH, ELEVATION = np.radians((28.0, 16.0))
"""Where it is looked from: from the arm at theta = 0 counter-clockwise, and above."""
SCALE = 850.0
"""Of the scene [1/m]."""
LEFT, RIGHT, TOP, HEIGHT, GAP = 390.0, 748.0, 40.0, 58.0, 12.0
"""Of the panels."""
BOTTOM = TOP + 3.0 * HEIGHT + 2.0 * GAP

STYLE = """
.card {fill: #f6f8fa; stroke: #d0d7de} .base {fill: #d0d7de} .axis {stroke: #57606a; stroke-width: 6}
.arm {stroke: #57606a; stroke-width: 7} .rod {stroke: #cf222e; stroke-width: 7} .joint, text {fill: #424a53}
.curve {stroke: #1a7f37; fill: none; stroke-width: 1.5} .level {stroke: #afb8c1; stroke-width: .5} .now {stroke: #cf222e}
.swing {fill: #ffd8a8; opacity: .5} .balance {fill: #aceebb; opacity: .5} .arm, .rod {stroke-linecap: round}
text {font: 12px system-ui, 'Segoe UI', Helvetica, Arial, sans-serif} .end {text-anchor: end} .middle {text-anchor: middle}
.moving {animation-timing-function: linear; animation-iteration-count: infinite}
@media (prefers-color-scheme: dark) {
.card {fill: #0d1117; stroke: #3d444d} .base {fill: #3d444d} .axis, .arm {stroke: #9198a1} .joint, text {fill: #d1d7e0}
.rod, .now {stroke: #ff7b72} .curve {stroke: #56d364} .level {stroke: #656c76}
.swing {fill: #9e6a03} .balance {fill: #238636}}
@media (prefers-reduced-motion: reduce) {.moving {animation: none}}
"""


def run() -> Result:
    """Return the run, by the FMUs that `qube-ihc export` writes."""
    with tempfile.TemporaryDirectory() as folder:
        cosim.export(default_design(), folder)
        return cosim.run("swing_up", CHANGES, folder)


def seen(theta: Array, delta: Array) -> tuple[Array, Array]:
    """Return where the ends of arm and pendulum are seen from the hub, each of shape (rows, 2), y downwards.

    The arm reaches to L_r (cos theta, sin theta, 0), from there the pendulum to L_p (sin delta sin theta, -sin delta cos
    theta, cos delta): with these signs the inertia of eq. (5) has -varpi/2 cos delta beside its diagonal.
    """
    p = parameter_set("ident").parameters
    arm = p.L_r * np.column_stack([np.cos(theta), np.sin(theta), np.zeros_like(theta)])
    rod = p.L_p * np.column_stack([np.sin(delta) * np.sin(theta), -np.sin(delta) * np.cos(theta), np.cos(delta)])
    right = np.array([-np.sin(AZIMUTH), np.cos(AZIMUTH), 0.0])
    up = np.array([-np.sin(ELEVATION) * np.cos(AZIMUTH), -np.sin(ELEVATION) * np.sin(AZIMUTH), np.cos(ELEVATION)])
    plane = SCALE * np.column_stack([right, -up])
    return arm @ plane, (arm + rod) @ plane


def picture(result: Result) -> str:
    """Return the animation of a result as SVG."""
    rows = np.linspace(0, len(result.time) - 1, round(RATE * result.time[-1]) + 1).round().astype(int)
    arm, rod = seen(result["plant.theta"][rows], result["plant.delta"][rows])
    passed = (RIGHT - LEFT) * result.time[rows] / result.time[-1]
    moves = {
        "arm": _turning(arm),
        "tip": [f"translate({x:.1f}px,{y:.1f}px)" for x, y in arm],
        "rod": _turning(rod - arm),
        "now": [f"translate({x:.1f}px,0px)" for x in passed],
    }
    period = result.time[-1] + REST
    shares = result.time[rows] / period
    motion = "".join(_motion(name, steps, shares, period) for name, steps in moves.items())
    last = {name: steps[-1].replace("px", "").replace("deg", "") for name, steps in moves.items()}
    return f"""<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 770 290" role="img" aria-labelledby="title">
<title id="title">A rotary pendulum swings up and balances; its angles and the voltage over {result.time[-1]:g} s</title>
<style>{STYLE}{motion}</style>
<rect class="card" x="0.5" y="0.5" width="769" height="289" rx="8"/>
<g transform="translate(150,145)">
<path class="base" d="M-58 22v106h116v-106z"/><ellipse class="base" rx="58" ry="16" cy="22"/><path class="axis" d="M0 22V0"/>
<line class="arm moving" id="arm" x2="100" transform="{last["arm"]}"/>
<g class="moving" id="tip" transform="{last["tip"]}"><line class="rod moving" id="rod" x2="100" transform="{last["rod"]}"/>
<circle class="joint" r="5"/></g></g>
{_panels(result)}
<g class="moving" id="now" transform="{last["now"]}"><path class="now" d="M{LEFT:g} {TOP:g}V{BOTTOM:g}"/></g>
</svg>
"""


def _turning(vectors: Array) -> list[str]:
    """Return what lays a line of length 100 along each vector; the angle goes on over full turns."""
    angles = np.degrees(np.unwrap(np.arctan2(vectors[:, 1], vectors[:, 0])))
    sizes = np.hypot(*vectors.T) / 100.0
    return [f"rotate({angle:.1f}deg) scale({size:.3f},1)" for angle, size in zip(angles, sizes, strict=True)]


def _motion(name: str, steps: Sequence[str], shares: Iterable[float], period: float) -> str:
    """Return the style of a part that moves; its last step stays to the end of the period [s]."""
    frames = "".join(f"{100.0 * share:.2f}%{{transform:{step}}}" for share, step in zip(shares, steps, strict=True))
    return (
        f"#{name} {{animation-name: {name}; animation-duration: {period:g}s}}\n"
        f"@keyframes {name} {{{frames}to{{transform:{steps[-1]}}}}}\n"
    )


def _panels(result: Result) -> str:
    """Return cos delta, theta and the voltage over time, one below the other, before swing-up and balance."""
    end = float(result.time[-1])
    caught = LEFT + (RIGHT - LEFT) * cosim.evaluate(result).capture_time / end
    parts = [
        f'<text x="{LEFT:g}" y="{TOP - 8:g}">swing-up</text><text x="{caught + 5:.1f}" y="{TOP - 8:g}">balance</text>',
        f'<text class="end" x="{RIGHT:g}" y="{BOTTOM + 30:g}">time [s]</text>',
    ]
    for second in range(int(end) + 1):
        x = LEFT + (RIGHT - LEFT) * second / end
        parts.append(f'<text class="middle" x="{x:g}" y="{BOTTOM + 16:g}">{second}</text>')
    signals = (
        ("cos δ", np.cos(result["plant.delta"]), (-1, 1)),
        ("arm θ [rad]", result["plant.theta"], (-1, 2)),
        ("voltage [V]", result["controller.voltage"], (-10, 10)),
    )
    for row, (name, values, (low, high)) in enumerate(signals):
        top = TOP + row * (HEIGHT + GAP)
        x = LEFT + (RIGHT - LEFT) * result.time / end
        y = top + HEIGHT * (high - values) / (high - low)
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x[::EVERY], y[::EVERY], strict=True))
        for kind, left, right in (("swing", LEFT, caught), ("balance", caught, RIGHT)):
            parts.append(
                f'<rect class="{kind}" x="{left:.1f}" y="{top:g}" width="{right - left:.1f}" height="{HEIGHT:g}"/>'
            )
        zero = top + HEIGHT * high / (high - low)
        parts.append(
            f'<path class="level" d="M{LEFT:g} {zero:.1f}H{RIGHT:g}"/><polyline class="curve" points="{points}"/>'
        )
        parts.append(f'<text class="end" x="{LEFT - 30:g}" y="{top + HEIGHT / 2 + 4:g}">{name}</text>')
        for level, at in ((high, top + 9), (low, top + HEIGHT)):
            parts.append(f'<text class="end" x="{LEFT - 5:g}" y="{at:g}">{level}</text>')
    return "\n".join(parts)


if __name__ == "__main__":
    PICTURE.write_text(picture(run()), encoding="utf-8")
