"""Physical parameters of the QUBE-Servo 2 rotary pendulum: every number with its unit and its source."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from typing import Any

from fmu_export.errors import UserError
from rotary_pendulum.equation import Coefficients, is_regular, lumped

SMALLEST, LARGEST = 1e-12, 1e12
"""Limits of the constants in SI units: products of a few neither vanish nor leave the range of numbers."""

PAPER = "Cruz-Ortiz et al., section V"
RODS = "uniform rod about its centre, J = m L^2 / 12"


def _number(unit: str, description: str, source: str, *, positive: bool = True, default: Any = MISSING) -> float:
    metadata = {"unit": unit, "description": description, "source": source, "positive": positive}
    return field(default=default, metadata=metadata)


@dataclass(frozen=True, slots=True, kw_only=True)
class QubeParameters:
    """The constants of eq. (5) and of the motor, tau = k_m (V - k_m theta') / R_m.

    Raises UserError where a value is not finite, or an inertia, mass, length or electrical constant is not positive,
    or a damping or friction is negative, or one beyond SMALLEST or LARGEST; and where the inertia matrix is so nearly
    singular that its determinant is lost in rounding.
    """

    m_p: float = _number("kg", "mass of the pendulum", PAPER)
    L_p: float = _number("m", "length of the pendulum", PAPER)
    J_p: float = _number("kg.m2", "inertia of the pendulum about its centre of mass", RODS)
    D_p: float = _number("N.m.s/rad", "viscous damping of the pendulum joint", "see the set", positive=False)
    L_r: float = _number("m", "length of the rotary arm", PAPER)
    J_r: float = _number("kg.m2", "inertia of the rotary arm about the motor axis", "see the set")
    D_r: float = _number("N.m.s/rad", "viscous damping of the rotary arm", "see the set", positive=False)
    T_r: float = _number(
        "N.m", "dry (Coulomb) friction torque of the rotary arm", "see the set", positive=False, default=0.0
    )
    g_p: float = _number("m/s2", "gravitational acceleration", PAPER)
    R_m: float = _number("Ohm", "terminal resistance of the motor", PAPER)
    k_m: float = _number("V.s/rad", "electromotive force constant (equal to the torque constant, N.m/A)", PAPER)
    L_m: float = _number("H", "rotor inductance of the motor", PAPER)

    def __post_init__(self) -> None:
        for entry in fields(self):
            value = getattr(self, entry.name)
            rule = "positive" if entry.metadata["positive"] else "non-negative"
            if not math.isfinite(value) or value < 0 or (value == 0 and rule == "positive"):
                raise UserError(f"{entry.name} must be finite and {rule}, found {value} {entry.metadata['unit']}")
            low, high = limits(entry.metadata)
            if not low <= value <= high:
                raise UserError(f"{entry.name} must lie in [{low:g}, {high:g}] {entry.metadata['unit']}, found {value}")
        self._check_inertia()

    @property
    def coefficients(self) -> Coefficients:
        """The coefficients of eq. (5)."""
        return lumped(
            m_p=self.m_p,
            L_p=self.L_p,
            J_p=self.J_p,
            D_p=self.D_p,
            L_r=self.L_r,
            J_r=self.J_r,
            D_r=self.D_r,
            T_r=self.T_r,
            g_p=self.g_p,
        )

    def _check_inertia(self) -> None:
        if not is_regular(self.coefficients):
            raise UserError(
                f"J_p and J_r must not vanish beside the pendulum's mass, found J_p = {self.J_p:g} kg.m2, J_r = "
                f"{self.J_r:g} kg.m2 and m_p = {self.m_p:g} kg"
            )


def limits(metadata: Mapping[str, Any]) -> tuple[float, float]:
    """Return the smallest and the largest value of a constant, from its field's metadata."""
    return (SMALLEST if metadata["positive"] else 0.0), LARGEST


@dataclass(frozen=True, slots=True)
class ParameterSet:
    """A named set: its numbers, where they come from, what they are for, and whether its motor has back-EMF."""

    name: str
    parameters: QubeParameters
    source: str
    use: str
    back_emf: bool = True


_m_p, _L_p, _L_r = 0.024, 0.129, 0.085
_matrices = QubeParameters(
    m_p=_m_p,
    L_p=_L_p,
    J_p=_m_p * _L_p**2 / 12,
    D_p=0.0,
    L_r=_L_r,
    J_r=0.095 * _L_r**2 / 12,  # an arm of 0.095 kg about its own centre
    D_r=1.05e-6,
    g_p=9.81,
    R_m=8.4,
    k_m=0.042,
    L_m=1.16e-3,
)

PARAMETER_SETS: dict[str, ParameterSet] = {
    entry.name: entry
    for entry in (
        ParameterSet(
            "matrices",
            _matrices,
            "inertias of uniform rods; damping chosen so that eq. (6) gives the printed A and b (Cruz-Ortiz et al., "
            "section V), which hold without back-EMF",
            "reproduces the paper's A and b",
            back_emf=False,
        ),
        ParameterSet(
            "ident",
            replace(_matrices, D_p=5e-5, D_r=2.7e-4),
            "inertias of uniform rods; damping from a published identification of a QUBE-Servo 2",
            "the default plant: what a real device does",
        ),
        ParameterSet(
            "hcs",
            replace(_matrices, J_r=0.095 * _L_r**2 / 3 - _m_p * _L_r**2, D_p=5e-5, D_r=1e-3),
            "demonstration of the authors' Homogeneous Control Systems Toolbox for MATLAB",
            "comparison with the authors' own software",
        ),
        ParameterSet(
            "listed",
            replace(_matrices, J_p=3.3e-5, J_r=5.7e-5, D_p=0.0015, D_r=0.0005),
            "Cruz-Ortiz et al., section V, as printed",
            "shows that the printed damping cannot be: the manufacturer's controller is unstable with it",
        ),
        ParameterSet(
            "swapped",
            replace(_matrices, J_p=3.3e-5, J_r=5.7e-5, D_p=0.0005, D_r=0.0015),
            "Cruz-Ortiz et al., section V, with the two damping coefficients exchanged, as the manufacturer has them",
            "the printed numbers, repaired; heavily damped",
        ),
    )
}


def parameter_set(name: str | ParameterSet) -> ParameterSet:
    """Return the named set, and a set as it is; raise UserError that lists the names for another name."""
    if isinstance(name, ParameterSet):
        return name
    try:
        return PARAMETER_SETS[name]
    except KeyError:
        raise UserError(f"parameter set must be one of {', '.join(PARAMETER_SETS)}, found {name!r}") from None
