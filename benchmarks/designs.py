"""Designs of random systems in all units: how many are found, how long it takes, and their proofs again in 60 digits.

    python -m benchmarks.designs [--systems N] [--first SEED] [--orders N ...] [--per-order N]

Each system is designed from its linear controller (inverse) and without one (direct). Printed: how many designs were
found, refuted by the dual, and left undecided; the time of a design over the order; how far the design of the same system
in other units is; and every design's proof computed anew by recheck.py. A system that is not found or refuted is named
with its seed.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np

from benchmarks.random_systems import Drawn, distance, drawn
from benchmarks.recheck import Recheck, recheck
from fmu_export.errors import UserError
from ihc_fmu.design import Design
from ihc_fmu.direct import direct_design
from ihc_fmu.inverse import inverse_design
from ihc_fmu.lmi import InfeasibleError
from ihc_fmu.options import Options

METHODS: dict[str, Callable[..., Design]] = {"inverse": inverse_design, "direct": direct_design}
SAME, ROUNDING = 1e-6, 1e-16
"""Distance up to which designs are the same, and what rounding adds to it, times the condition of P."""
OUTCOMES = ("found", "found, ball not maximized", "refuted", "undecided", "refused")


@dataclass
class Tally:
    """What became of the designs of one method."""

    outcomes: Counter[str] = field(default_factory=Counter)
    seconds: defaultdict[int, list[float]] = field(default_factory=lambda: defaultdict(list))
    rechecks: list[Recheck] = field(default_factory=list)
    distances: list[float] = field(default_factory=list)
    beyond_rounding: list[float] = field(default_factory=list)
    wanting: list[str] = field(default_factory=list)

    def add(self, case: Drawn, plain: Drawn, design: Callable[..., Design]) -> None:
        start = perf_counter()
        outcome, found, why = designed(case, design)
        self.seconds[case.system.n].append(perf_counter() - start)
        self.outcomes[outcome] += 1
        if found is None:
            if outcome != "refuted":
                self.wanting.append(f"{outcome}: {case.about}: {why}")
            return
        proof = recheck(found)
        self.rechecks.append(proof)
        if not proof.holds:
            self.wanting.append(f"NOT PROVEN in 60 digits: {case.about}: {proof}")
        other, same, _ = designed(plain, design)
        if same is None or other != outcome:
            self.wanting.append(f"{outcome}, but {other} in other units: {case.about}")
        else:
            self.distances.append(distance(found, same, case))
            self.beyond_rounding.append(self.distances[-1] / max(SAME, ROUNDING / same.certificate.positive))


def designed(case: Drawn, design: Callable[..., Design]) -> tuple[str, Design | None, str]:
    """Return what became of a design, the design, and why there is none."""
    try:
        found = design(case.system, Options(alpha=case.alpha, u_max=case.u_max.clip(1e-9, 1e9).tolist()))
    except InfeasibleError as error:
        return "undecided" if error.numerical else "refuted", None, str(error)
    except UserError as error:
        return "refused", None, str(error)
    return "found, ball not maximized" if "not maximized" in found.method else "found", found, ""


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--systems", type=int, default=300)
    parser.add_argument("--first", type=int, default=0, help="seed of the first system")
    parser.add_argument("--orders", type=int, nargs="*", default=[10, 12, 16], help="orders beyond 8 that are timed")
    parser.add_argument("--per-order", type=int, default=5)
    options = parser.parse_args(arguments)
    seeds = range(options.first, options.first + options.systems)
    cases = [(seed, None) for seed in seeds] + [(k, n) for n in options.orders for k in range(options.per_order)]
    tallies = {name: Tally() for name in METHODS}
    large = {name: Tally() for name in METHODS}
    for seed, n in cases:
        case = drawn(seed, n)
        for name, design in METHODS.items():
            (large if n else tallies)[name].add(case, drawn(seed, n, units=False), design)
    print_outcomes(tallies, f"{options.systems} systems, n 2..8, m 1..3")
    if options.orders:
        print_outcomes(large, f"{options.per_order} systems of each n = {', '.join(map(str, options.orders))}")
    print_seconds(tallies, large)
    print_distances(tallies, large)
    print_proofs([tally for both in (tallies, large) for tally in both.values()])
    wanting = [line for both in (tallies, large) for tally in both.values() for line in tally.wanting]
    print(*wanting, sep="\n")
    return int(any(line.startswith("NOT") for line in wanting))


def print_outcomes(tallies: dict[str, Tally], title: str) -> None:
    print(f"\n{title}:")
    print(f"{'':28}" + "".join(f"{name:>10}" for name in tallies))
    for outcome in OUTCOMES:
        print(f"{outcome:28}" + "".join(f"{tally.outcomes[outcome]:10}" for tally in tallies.values()))


def print_seconds(*groups: dict[str, Tally]) -> None:
    print("\nSeconds of a design, median and largest:")
    print(f"{'n':>4}" + "".join(f"{name:>20}" for name in METHODS))
    for group in groups:
        for n in sorted({n for tally in group.values() for n in tally.seconds}):
            cells = (f"{np.median(t.seconds[n]):.2f}, {max(t.seconds[n]):.2f}" for t in group.values())
            print(f"{n:4}" + "".join(f"{cell:>20}" for cell in cells))


def print_distances(*groups: dict[str, Tally]) -> None:
    print(
        f"\nDistance of the same system's design in other units, median and largest; how many are beyond {SAME:g}, and how"
    )
    print(
        f"many of these beyond what rounding of P may do, {ROUNDING:g} over its smallest eigenvalue relative to the largest:"
    )
    for name in METHODS:
        found = np.array([d for tallies in groups for d in tallies[name].distances])
        beyond = np.array([d for tallies in groups for d in tallies[name].beyond_rounding])
        if len(found):
            counts = f"{(found > SAME).sum()}, {(beyond > 1.0).sum()} of {len(found)}"
            print(f"{name:>10}: {np.median(found):.1e}, {found.max():.1e}; {counts}")


def print_proofs(tallies: Sequence[Tally]) -> None:
    proofs = [proof for tally in tallies for proof in tally.rechecks]
    failed = sum(not proof.holds for proof in proofs)
    print(f"\n{len(proofs)} proofs computed anew in 60 digits: {failed} do not hold")
    if proofs:
        print(f"smallest margin of (11), relative to alpha: {min(p.decrease for p in proofs):.2g}")
        print(f"smallest margin of the dilation: {min(p.monotone for p in proofs):.2g}")
        print(f"largest residual of the block form: {max(p.identities for p in proofs):.2g}")
        print(f"largest relative distance of G_d: {max(p.generator for p in proofs):.2g}")


if __name__ == "__main__":
    sys.exit(main())
