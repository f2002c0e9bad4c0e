"""The implicit homogeneous controller: designs with their proof for linear models of any order, and the controller itself.

`System` holds a plant's linear model and the linear controller that works; `synthesize` makes the homogeneous controller of
it, a `Design` with its certificate; `Controller` is that controller as an object. `inverse_design` and `direct_design` take
all their `Options` from the user. The package `cosim` makes FMUs of a design and runs them.

    >>> from ihc_fmu import Controller, System, settling_time_bound, synthesize
    >>> A, B, K = [[0, 1], [4, 0]], [[0], [1]], [[-8, -4]]
    >>> arm = System(A=A, B=B, K=K, states=("angle [rad]", "rate [rad/s]"), name="arm")
    >>> design = synthesize(arm)
    >>> design.certificate.decrease > 0.0, design.mu
    (True, 1.0)
    >>> round(settling_time_bound(design, [0.1, 0.0]), 2)
    2.19
    >>> Controller(design)([0.1, 0.0]).shape
    (1,)

The names load their modules when they are first used: the units inside Python FMUs need the standard library only.
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fmu_export.errors import UserError

    from .certificate import Certificate, CertificateError, norm_of, settling_time_bound
    from .controller import Controller
    from .design import Design
    from .direct import direct_design
    from .inverse import inverse_design
    from .largest_rate import largest_alpha
    from .lmi import InfeasibleError
    from .options import Options
    from .quantity import Quantity
    from .residual import Residual, residual_set
    from .synthesis import Choice, chosen_options, synthesize
    from .system import System

    __version__: str

__all__ = [
    "Certificate",
    "CertificateError",
    "Choice",
    "Controller",
    "Design",
    "InfeasibleError",
    "Options",
    "Quantity",
    "Residual",
    "System",
    "UserError",
    "__version__",
    "chosen_options",
    "direct_design",
    "inverse_design",
    "largest_alpha",
    "norm_of",
    "residual_set",
    "settling_time_bound",
    "synthesize",
]

_HOMES = {
    "fmu_export.errors": ("UserError",),
    "ihc_fmu.certificate": ("Certificate", "CertificateError", "norm_of", "settling_time_bound"),
    "ihc_fmu.controller": ("Controller",),
    "ihc_fmu.design": ("Design",),
    "ihc_fmu.direct": ("direct_design",),
    "ihc_fmu.inverse": ("inverse_design",),
    "ihc_fmu.largest_rate": ("largest_alpha",),
    "ihc_fmu.lmi": ("InfeasibleError",),
    "ihc_fmu.options": ("Options",),
    "ihc_fmu.quantity": ("Quantity",),
    "ihc_fmu.residual": ("Residual", "residual_set"),
    "ihc_fmu.synthesis": ("Choice", "chosen_options", "synthesize"),
    "ihc_fmu.system": ("System",),
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
