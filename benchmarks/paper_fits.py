"""How the study's two fits were made: the swing-up of the scenario `paper`, and SMC1, by random search.

    python -m benchmarks.paper_fits (swing-up | smc) [--tries N] [--seed SEED] [--from-random N] [--folder FOLDER]

The search starts from what is used and says whether a better one was found nearby; with `--from-random` it starts from the
best of random ones. The folder is that of a study, as `qube-ihc paper` leaves it.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from cosim.errors import UserError
from cosim.fmu_files import describe
from cosim.paper import printed
from cosim.paper.gains import A, B
from cosim.paper.study import QUICK, REFERENCE, SWING_UP_RANGES, Key, Study, numbers
from cosim.paper.variants import smc_start
from cosim.paper.verdicts import margin
from cosim.studies.engine import Job, run_all
from ihc_fmu.sliding_mode import FITTED_KAPPA, FITTED_POLES, FITTED_RHO, sliding_mode_design

STEP = 1e-3
"""Sample time of the runs that are fitted [s]; the result is then checked at the paper's 0.1 ms by the study itself."""

Values = np.ndarray
Misfit = Callable[[Values], float]

SMC_NAMES = ("slow pole [1/s]", "real part [1/s]", "imaginary part [1/s]", "kappa [1/s]", "rho [V]")
SMC_USED = (-FITTED_POLES[0].real, -FITTED_POLES[1].real, FITTED_POLES[1].imag, FITTED_KAPPA, FITTED_RHO)
SMC_RANGES = ((0.8, 2.0), (4.0, 30.0), (2.0, 35.0), (1.0, 40.0), (0.2, 6.0))


def swing_up_misfit(study: Study, values: Values) -> float:
    """Return how far a swing-up is from three printed numbers: sum of squares, infinite where a pendulum is lost.

    The switch after 1.5 s (in units of 0.08 s), the LC's LMSE 11.23 (0.3), the IHC's margin (0.3 %); mean over two draws
    of the encoders' offsets.
    """
    start = {f"controller.start.{name}": float(value) for name, value in zip(SWING_UP_RANGES, values, strict=True)}
    runs = _runs(study, {(v, s): {**start, "run.seed": s} for v in ("LC", "IHC") for s in (1, 2)})
    total = 0.0
    for seed in (1, 2):
        lc, ihc = runs["LC", seed], runs["IHC", seed]
        if not (lc["kept"] and ihc["kept"]):
            return math.inf
        over, said = margin(ihc["integral_q2"], lc["integral_q2"]), printed.LMSE[0]
        total += ((lc["capture_time"] - printed.SWITCH_TIME) / 0.08) ** 2
        total += ((lc["integral_q2"] - said["LC"]) / 0.3) ** 2 + ((over - margin(said["IHC"], said["LC"])) / 0.3) ** 2
    return total / 2


def smc_misfit(study: Study, values: Values) -> float:
    """Return how far an SMC is from what is printed of it: sum of squares, infinite where a pendulum is lost.

    Margins over the LC at G = 0, 60 and 200 (in units of 1 %) and the energy over the LC at G = 0 (6 %).
    """
    slow, real, imaginary, kappa, rho = (float(value) for value in values)
    poles = np.array([-slow, complex(-real, imaginary), complex(-real, -imaginary)])
    start = {f"controller.start.{n}": v for n, v in smc_start(sliding_mode_design(A, B, poles, kappa, rho)).items()}
    gains = (0, 60, 200)
    cases = {("SMC1", gain): {**start, "disturbance.gain": float(gain)} for gain in gains}
    runs = _runs(study, cases | {("LC", gain): {"disturbance.gain": float(gain)} for gain in gains})
    if not all(runs["SMC1", gain]["kept"] for gain in gains):
        return math.inf
    ours = [margin(runs["SMC1", g]["integral_q2"], runs["LC", g]["integral_q2"]) for g in gains]
    said = [margin(printed.LMSE[g]["SMC"], printed.LMSE[g]["LC"]) for g in gains]
    energy = margin(runs["SMC1", 0]["energy"], runs["LC", 0]["energy"])
    printed_energy = 100 * ((1 + printed.ENERGY_OVER["LC"]) / (1 + printed.ENERGY_OVER["SMC"]) - 1)
    return sum((a - b) ** 2 for a, b in zip(ours, said, strict=True)) + ((energy - printed_energy) / 6) ** 2


