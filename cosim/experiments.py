"""The comparison of the three laws in a scenario, over draws of the encoders' offsets."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from filing.files import staging, write_file
from fmu_export.errors import UserError
from fmu_export.reading import read_json

from .campaign import Job, run_all
from .draws import Estimate, change, drawn, mean, rms_change, root_mean_square
from .master import Coupling
from .metrics import NAMES, QUANTITIES, WINDOW, ZERO, Metrics, evaluate, kept_upright, missing_signals
from .results import Result
from .scenario import Scenario, build_system, run_scenario

LAWS = ("LC", "SMC", "IHC")
ABOUT = "comparison.json"

SHOWN = tuple(name for name in NAMES if name not in ("steady_trend", "captures"))
"""The metrics of which a comparison states means."""

UNSTEADY = 0.25
"""Share of draws without a steady state above which a mean over the window is flagged; single runs are wrongly so in a few
of a hundred."""

FORMAT = "qube-ihc comparison 1"


@dataclass(frozen=True)
class Draw:
    """One run of a comparison: its law, the draw's number (None: the scenario as it stands), whether the law took over once
    and kept the pendulum upright, the metrics.
    """

    law: str
    number: int | None
    kept: bool
    metrics: Metrics


@dataclass(frozen=True)
class Comparison:
    """All draws of a scenario, and each law's full result of a typical draw, for the pictures.

    The typical draw is the one whose steady-state RMS is the median for the first law: the draw is the same for all laws,
    and chosen by the law that the others are compared with.
    """

    scenario: Scenario
    draws: tuple[Draw, ...]
    results: dict[str, Result]

    @cached_property
    def of_law(self) -> dict[str, dict[int | None, Draw]]:
        """The draws by law and number."""
        found: dict[str, dict[int | None, Draw]] = {}
        for draw in self.draws:
            found.setdefault(draw.law, {})[draw.number] = draw
        return found

    @property
    def count(self) -> int:
        """Number of draws of each law."""
        return len(self.draws) // len(self.of_law)

    def counted(self, law: str) -> list[Draw]:
        """Return the draws that the means are over: those in which the law kept the pendulum upright, all if in none."""
        draws = list(self.of_law[law].values())
        return [d for d in draws if d.kept] or draws

    def kept(self, law: str) -> int:
        """Return in how many draws the law kept the pendulum upright."""
        return sum(d.kept for d in self.of_law[law].values())

    def never(self, law: str, name: str) -> int:
        """Return how many of the counted draws do not have the metric: they never settled."""
        return sum(math.isnan(getattr(d.metrics, name)) for d in self.counted(law))

    def steady(self, law: str) -> bool:
        """Return whether the window at the end is a steady state, in at least three quarters of the counted draws."""
        draws = self.counted(law)
        return sum(not d.metrics.steady for d in draws) <= UNSTEADY * len(draws)

    def value(self, law: str, name: str) -> Estimate:
        """Return a metric's mean (of steady_rms, the root mean square) over the counted draws, with its interval.

        A draw that never settles or captures counts the run's duration. NaN where all do, or one has no number.
        """
        draws = self.counted(law)
        if self.never(law, name) == len(draws):
            return Estimate(math.nan)
        values = np.array([self._number(d, name) for d in draws])
        return root_mean_square(values) if QUANTITIES[name].over_draws == "rms" else mean(values)

    def change(self, law: str, base: str, name: str) -> Estimate:
        """Return by which part the metric's mean with `law` lies above that with `base`, over the draws that both count.

        NaN where there is no such draw, one of them has no value at all, or no steady state to compare: none, or zero.
        """
        quantity = QUANTITIES[name]
        numbers = [{d.number: self._number(d, name) for d in self.counted(one)} for one in (law, base)]
        both = [n for n in numbers[0] if n in numbers[1]]
        none = any(self.never(one, name) == len(self.counted(one)) for one in (law, base))
        if none or (quantity.of_window and not (self.steady(law) and self.steady(base))):
            return Estimate(math.nan)
        values, bases = (np.array([of[n] for n in both]) for of in numbers)
        if name == "steady_rms" and max(np.max(values, initial=0.0), np.max(bases, initial=0.0)) < ZERO:
            return Estimate(math.nan)
        return rms_change(values, bases) if quantity.over_draws == "rms" else change(values, bases)

    def _number(self, draw: Draw, name: str) -> float:
        value = float(getattr(draw.metrics, name))
        return self.scenario.run.duration if math.isnan(value) and QUANTITIES[name].never else value

    def remarks(self) -> list[str]:
        """Return what has to be known to read the means."""
        said = []
        laws = list(self.of_law)
        lost = {law: self.count - self.kept(law) for law in laws}
        if any(lost.values()):
            several = ", ".join(f"{law} {n}" for law, n in lost.items())
            said.append(f"pendulum lost, and not in the means unless in all draws: {several} of {self.count}")
        late = {law: self.never(law, "settling_time") for law in laws}
        if self.count > 1 and any(late.values()):
            several = ", ".join(f"{law} {n}" for law, n in late.items())
            said.append(f"never settled, counted as {self.scenario.run.duration:g} s: {several} of {self.count}")
        loose = [law for law in laws if not self.steady(law)]
        if loose:
            said.append(
                f"* not steady: |q| of {', '.join(loose)} has a trend over the last {WINDOW:g} s, or the run is shorter; "
                "make run.duration longer"
            )
        return said

    def save(self, folder: Path, pictures: Callable[[Path], object] | None = None) -> None:
        """Write each law's result, all draws as comparison.csv, what `pictures` writes to a folder, and comparison.json.

        The last has the means, and under `files` the SHA-256 of each of the others. They reach `folder` together, and
        what an earlier comparison has left there and this one does not replace is removed.
        """
        earlier = _files_of(folder / ABOUT)
        with staging(folder, last=ABOUT) as place:
            self._save(place)
            if pictures is not None:
                pictures(place)
            about = {**self.about(), "files": _digests(place)}
            write_file(place / ABOUT, json.dumps(about, indent=1) + "\n")
        for name in earlier.keys() - about["files"].keys():
            if _sha256(folder / name) == earlier[name]:
                (folder / name).unlink()

    def _save(self, folder: Path) -> None:
        for law, result in self.results.items():
            result.save(folder / f"{law}.csv")
        offsets = ("theta_encoder_offset", "delta_encoder_offset")
        lines = [",".join(["law", "draw", *offsets, "kept", *NAMES])]
        for d in self.draws:
            start = self.scenario.plant.start if d.number is None else drawn(self.scenario, d.number).plant.start
            about = ["" if d.number is None else str(d.number), *(str(start.get(name, "")) for name in offsets)]
            lines.append(",".join([d.law, *about, str(int(d.kept)), *(repr(getattr(d.metrics, n)) for n in NAMES)]))
        write_file(folder / "comparison.csv", "\n".join(lines) + "\n")

    def about(self) -> dict[str, Any]:
        """Return the means, their intervals and the changes from the first law on, safe for JSON."""
        base, *others = self.of_law
        laws: dict[str, Any] = {}
        for law in self.of_law:
            laws[law] = {name: _pair(self.value(law, name)) for name in SHOWN}
            laws[law] |= {"kept": self.kept(law), "steady": self.steady(law)}
            laws[law]["never_settled"] = self.never(law, "settling_time")
        return {
            "format": FORMAT,
            "scenario": self.scenario.model_dump(mode="json"),
            "draws": self.count,
            "laws": laws,
            "change": {law: {name: _pair(self.change(law, base, name)) for name in SHOWN} for law in others},
            "remarks": self.remarks(),
        }


def _digests(folder: Path) -> dict[str, str]:
    return {path.name: _sha256(path) for path in sorted(folder.iterdir())}


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""


def _files_of(path: Path) -> dict[str, str]:
    """Return the digests by plain names that an earlier comparison.json holds; none where there is no such thing."""
    try:
        files = read_json(path, "comparison")["files"]
        return {str(name): str(digest) for name, digest in files.items() if Path(name).name == name}
    except (UserError, LookupError, TypeError, AttributeError):  # not there, or another's: nothing of it is ours
        return {}


def _pair(estimate: Estimate) -> list[float | None]:
    return [None if math.isnan(v) else v for v in (estimate.value, estimate.half_width)]


@dataclass(frozen=True)
class Study:
    """A scenario, the folder of its file, and the number of draws; 0: once, as it stands."""

    scenario: Scenario
    folder: Path
    draws: int = 0

    @property
    def numbers(self) -> Sequence[int | None]:
        """The draws' numbers."""
        return range(1, self.draws + 1) if self.draws else [None]

    def at(self, law: str, number: int | None) -> Scenario:
        """Return the scenario of a law and draw."""
        scenario = self.scenario if number is None else drawn(self.scenario, number)
        return scenario.changed({"controller.start.law": law})


