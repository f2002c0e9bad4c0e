"""The paper's claims judged: the figures and tables by the numbers of all runs, model and design by themselves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..studies.estimates import Share
from ..studies.numbers import counted
from . import printed
from .gains import GainReading, NormReading
from .study import COMPARED, GAINS, REFERENCE, Key
from .verdicts import RELATIVE, Basis, Claim, Runs, by_cell, margin, share_of_wins, tolerance

FITTED_GAINS = {"IHC": (0,), "SMC1": (0, 60, 200)}
"""Gains G at which a controller's margin over the LC was fitted; the LC's LMSE at G = 0 was too, and SMC1's energy there."""

LMSE_TOLERANCE = 0.1
"""A printed LMSE counts as reproduced within a tenth of itself."""


class Judge:
    """All claims from the numbers of all runs, the reference's and the draws'."""

    def __init__(self, runs: Runs) -> None:
        self.runs = runs
        self.cells = by_cell(runs)

    def key(self, variant: str, gain: float = 0) -> Key:
        """Return the reference run of a controller."""
        return Key("reference", *REFERENCE, gain, variant, 0)

    def value(self, variant: str, name: str, gain: float = 0) -> float:
        """Return a number of a reference run."""
        return self.runs[self.key(variant, gain)][name]

    def share(self, better: str, other: str, name: str, gain: float = 0, experiment: str = "swing-up") -> Share:
        """Return the share of draws in the reference's set and sample time."""
        return share_of_wins(self.runs, self.cells.get((experiment, *REFERENCE, gain), []), better, other, name)

    def claims(self) -> list[Claim]:
        """Return the claims about the figures and tables."""
        return [
            *self._table(0),
            *self._energy(),
            *self._steady_state(),
            *(claim for gain in GAINS[1:] for claim in self._table(gain)),
            *self._growth(),
        ]

    def _table(self, gain: float) -> list[Claim]:
        section = "Table I" if gain == 0 else f"Table II, G = {gain:g}"
        values = printed.LMSE[int(gain)]
        claims = []
        for law, variants in VARIANTS_OF_LAW.items():
            for variant in variants:
                width = LMSE_TOLERANCE * values[law]
                claims.append(
                    Claim(
                        section,
                        f"LMSE of {variant}",
                        values[law],
                        self.value(variant, "integral_q2", gain),
                        "rad² s",
                        values[law] - width,
                        values[law] + width,
                        runs=(self.key(variant, gain),),
                        basis=_value_basis(variant, gain),
                    )
                )
        for a, b in (("IHC", "LC"), ("IHC", "SMC"), ("SMC", "LC")):
            for one in VARIANTS_OF_LAW[a]:
                for two in VARIANTS_OF_LAW[b]:
                    claims += self._pair(section, gain, one, two, margin(values[a], values[b]))
        return claims

    def _pair(self, section: str, gain: float, one: str, two: str, said: float) -> list[Claim]:
        ours = margin(self.value(one, "integral_q2", gain), self.value(two, "integral_q2", gain))
        runs = (self.key(one, gain), self.key(two, gain))
        low, high = tolerance(said)
        better, other = (one, two) if said < 0 else (two, one)
        share = self.share(better, other, "integral_q2", gain)
        main = two == "LC" and one == "IHC"
        basis = _margin_basis(one, two, gain)
        return [
            Claim(section, f"LMSE of {one} relative to {two}", said, ours, "%", low, high, None, runs, main, basis),
            Claim(
                section,
                f"LMSE of {better} below {other}",
                said,
                ours,
                "%",
                math.nan,
                math.nan,
                share,
                runs,
                main,
                basis,
            ),
        ]

    def _energy(self) -> list[Claim]:
        claims = []
        for law, said in printed.ENERGY_OVER.items():
            for other in VARIANTS_OF_LAW[law]:
                low, high = tolerance(100 * said)
                ours = margin(self.value("IHC", "energy"), self.value(other, "energy"))
                runs = (self.key("IHC"), self.key(other))
                text = f"energy of IHC relative to {other}"
                basis: Basis = "fitted" if other == "SMC1" else "independent"
                claims.append(Claim("Energy", text, 100 * said, ours, "%", low, high, None, runs, True, basis))
        runs = (self.key("IHC"), self.key("LC"))
        ours = margin(self.value("IHC", "energy"), self.value("LC", "energy"))
        share = self.share("IHC", "LC", "energy")
        said = 100 * printed.ENERGY_OVER["LC"]
        text = "“less control energy” than LC (section V; Table I says more)"
        claims.append(Claim("Energy", text, said, ours, "%", share=share, runs=runs))
        for gain in GAINS[1:]:
            ours = margin(self.value("IHC", "energy", gain), self.value("LC", "energy", gain))
            runs = (self.key("IHC", gain), self.key("LC", gain))
            text = f"IHC “similar” to LC at G = {gain:g}"
            claims.append(Claim("Energy", text, 0.0, ours, "%", -5.0, 5.0, runs=runs, basis=_at(gain)))
        return claims

    def _steady_state(self) -> list[Claim]:
        nan = math.nan
        section = "Figures 3 and 4"
        claims = [
            Claim(
                section,
                f"|q| of IHC settles to {tol:g} rad within {printed.SETTLED_BY:g} s",
                printed.SETTLED_BY,
                self.value("IHC", name),
                "s",
                -math.inf,
                printed.SETTLED_BY,
                self._below("IHC", name, printed.SETTLED_BY),
                (self.key("IHC"),),
                main=True,
                basis="repeats" if name == "settling_time" else "independent",
            )
            for name, tol in (("settling_wide", 0.1), ("settling_time", 0.02))
        ]
        sentences = (
            ("settles to 0.1 rad earlier", "settling_wide"),
            ("settles to 0.02 rad earlier", "settling_time"),
            ("has the smaller error from 5 to 7 s", "window_rms"),
            ("has the smaller steady-state error (last 3 s)", "steady_rms"),
            ("has the smaller oscillation of θ from 5 to 7 s", "window_theta"),
            ("has the smaller oscillation of δ from 5 to 7 s", "window_delta"),
        )
        for text, name in sentences:
            for other in COMPARED:
                if other != "IHC":
                    runs = (self.key("IHC"), self.key(other))
                    ours = margin(self.value("IHC", name), self.value(other, name))
                    share = self.share("IHC", other, name)
                    text_of = f"IHC {text} than {other}"
                    main = other == "LC" and name != "settling_time"
                    again = other == "SMC2" or name == "settling_time"  # a second SMC, a second tolerance
                    basis: Basis = "repeats" if again else "independent"
                    claims.append(
                        Claim(section, text_of, nan, ours, "%", share=share, runs=runs, main=main, basis=basis)
                    )
        return claims

    def _below(self, variant: str, name: str, bound: float) -> Share:
        keys = [k for k in self.cells.get(("swing-up", *REFERENCE, 0), []) if k.variant == variant]
        values = [counted(self.runs[key], name) for key in keys]
        return Share(sum(value <= bound for value in values), len(values))

    def _growth(self) -> list[Claim]:
        section = "Table II, growth"
        first, last = GAINS[1], GAINS[-1]
        claims = []
        for law, variants in VARIANTS_OF_LAW.items():
            for variant in variants:
                said = margin(printed.LMSE[last][law], printed.LMSE[first][law])
                ours = margin(*(self.value(variant, "integral_q2", gain) for gain in (last, first)))
                runs = (self.key(variant, last), self.key(variant, first))
                low, high = tolerance(said)
                text = f"growth of LMSE of {variant} from G = {first:g} to {last:g}"
                basis: Basis = "fitted" if variant == "SMC1" else "repeats"
                claims.append(Claim(section, text, said, ours, "%", low, high, runs=runs, basis=basis))
        said = _ratio(*(printed.LMSE[gain][law] for law in ("IHC", "LC") for gain in (last, first)))
        ours = _ratio(*(self.value(law, "integral_q2", gain) for law in ("IHC", "LC") for gain in (last, first)))
        runs = tuple(self.key(law, gain) for law in ("IHC", "LC") for gain in (last, first))
        text = "growth of the IHC's LMSE as a share of the LC's"
        low, high = (1 - RELATIVE) * said, (1 + RELATIVE) * said
        claims.append(Claim(section, text, said, ours, "1", low, high, runs=runs, main=True, basis="repeats"))
        claims.append(self._linearity(section))
        for gain in GAINS[1:]:
            ours = margin(self.value("IHC", "steady_rms", gain), self.value("LC", "steady_rms", gain))
            share = self.share("IHC", "LC", "steady_rms", gain)
            runs = (self.key("IHC", gain), self.key("LC", gain))
            text = f"Figure 6: steady |q| of IHC below LC at G = {gain:g}"
            main = gain == GAINS[-1]
            claims.append(Claim(section, text, math.nan, ours, "%", share=share, runs=runs, main=main, basis=_at(gain)))
        return claims

    def _linearity(self, section: str) -> Claim:
        """Return how the LC's growth depends on G: in a linear loop it goes with the square of G."""
        first, middle, last = GAINS[1:]
        said = _ratio(*(printed.LMSE[gain]["LC"] for gain in (middle, first, last, first)))
        ours = _ratio(*(self.value("LC", "integral_q2", gain) for gain in (middle, first, last, first)))
        linear = (middle**2 - first**2) / (last**2 - first**2)
        text = f"growth of LC to G = {middle:g} as a share of that to {last:g} (a linear loop: {linear:.2f})"
        runs = tuple(self.key("LC", gain) for gain in (first, middle, last))
        low, high = (1 - RELATIVE) * said, (1 + RELATIVE) * said
        return Claim(section, text, said, ours, "1", low, high, runs=runs, basis="repeats")