def _runs(
    study: Study, cases: Mapping[tuple[str, int], Mapping[str, object]]
) -> dict[tuple[str, int], dict[str, float]]:
    jobs = []
    for case, changes in cases.items():
        scenario = study.scenario(Key("reference", REFERENCE[0], STEP, 0, case[0], 0)).changed(changes)
        jobs.append(Job(case, scenario, study.scenarios))
    return run_all(jobs, study.fmus, numbers, study.workers)


def search(misfit: Misfit, start: Values, tries: int, rng: np.random.Generator) -> tuple[Values, float]:
    """Return the best of `tries` random steps from `start`, each from the best so far, and its misfit.

    A step multiplies each value, with probability one half, by a log-normal factor, whose spread grows with each success
    and shrinks with each failure.
    """
    best, least, spread = start, misfit(start), 0.1
    for _ in range(tries):
        tried = best * np.exp(spread * rng.standard_normal(len(best)) * (rng.random(len(best)) < 0.5))
        value = misfit(tried)
        if value < least:
            best, least, spread = tried, value, min(0.25, 1.15 * spread)
        else:
            spread = max(0.01, 0.99 * spread)
    return best, least


def random_start(misfit: Misfit, ranges: Sequence[tuple[float, float]], tries: int, rng: np.random.Generator) -> Values:
    """Return the best of `tries` values drawn log-uniform from `ranges`; raise UserError where all have no misfit."""
    low, high = np.log(np.array(ranges)).T
    drawn = [np.exp(rng.uniform(low, high)) for _ in range(tries)]
    misfits = [misfit(values) for values in drawn]
    if not np.isfinite(min(misfits)):
        raise UserError(f"none of {tries} random starts keeps the pendulum; try more")
    return drawn[int(np.argmin(misfits))]


def main(arguments: Sequence[str] | None = None) -> int:
    """Search and print what was found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("swing-up", "smc"))
    parser.add_argument("--tries", type=int, default=200, help="steps of the search (%(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the search (%(default)s)")
    parser.add_argument("--from-random", type=int, metavar="N", help="start from the best of N random ones")
    parser.add_argument("--folder", type=Path, default=Path("results/paper"), help="a study's folder (%(default)s)")
    given = parser.parse_args(arguments)
    study = Study(given.folder, given.folder / "fmus", QUICK)
    describe(study.fmus / study.base.controller.fmu)  # says what is missing before anything is written
    study.prepare()
    rng = np.random.default_rng(given.seed)
    if given.what == "swing-up":
        names, ranges = tuple(SWING_UP_RANGES), tuple(SWING_UP_RANGES.values())
        used = np.array([float(study.base.controller.start[name]) for name in names])
    else:
        names, ranges, used = SMC_NAMES, SMC_RANGES, np.array(SMC_USED)

    def misfit(values: Values) -> float:
        return swing_up_misfit(study, values) if given.what == "swing-up" else smc_misfit(study, values)

    start = used if given.from_random is None else random_start(misfit, ranges, given.from_random, rng)
    best, least = search(misfit, start, given.tries, rng)
    print(f"misfit: {misfit(used):.3f} in use, {least:.3f} found in {given.tries} tries")
    for name, value, better in zip(names, used, best, strict=True):
        print(f"  {name:28} {value:10.4g} {better:10.4g}")
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except UserError as error:
        sys.exit(f"error: {error}")
