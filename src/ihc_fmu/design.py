"""A certified implicit homogeneous controller for any (A, B): its numbers, its proof, its file."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from filing.files import write_file
from fmu_export.errors import UserError, shown
from fmu_export.reading import parse_json, read_text

from .block_form import BlockForm
from .certificate import Certificate, CertificateError, certify
from .integral import IntegralAction, integral_action
from .system import LARGEST, PENDULUM, QUIET, System, from_dict

Array = np.ndarray

FORMAT = "qube-ihc design 2"
FORMAT_1 = "qube-ihc design 1"
ORDER_1 = 4
"""Of designs for one input without names, which are read too; those of the order of the pendulum were for it."""


@dataclass(frozen=True, eq=False)
class Design:
    """A certified implicit homogeneous controller for x' = A x + B u; it cannot be made without its certificate.

    system: (A, B), the linear controller u = K x that the IHC equals on ||x||_d = 1, names, units, limits.
    P (n, n): its ellipsoid x' P x <= 1 is the unit ball of ||x||_d. mu in (0, 1]: minus the degree of homogeneity.
    alpha [1/s]: proven decrease d||x||_d/dt <= -alpha ||x||_d^(1-mu).
    psi, d_max [units of u], tau: the terms of Remark 3 that the proof includes (0: none). method: how it was designed.
    """

    system: System
    P: Array
    mu: float
    alpha: float
    psi: float = 0.0
    d_max: float = 0.0
    tau: float = 1.0
    method: str = "given"
    form: BlockForm = field(init=False)
    certificate: Certificate = field(init=False)
    integral: IntegralAction | None = field(init=False)

    @QUIET
    def __post_init__(self) -> None:
        n = self.system.n
        if self.system.K is None:
            raise UserError("a design needs a system with a gain K")
        P = np.array(self.P, dtype=float)
        if P.shape != (n, n):
            raise UserError(f"P must be of shape {(n, n)} to fit A, found shape {P.shape}")
        if not np.isfinite(P).all():
            raise UserError(f"P must be finite, found {P[~np.isfinite(P)][0]}")
        check_scalars(self.mu, self.alpha, self.psi, self.d_max, self.tau)
        P.setflags(write=False)  # what is certified stays as it is
        object.__setattr__(self, "P", P)
        object.__setattr__(self, "form", _near_one(self.system.form, P))
        object.__setattr__(self, "certificate", certify(self))
        object.__setattr__(self, "integral", integral_action(self))

    @property
    def n(self) -> int:
        """The order of the system."""
        return self.system.n

    @property
    def A(self) -> Array:
        """The system's A (n, n)."""
        return self.system.A

    @property
    def B(self) -> Array:
        """The system's B (n, m)."""
        return self.system.B

    @property
    def b(self) -> Array:
        """The only column of B, shape (n,); UserError for several inputs."""
        return self.system.b

    @property
    def K(self) -> Array:
        """The gain of the linear controller u = K x, shape (m, n)."""
        assert self.system.K is not None
        return self.system.K

    @property
    def k_lin(self) -> Array:
        """The only row of K, shape (n,); UserError for several inputs."""
        self.system.b  # noqa: B018 - refuses
        return self.K[0]

    @cached_property
    def K_h(self) -> Array:
        """The homogeneous gain K - K_0, eq. (10), shape (m, n)."""
        return self.K - self.form.K_0

    @property
    def u_max(self) -> Array:
        """The largest |(K - K_0) x| of each input on the unit ball, shape (m,)."""
        return np.sqrt(np.einsum("ij,ji->i", self.K_h, np.linalg.solve(self.P, self.K_h.T)))

    @property
    def extent(self) -> Array:
        """The largest |x_i| on the unit ball, sqrt((P^-1)_ii), shape (n,)."""
        return np.sqrt(np.diag(np.linalg.inv(self.P)))

    def scaled_to(
        self, *, u_max: float | Sequence[float] | None = None, index: int | None = None, bound: float | None = None
    ) -> Design:
        """Return the design with P scaled by an explicit rule, which leaves (11) untouched.

        Either the largest |(K - K_0) x| on the unit ball becomes `u_max`, a number or one for each input of which the
        first is reached, or the largest |x_index| there becomes `bound`. Raises UserError where not exactly one rule is
        given.
        """
        if (u_max is None) == (bound is None or index is None):
            raise UserError("the scale of P needs one rule: u_max, or index and bound")
        if index is not None and not 0 <= index < self.n:
            raise UserError(f"the bounded state must be one of 0..{self.n - 1}, found {index}")
        size = np.atleast_1d(np.asarray(bound if u_max is None else u_max, dtype=float))
        if not ((size > 0.0) & (size < np.inf)).all() or size.shape not in ((1,), (self.system.m,)):
            raise UserError(
                f"the bound on the unit ball must be positive and finite, found {bound if u_max is None else u_max}"
            )
        if self.psi or self.d_max:
            raise UserError("a design with the terms of Remark 3 cannot be rescaled: psi and d_max fix the scale of P")
        factor = float(((self.u_max if index is None else self.extent[index]) / size).max())
        return replace(self, P=self.P * factor**2)

    def to_json(self) -> str:
        """Return the design with its derived numbers and certificate as JSON; floats are exact."""
        given = {name: getattr(self, name) for name in _SCALARS}
        derived = {
            "K_0": self.form.K_0.tolist(),
            "T": self.form.T.tolist(),
            "blocks": list(self.form.sizes),
            "u_max": self.u_max.tolist(),
            "certificate": self.certificate.as_dict(),
        }
        if self.integral is not None:
            derived |= {"K_i": self.integral.K_i.tolist(), "Gamma": self.integral.Gamma.tolist()}
        data = {"format": FORMAT, "system": self.system.as_dict(), "P": self.P.tolist(), **given, "derived": derived}
        return json.dumps(data, indent=1) + "\n"

    def save(self, path: Path) -> None:
        """Write the JSON to `path`, whole or not at all; raises UserError where it cannot be written."""
        write_file(path, self.to_json())

    @classmethod
    def from_json(cls, text: str) -> Design:
        """Return the design of `to_json`; the derived numbers are computed anew and the certificate is checked.

        Raises UserError for text that is not a design, and CertificateError for one that proves nothing.
        """
        data = parse_json(text, "a design")
        if not isinstance(data, dict) or data.get("format") not in (FORMAT, FORMAT_1):
            found = data.get("format") if isinstance(data, dict) else type(data).__name__
            raise UserError(f"the format must be {FORMAT!r}, found {shown(found)}")
        model = ("system",) if data["format"] == FORMAT else ("A", "b", "k_lin")
        missing = {*model, "P", "mu", "alpha"} - data.keys()
        unknown = data.keys() - {*model, "P", *_SCALARS} - {"format", "derived"}
        if missing or unknown:
            raise UserError(f"a design has missing {sorted(missing)} and unknown {shown(sorted(unknown))} entries")
        given = data["system"] if data["format"] == FORMAT else {name: data[name] for name in model}
        system = from_dict(given)
        if data["format"] == FORMAT_1 and system.n == ORDER_1:
            system = system.changed(name=PENDULUM)
        if not _is_numbers(data["P"], 2):
            raise UserError(f"P must be a list of rows of numbers, all of one length, found {shown(data['P'])}")
        return cls(
            system,
            np.array(data["P"], dtype=float),
            **{name: _entry(name, data[name]) for name in _SCALARS if name in data},
        )

    @classmethod
    def load(cls, path: Path) -> Design:
        """Read a design file; errors name the file."""
        text = read_text(path, "design")
        try:
            return cls.from_json(text)
        except CertificateError as error:
            raise CertificateError(f"{path}: {error}") from None
        except UserError as error:
            raise UserError(f"{path}: {error}") from None


