"""The controllers that are compared: the paper's, those that stand for its SMC, those beyond it, the sweep over a_min."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from ihc_fmu.pendulum.interface import vector
from ihc_fmu.pendulum.start_values import zip_names
from ihc_fmu.sliding_mode import SlidingMode, fitted_smc, linear_pole_smc

from . import printed
from .gains import K_LIN, A, B

PAPER_U_MAX = 10.0
"""Scale of P for the paper's IHC: |k x| <= 10 V on the unit ball, the voltage limit. The paper leaves it open."""

KALMAN = {"velocity_source": "kalman", "norm_solver": "exact", "discretization": "semi_implicit"}
"""The measurement chain and the law's details that let a_min be small."""


@dataclass(frozen=True)
class Variant:
    """A controller that is compared: its name, what it is, and the entries of the scenario that make it."""

    name: str
    about: str
    changes: Mapping[str, Any]


def controllers() -> tuple[Variant, ...]:
    """Return every controller that is run in the paper's conditions; the first four are in its tables.

    They name design files of the study; those of the tables the same one, so that they take over in the same region.
    """
    return (
        _variant("LC", "the manufacturer's linear controller", "paper.json", law="LC"),
        _variant(
            "IHC",
            f"the paper's numbers; P from eq. (11) with |k x| <= {PAPER_U_MAX:g} V on the unit ball",
            "paper.json",
            law="IHC",
            a_min=printed.A_MIN,
            b_max=printed.B_MAX,
            j_max=printed.J_MAX,
        ),
        _variant(
            "SMC1",
            "first-order SMC, poles -1.08, -12.6 ± 17i, kappa 19.3, rho 1.17 V: a fit to the printed SMC",
            "paper.json",
            **smc_start(fitted_smc(A, B)),
        ),
        _variant(
            "SMC2",
            "first-order SMC whose linear part is k_lin, rho 1 V",
            "paper.json",
            **smc_start(linear_pole_smc(A, B, K_LIN)),
        ),
        _variant("IHC 1.5 V", "the paper's numbers with |k x| <= 1.5 V on the unit ball", "default.json", law="IHC"),
        _variant("LC, KF", "LC with the Kalman filter", "default.json", law="LC", velocity_source="kalman"),
        _variant(
            "IHC, KF",
            "IHC 1.5 V, a_min 0.5, exact norm, semi-implicit, Kalman filter",
            "default.json",
            law="IHC",
            a_min=0.5,
            **KALMAN,
        ),
    )


def sweep_variants(a_mins: Iterable[float]) -> tuple[Variant, ...]:
    """Return the IHC at each a_min in three measurement chains, to see what lowering it brings and when it chatters."""
    chains: tuple[tuple[str, str, Mapping[str, Any]], ...] = (
        ("10 V, filter", "paper.json", {}),
        ("1.5 V, filter", "default.json", {}),
        ("1.5 V, Kalman filter", "default.json", KALMAN),
    )
    return tuple(
        _variant(sweep_name(chain, a_min), f"IHC {chain}", design, law="IHC", a_min=a_min, b_max=1.0, **start)
        for chain, design, start in chains
        for a_min in a_mins
    )


def sweep_name(chain: str, a_min: float) -> str:
    """Return the name of the IHC with `a_min` in a measurement chain."""
    return f"IHC {chain}, a_min {a_min:g}"


def _variant(name: str, about: str, design: str | None = None, **start: Any) -> Variant:
    changes = {f"controller.start.{entry}": value for entry, value in start.items()}
    return Variant(name, about, changes if design is None else {"controller.design": design, **changes})


def smc_start(smc: SlidingMode) -> dict[str, Any]:
    """Return the start values of the controller with a sliding mode design."""
    gains = {**zip_names(vector("smc_c"), smc.c), **zip_names(vector("smc_k"), smc.k_eq)}
    return {"law": "SMC", "smc_rho": smc.rho, **gains}
