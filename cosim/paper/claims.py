"""The paper's claims judged: a printed value against ours within a tolerance, a ranking by its share of the draws."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.stats import binomtest

from ..campaign import Numbers, counted
from . import printed
from .gains import GainReading, NormReading
from .study import COMPARED, GAINS, REFERENCE, Key

Found = Mapping[Key, Numbers]
Verdict = Literal["holds", "does not hold", "undecided"]

Basis = Literal["independent", "fitted", "repeats"]
"""What a claim's verdict rests on: nothing else; the fits of the swing-up and of SMC1 to just that printed number; numbers
that other claims judge already, as another reading of the same statement or their arithmetical consequence.
"""

FITTED_GAINS = {"IHC": (0,), "SMC1": (0, 60, 200)}
"""Gains G at which a controller's margin over the LC was fitted; the LC's LMSE at G = 0 was too, and SMC1's energy there."""

CONFIDENCE = 0.95

RELATIVE = 0.5
"""A printed margin counts as reproduced within half of itself, but at least within one percentage point."""

LEAST_MARGIN = 1.0
"""[%]"""

LMSE_TOLERANCE = 0.1
"""A printed LMSE counts as reproduced within a tenth of itself."""


@dataclass(frozen=True)
class Share:
    """In how many of `draws` pairs the first controller was the better one; `low`, `high`: Wilson's interval."""

    wins: int
    draws: int

    @property
    def value(self) -> float:
        """The share; NaN without draws."""
        return self.wins / self.draws if self.draws else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % confidence interval of the share (Wilson's score interval); (0, 1) without draws."""
        if not self.draws:
            return 0.0, 1.0
        found = binomtest(self.wins, self.draws).proportion_ci(CONFIDENCE, method="wilson")
        return float(found.low), float(found.high)

    @property
    def verdict(self) -> Verdict:
        """Whether more than half of all draws would show the ranking, as far as the interval decides it."""
        low, high = self.interval
        return "holds" if low > 0.5 else "does not hold" if high < 0.5 else "undecided"

    def __str__(self) -> str:
        if not self.draws:
            return "no draw decides"
        low, high = self.interval
        return f"{self.wins} of {self.draws} ({100 * low:.0f} to {100 * high:.0f} %)"


@dataclass(frozen=True)
class Claim:
    """One statement: what the paper says, its number, ours from the run without draws, and the verdict.

    `low`, `high`: between these ours must lie (both NaN: the share of draws decides). `runs`: the runs that ours is from.
    `main`: one of the paper's main statements, shown first. `basis`: what the verdict rests on.
    """

    section: str
    text: str
    printed: float
    ours: float
    unit: str
    low: float = math.nan
    high: float = math.nan
    share: Share | None = None
    runs: tuple[Key, ...] = ()
    main: bool = False
    basis: Basis = "independent"

    @property
    def verdict(self) -> Verdict:
        """Decided by the tolerance where there is one, by the share of draws otherwise."""
        if not math.isnan(self.low):
            return "holds" if self.low <= self.ours <= self.high else "does not hold"
        if self.share is None:
            raise ValueError(f"the claim {self.text!r} needs a tolerance or draws")
        return self.share.verdict

    @property
    def rule(self) -> str:
        """What the verdict needs, as text."""
        if math.isnan(self.low):
            return "more than half of the draws"
        unit = "" if self.unit == "1" else f" {self.unit}"
        if math.isinf(self.low):
            return f"at most {self.high:.4g}{unit}"
        if math.isinf(self.high):
            return f"at least {self.low:.4g}{unit}"
        return f"{self.low:.4g} to {self.high:.4g}{unit}"


def share_of_wins(found: Found, keys: Iterable[Key], better: str, other: str, name: str) -> Share:
    """Return in which share of the draws among `keys` the controller `better` has the smaller number `name`.

    A controller that lost the pendulum loses the draw; draws that both lost, or in which neither has the number, are left
    out.
    """
    wins = draws = 0
    for key in keys:
        if key.variant != better:
            continue
        a, b = (counted(found[k], name) for k in (key, key._replace(variant=other)))
        if a == b:
            continue
        draws += 1
        wins += a < b
    return Share(wins, draws)


def by_cell(found: Found) -> dict[tuple[str, str, float, float], list[Key]]:
    """Return the keys of the runs by (experiment, set, sample time, gain)."""
    cells: dict[tuple[str, str, float, float], list[Key]] = {}
    for key in found:
        cells.setdefault(key[:4], []).append(key)
    return cells


def margin(a: float, b: float) -> float:
    """Return by how much a lies above b [%]."""
    return 100.0 * (a / b - 1.0)


def tolerance(value: float) -> tuple[float, float]:
    """Return the interval in which a margin [%] counts as the printed one."""
    width = max(LEAST_MARGIN, RELATIVE * abs(value))
    return value - width, value + width


class Judge:
    """All claims from the numbers of all runs; `found` by key, the reference's and the draws'."""

    def __init__(self, found: Found) -> None:
        self.found = found
        self.cells = by_cell(found)

    def key(self, variant: str, gain: float = 0) -> Key:
        """Return the reference run of a controller."""
        return Key("reference", *REFERENCE, gain, variant, 0)

    def value(self, variant: str, name: str, gain: float = 0) -> float:
        """Return a number of a reference run."""
        return self.found[self.key(variant, gain)][name]

    def share(self, better: str, other: str, name: str, gain: float = 0, experiment: str = "swing-up") -> Share:
        """Return the share of draws in the reference's set and sample time."""
        return share_of_wins(self.found, self.cells.get((experiment, *REFERENCE, gain), []), better, other, name)

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
        found = []
        for law, variants in VARIANTS_OF_LAW.items():
            for variant in variants:
                width = LMSE_TOLERANCE * values[law]
                found.append(
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
                    found += self._pair(section, gain, one, two, margin(values[a], values[b]))
        return found

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
        found = []
        for law, said in printed.ENERGY_OVER.items():
            for other in VARIANTS_OF_LAW[law]:
                low, high = tolerance(100 * said)
                ours = margin(self.value("IHC", "energy"), self.value(other, "energy"))
                runs = (self.key("IHC"), self.key(other))
                text = f"energy of IHC relative to {other}"
                basis: Basis = "fitted" if other == "SMC1" else "independent"
                found.append(Claim("Energy", text, 100 * said, ours, "%", low, high, None, runs, True, basis))
        runs = (self.key("IHC"), self.key("LC"))
        ours = margin(self.value("IHC", "energy"), self.value("LC", "energy"))
        share = self.share("IHC", "LC", "energy")
        said = 100 * printed.ENERGY_OVER["LC"]
        text = "“less control energy” than LC (section V; Table I says more)"
        found.append(Claim("Energy", text, said, ours, "%", share=share, runs=runs))
        for gain in GAINS[1:]:
            ours = margin(self.value("IHC", "energy", gain), self.value("LC", "energy", gain))
            runs = (self.key("IHC", gain), self.key("LC", gain))
            text = f"IHC “similar” to LC at G = {gain:g}"
            found.append(Claim("Energy", text, 0.0, ours, "%", -5.0, 5.0, runs=runs, basis=_at(gain)))
        return found

    def _steady_state(self) -> list[Claim]:
        nan = math.nan
        section = "Figures 3 and 4"
        found = [
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
                    found.append(
                        Claim(section, text_of, nan, ours, "%", share=share, runs=runs, main=main, basis=basis)
                    )
        return found

    def _below(self, variant: str, name: str, bound: float) -> Share:
        keys = [k for k in self.cells.get(("swing-up", *REFERENCE, 0), []) if k.variant == variant]
        values = [counted(self.found[key], name) for key in keys]
        return Share(sum(value <= bound for value in values), len(values))

    def _growth(self) -> list[Claim]:
        section = "Table II, growth"
        first, last = GAINS[1], GAINS[-1]
        found = []
        for law, variants in VARIANTS_OF_LAW.items():
            for variant in variants:
                said = margin(printed.LMSE[last][law], printed.LMSE[first][law])
                ours = margin(*(self.value(variant, "integral_q2", gain) for gain in (last, first)))
                runs = (self.key(variant, last), self.key(variant, first))
                low, high = tolerance(said)
                text = f"growth of LMSE of {variant} from G = {first:g} to {last:g}"
                basis: Basis = "fitted" if variant == "SMC1" else "repeats"
                found.append(Claim(section, text, said, ours, "%", low, high, runs=runs, basis=basis))
        said = _ratio(*(printed.LMSE[gain][law] for law in ("IHC", "LC") for gain in (last, first)))
        ours = _ratio(*(self.value(law, "integral_q2", gain) for law in ("IHC", "LC") for gain in (last, first)))
        runs = tuple(self.key(law, gain) for law in ("IHC", "LC") for gain in (last, first))
        text = "growth of the IHC's LMSE as a share of the LC's"
        low, high = (1 - RELATIVE) * said, (1 + RELATIVE) * said
        found.append(Claim(section, text, said, ours, "1", low, high, runs=runs, main=True, basis="repeats"))
        found.append(self._linearity(section))
        for gain in GAINS[1:]:
            ours = margin(self.value("IHC", "steady_rms", gain), self.value("LC", "steady_rms", gain))
            share = self.share("IHC", "LC", "steady_rms", gain)
            runs = (self.key("IHC", gain), self.key("LC", gain))
            text = f"Figure 6: steady |q| of IHC below LC at G = {gain:g}"
            main = gain == GAINS[-1]
            found.append(Claim(section, text, math.nan, ours, "%", share=share, runs=runs, main=main, basis=_at(gain)))
        return found

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