def _at(gain: float) -> Basis:
    """G = 1 disturbs by 0.03 V at most, which is less than a count: its claims repeat those without a disturbance."""
    return "repeats" if gain == GAINS[1] else "independent"


def _value_basis(variant: str, gain: float) -> Basis:
    """An LMSE other than the LC's is the LC's and the margin over it, which are judged by themselves."""
    if variant == "LC":
        return "fitted" if gain == 0 else _at(gain)
    return "fitted" if gain in FITTED_GAINS.get(variant, ()) else "repeats"


def _margin_basis(one: str, two: str, gain: float) -> Basis:
    """A margin over an SMC is that over the LC and the SMC's over the LC."""
    if two != "LC":
        both = all(gain in FITTED_GAINS.get(law, ()) for law in (one, two))
        return "fitted" if both else "repeats"
    return "fitted" if gain in FITTED_GAINS.get(one, ()) else _at(gain)


def _ratio(a_last: float, a_first: float, b_last: float, b_first: float) -> float:
    return (a_last - a_first) / (b_last - b_first)


VARIANTS_OF_LAW = {"LC": ("LC",), "IHC": ("IHC",), "SMC": ("SMC1", "SMC2")}
"""The paper's laws, and the controllers that stand for them."""


@dataclass(frozen=True)
class Theory:
    """What the claims without draws need.

    largest_alpha [1/s]: of eq. (11) at mu = 1. same_as_linear [V]: largest difference of voltage between the IHC with
    a_min = b_max = 1 and the LC in a run. listed_off [1]: largest error of A and b of the listed parameters over the
    largest printed entry. listed_pole [1/s]: largest real part of the LC's poles with them.
    """

    gains: Sequence[GainReading]
    norms: Sequence[NormReading]
    largest_alpha: float
    same_as_linear: float
    listed_off: float
    listed_pole: float

    def claims(self) -> list[Claim]:
        """Return the claims about the model, k, P, alpha and Algorithm 1."""
        inf, nan, alpha = math.inf, math.nan, printed.ALPHA
        off_A = self.listed_off
        computed = self.gains[-1].K + (printed.K - self.gains[1].K)  # k_lin + row
        off = float(np.max(np.abs(printed.K - computed)))
        stable = min(float(np.real(reading.poles).max()) for reading in self.gains[:4])
        solved = max(reading.decrease for reading in self.norms[:-1])
        said = (
            (
                "the listed parameters give the printed A, b: largest error over largest entry",
                0.0,
                off_A,
                "1",
                0.0,
                1e-3,
            ),
            ("the LC stabilizes the listed parameters: largest pole", nan, self.listed_pole, "1/s", -inf, 0.0),
            ("the printed k is k_lin + row, eq. (10): largest difference", 0.0, off, "1", 0.0, 1e-3),
            ("some reading of the printed k stabilizes A, b: largest pole", nan, stable, "1/s", -inf, 0.0),
            ("some reading of the printed P solves eq. (11): largest decrease", 0.0, solved, "1/s", -1e-6, inf),
            ("eq. (11) has a solution at the printed α: largest α", alpha, self.largest_alpha, "1/s", alpha, inf),
            ("a_min = b_max = 1 is the LC: largest difference of voltage", 0.0, self.same_as_linear, "V", 0.0, 0.0),
        )
        return [Claim("Model and design", *one, main="some reading" in one[0]) for one in said]