_SCALARS = ("mu", "alpha", "psi", "d_max", "tau", "method")


def _near_one(form: BlockForm, P: Array) -> BlockForm:
    """Return the form with its blocks scaled by powers of 2 so that P in it has a diagonal near 1."""
    size = np.abs(np.diag(form.T_inverse.T @ P @ form.T_inverse))
    factors = [float(np.sqrt(size[block].max())) for block in form.blocks]
    return form.scaled([2.0 ** np.round(np.log2(f)) if 0.0 < f < np.inf else 1.0 for f in factors])


def _entry(name: str, value: object) -> Any:
    """Return an entry of a file in its type; raise UserError that names it."""
    if name == "method":
        if not isinstance(value, str):
            raise UserError(f"method must be a text, found {shown(value)}")
        return value
    if not _is_numbers(value, 0):
        raise UserError(f"{name} must be a number, found {shown(value)}")
    return value


def _is_numbers(value: object, levels: int) -> bool:
    if not levels:
        return not isinstance(value, bool) and isinstance(value, int | float) and abs(value) < LARGEST
    if not isinstance(value, list) or not all(_is_numbers(v, levels - 1) for v in value):
        return False
    return levels < 2 or len({len(row) for row in value}) <= 1


def check_scalars(mu: float, alpha: float, psi: float, d_max: float, tau: float = 1.0) -> None:
    """Raise UserError for scalars that no design can have."""
    if not 0.0 < mu <= 1.0:
        raise UserError(f"mu must lie in (0, 1], found {mu}")
    if not 0.0 < alpha < np.inf:
        raise UserError(f"alpha must be positive and finite [1/s], found {alpha}")
    if not 0.0 < tau < np.inf:
        raise UserError(f"tau must be positive and finite, found {tau}")
    for name, value in (("psi", psi), ("d_max", d_max)):
        if not 0.0 <= value < np.inf:
            raise UserError(f"{name} must be non-negative and finite, found {value}")
    if d_max > 0.0 and mu < 1.0:
        raise UserError(f"a matched disturbance d_max > 0 can be rejected only at mu = 1, found mu = {mu}")
