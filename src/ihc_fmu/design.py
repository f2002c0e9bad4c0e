"""A certified implicit homogeneous controller for any (A, B): its numbers, its proof, its file."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from filing.files import write_file
from fmu_export.errors import UserError, shown
from fmu_export.files import FilePath
from fmu_export.reading import parse_json, read_text

from .arrays import QUIET, check_numbers, matrix
from .candidate import Candidate
from .certificate import Certificate, CertificateError, certify
from .html import html_table
from .integral import IntegralAction, integral_action
from .system import PENDULUM, System

LARGEST_SHOWN = 4
"""States of a design up to which its P is shown: larger ones push the certificate out of view."""

DESIGN_FILE = "design.json"
"""Among a controller FMU's resources: the design that it was made of, which its code does not read."""

FORMAT = "qube-ihc design 2"
FORMAT_1 = "qube-ihc design 1"
ORDER_1 = 4
"""Of designs for one input without names, which are read too; those of the order of the pendulum were for it."""


@dataclass(frozen=True, eq=False)
class Design(Candidate):
    """A certified implicit homogeneous controller for x' = A x + B u; it cannot be made without its certificate.

    Parameters
    ----------
    system
        (A, B), the linear controller u = K x that the IHC equals on ||x||_d = 1, names, units, limits.
    P
        Shape (n, n): the ellipsoid x' P x <= 1 is the unit ball of ||x||_d.
    mu
        Minus the degree of homogeneity, in (0, 1].
    alpha
        Decrease d||x||_d/dt <= -alpha ||x||_d^(1-mu) [1/s].
    psi, d_max, tau
        The terms of Remark 3, d_max in units of u; 0: none.
    method
        How it was designed.

    Raises
    ------
    UserError
        For numbers that no design can have.
    CertificateError
        For what is not proven, with alpha and with the terms of Remark 3 that are not 0.

    Examples
    --------
    >>> from ihc_fmu import Design, System
    >>> cart = System(A=[[0, 1], [0, 0]], B=[0, 1], K=[-4, -4], states=("position [m]", "velocity [m/s]"))
    >>> design = Design(cart, P=[[1, 0.5], [0.5, 0.3]], mu=1.0, alpha=0.5)
    >>> design.u_max.round(3).tolist(), design.extent.round(3).tolist()  # on the unit ball
    ([9.798], [2.449, 4.472])
    >>> design.scaled_to(u_max=2.0).u_max.round(6).tolist()
    [2.0]
    >>> dict(design.summary())["mu, alpha"]
    '1, 0.5 1/s'
    >>> design.save("cart.json")
    >>> Design.load("cart.json").to_json() == design.to_json()
    True
    """

    method: str = "given"
    certificate: Certificate = field(init=False)
    integral: IntegralAction | None = field(init=False)

    @QUIET
    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "certificate", certify(self))
        object.__setattr__(self, "integral", integral_action(self))

    @property
    def title(self) -> str:
        """What the design is of, and how it was made."""
        return f"implicit homogeneous controller of {self.system.name}, {self.method}"

    def summary(self) -> list[tuple[str, str]]:
        """Return the design's numbers and its certificate in words.

        Returns
        -------
        list[tuple[str, str]]
            What it is, and the numbers; a matrix has a line for each row.
        """
        system = self.system
        largest = (f"{q.name} {u:.6g}{q.suffix}" for q, u in zip(system.inputs, self.u_max, strict=True))
        extent = (f"{q.name} {x:.4g}{q.suffix}" for q, x in zip(system.states, self.extent, strict=True))
        poles = np.linalg.eigvals(self.A + self.B @ self.K)
        whole = self.n <= LARGEST_SHOWN
        return [
            ("states", ", ".join(map(str, system.states))),
            ("K, u = K x", _rows(self.K)),
            ("K - K_0", _rows(self.K_h)),
            *([] if self.integral is None else [("K_i of the integral action", _rows(self.integral.K_i))]),
            ("P", _rows(self.P) if whole else f"{self.n} x {self.n}, in the file"),
            ("mu, alpha", f"{self.mu:g}, {self.alpha:g} 1/s"),
            ("origin reached from the unit sphere within", f"{1.0 / (self.mu * self.alpha):.4g} s"),
            ("largest |(K - K_0) x| on the unit ball", ", ".join(largest)),
            ("largest states on the unit ball", ", ".join(extent)),
            ("poles of A + B K", ", ".join(f"{p:.4g}" for p in poles)),
            *((f"certificate: {name}", f"{margin:.4g}") for name, margin in self.certificate.as_dict().items()),
        ]

    def _repr_html_(self) -> str:
        return html_table(self.title, (), self.summary())

    def scaled_to(
        self, *, u_max: float | Sequence[float] | None = None, index: int | None = None, bound: float | None = None
    ) -> Design:
        """Return the design with P scaled by an explicit rule, which leaves (11) untouched.

        Parameters
        ----------
        u_max
            What the largest |(K - K_0) x| on the unit ball becomes, a number or one for each input, of which the first is
            reached.
        index, bound
            Instead: the largest |x_index| there becomes `bound`.

        Returns
        -------
        Design
            With the same K, mu and alpha.

        Raises
        ------
        UserError
            Where not exactly one rule is given, and for a design with the terms of Remark 3.
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

    def to_json(self, *, derived: bool = True) -> str:
        """Return the design as JSON; floats are exact.

        Parameters
        ----------
        derived
            With what follows from it, certificate included, for the reader: computed anew when the file is read. Its last
            bits are the processor's, so that FMUs, which are the same on all, carry the design without.

        Returns
        -------
        str
            The text.
        """
        given = {name: getattr(self, name) for name in _SCALARS}
        data = {"format": FORMAT, "system": self.system.as_dict(), "P": self.P.tolist(), **given}
        if derived:
            data["derived"] = self._derived()
        return json.dumps(data, indent=1) + "\n"

    def _derived(self) -> dict[str, Any]:
        derived = {
            "K_0": self.form.K_0.tolist(),
            "T": self.form.T.tolist(),
            "blocks": list(self.form.sizes),
            "u_max": self.u_max.tolist(),
            "certificate": self.certificate.as_dict(),
        }
        if self.integral is not None:
            derived |= {"K_i": self.integral.K_i.tolist(), "Gamma": self.integral.Gamma.tolist()}
        return derived

    def save(self, path: FilePath) -> None:
        """Write the design file, JSON, whole or not at all.

        Parameters
        ----------
        path
            The file.

        Raises
        ------
        UserError
            Where it cannot be written.
        """
        write_file(Path(path), self.to_json())

    @classmethod
    def from_json(cls, text: str) -> Design:
        """Return the design of `to_json`; the derived numbers are computed anew and the certificate is checked.

        Parameters
        ----------
        text
            JSON.

        Returns
        -------
        Design
            Proven anew.

        Raises
        ------
        UserError
            For text that is not a design.
        CertificateError
            For one that proves nothing.

        Examples
        --------
        >>> Design.from_json("{}")
        Traceback (most recent call last):
        fmu_export.errors.UserError: the format must be 'qube-ihc design 2', found None
        """
        data = parse_json(text, "a design")
        if not isinstance(data, dict) or data.get("format") not in (FORMAT, FORMAT_1):
            given = data.get("format") if isinstance(data, dict) else type(data).__name__
            raise UserError(f"the format must be {FORMAT!r}, found {shown(given)}")
        model = ("system",) if data["format"] == FORMAT else ("A", "b", "k_lin")
        missing = {*model, "P", "mu", "alpha"} - data.keys()
        unknown = data.keys() - {*model, "P", *_SCALARS} - {"format", "derived"}
        if missing or unknown:
            raise UserError(f"a design has missing {sorted(missing)} and unknown {shown(sorted(unknown))} entries")
        given = data["system"] if data["format"] == FORMAT else {name: data[name] for name in model}
        system = System.from_dict(given)
        if data["format"] == FORMAT_1 and system.n == ORDER_1:
            system = system.changed(name=PENDULUM)
        P = matrix("P", check_numbers("P", data["P"], 2))
        return cls(system, P, **{name: _entry(name, data[name]) for name in _SCALARS if name in data})

    @classmethod
    def load(cls, path: FilePath) -> Design:
        """Read a design file.

        Parameters
        ----------
        path
            The file.

        Returns
        -------
        Design
            Proven anew.

        Raises
        ------
        UserError
            For a file that is not a design's; the sentence names it.
        CertificateError
            For one that proves nothing.
        """
        text = read_text(Path(path), "design")
        try:
            return cls.from_json(text)
        except CertificateError as error:
            raise CertificateError(f"{path}: {error}") from None
        except UserError as error:
            raise UserError(f"{path}: {error}") from None


_SCALARS = ("mu", "alpha", "psi", "d_max", "tau", "method")


def _entry(name: str, value: object) -> Any:
    """Return an entry of a file in its type; raise UserError that names it."""
    if name == "method":
        if not isinstance(value, str):
            raise UserError(f"method must be a text, found {shown(value)}")
        return value
    return check_numbers(name, value, 0)


def _rows(matrix: Iterable[Iterable[float]]) -> str:
    return "\n".join("[" + ", ".join(f"{v:.6g}" for v in row) + "]" for row in matrix)
