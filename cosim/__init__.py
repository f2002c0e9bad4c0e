"""Co-simulation: FMUs of designs, scenarios that couple FMUs of anyone, results with their metrics and pictures.

`linear_model` finds a plant FMU's linear model; `export` makes the FMUs of a design; `run` and `compare` run a scenario,
which is a file or a `Scenario`; `simulate` couples FMUs that are listed in Python. What comes of a run is a `Result`.

    >>> import cosim, ihc_fmu
    >>> A, B, K = [[0, 1], [4, 0]], [[0], [1]], [[-8, -4]]
    >>> arm = ihc_fmu.System(A=A, B=B, K=K, states=("angle [rad]", "rate [rad/s]"), name="arm")
    >>> [path.name for path in cosim.export(ihc_fmu.synthesize(arm), "fmus")]
    ['arm_linear_plant.fmu', 'arm_controller.fmu', 'arm.ssp']
    >>> tilted = {"plant.start.angle_0": 0.1, "run.duration": 3.0}
    >>> result = cosim.run("fmus/arm.ssp", tilted)
    >>> bool(abs(result["plant.angle"][-1]) < 1e-4)
    True
    >>> compared = cosim.compare("fmus/arm.ssp", changes=tilted)
    >>> [round(compared.value(law, "settling_time[plant.angle]").value, 2) for law in ("LC", "IHC")]
    [2.92, 1.48]

The names load their modules when they are first used.
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .errors import UserError
    from .linearize import linear_model
    from .master import simulate
    from .metrics import Metrics, evaluate
    from .plant_model import LinearModel
    from .results import Interrupted, Result, SimulationError
    from .running import compare, export, run
    from .scenario import Scenario, load_scenario
    from .structure import Component, Signal, SystemStructure, Wire
    from .studies.comparison import Comparison

    __version__: str

__all__ = [
    "Comparison",
    "Component",
    "Interrupted",
    "LinearModel",
    "Metrics",
    "Result",
    "Scenario",
    "Signal",
    "SimulationError",
    "SystemStructure",
    "UserError",
    "Wire",
    "__version__",
    "compare",
    "evaluate",
    "export",
    "linear_model",
    "load_scenario",
    "run",
    "simulate",
]

_HOMES = {
    "cosim.studies.comparison": ("Comparison",),
    "cosim.errors": ("UserError",),
    "cosim.plant_model": ("LinearModel",),
    "cosim.linearize": ("linear_model",),
    "cosim.master": ("simulate",),
    "cosim.metrics": ("Metrics", "evaluate"),
    "cosim.results": ("Interrupted", "Result", "SimulationError"),
    "cosim.running": ("compare", "export", "run"),
    "cosim.scenario": ("Scenario", "load_scenario"),
    "cosim.structure": ("Component", "Signal", "SystemStructure", "Wire"),
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return version("qube-ihc")
    for module, names in _HOMES.items():
        if name in names:
            return getattr(import_module(module), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