def check_outputs(scenario: Scenario, fmus: Path, folder: Path | None) -> None:
    """Raise UserError for a system that cannot be coupled, or whose FMUs lack outputs that the metrics need."""
    missing = missing_signals(Coupling(build_system(scenario, fmus, folder)).checked_outputs(scenario.record.outputs))
    if missing:
        raise UserError(
            f"the metrics need {', '.join(missing)}, which the FMUs in {fmus} do not have as outputs, or the scenario does "
            "not record; `export --outputs` can name them"
        )


def compare(
    studies: Sequence[Study],
    fmus: Path,
    laws: Sequence[str] = LAWS,
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Comparison]:
    """Run every law in every study with every draw, in `workers` threads (None: one per core).

    All laws of a study see the same encoder offsets and noise. `progress(done, total)` counts runs. Raises what a run
    raises; on that, and on Ctrl-C, runs that have not begun are dropped and running ones stopped.
    """
    for study in studies:  # says what cannot work before anything runs
        check_outputs(study.scenario, fmus, study.folder)
    jobs = [
        Job((s, law, number), study.at(law, number).changed({"record.every": 1}), study.folder)
        for s, study in enumerate(studies)
        for number in study.numbers
        for law in laws
    ]
    found = run_all(jobs, fmus, lambda result: (kept_upright(result), evaluate(result)), workers, progress)
    comparisons = []
    for s, study in enumerate(studies):
        draws = tuple(Draw(law, n, *found[s, law, n]) for law in laws for n in study.numbers)
        ranked = sorted((d for d in draws if d.law == laws[0]), key=lambda d: d.metrics.steady_rms)
        typical = ranked[len(ranked) // 2].number
        results = {law: run_scenario(study.at(law, typical), fmus, study.folder) for law in laws}
        comparisons.append(Comparison(study.scenario, draws, results))
    return comparisons
