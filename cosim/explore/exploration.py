"""A scenario as it is set on a page: run with its laws, told in curves and numbers, written as a file."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from filing.files import staging, write_file
from fmu_export.errors import UserError
from ihc_fmu.design import Design
from ihc_fmu.inverse import inverse_design
from ihc_fmu.options import Options
from ihc_fmu.pendulum.kalman import KalmanOptions
from ihc_fmu.pendulum.start_values import design_values, kalman_values

from .. import parameter_files
from ..fmu import FmuError
from ..fmu_files import start_values_of
from ..judged_signals import evaluation_in, kept_upright, overflow
from ..metric_meanings import MetricMeaning, is_pendulum
from ..metrics import Metrics, evaluate, evaluate_alike, unsteady
from ..names import is_plain
from ..prepared import Prepared
from ..report.charts import Plots
from ..results import Result, SimulationError
from ..rig import Progress
from ..scenario import Scenario
from ..scenario_files import files
from ..scenario_run import run_scenario, with_tolerances
from ..scenario_system import build_system
from ..studies.estimates import MeanEstimate, change_text
from ..studies.experiments import LAW, check_outputs, laws_of
from ..tables import side_by_side
from ..wiring import CONTROLLER
from .adjustables import KALMAN, MU, SCALE, groups_of, pendulum_design, with_disturbance

MOST_ROWS = 1200
"""Of a curve: two for each of some hundred columns of pixels, the smallest and the largest value in them."""

START = f"{CONTROLLER}.start."

FMUS = Path("fmus")
"""Where `run` looks for FMUs unless it is told another folder."""

PATIENCE = 0.1
"""Seconds that a run goes on though it is not wanted any more, so that something is seen while a slider moves."""

UNTOLD = ("trend", "captures")
"""Metrics that are not in the table: what they say is said in a sentence, or in its last row."""

USUAL = ("LC", "IHC")
"""The laws that are shown at first."""


class NotWantedError(Exception):
    """A run was given up for a later one."""


@dataclass(frozen=True)
class Outcome:
    """What the page shows: what its script draws, the table of metrics, sentences, and how long the runs took [s]."""

    drawn: Mapping[str, Any]
    headings: Sequence[str]
    rows: Sequence[Sequence[str]]
    notes: Sequence[str]
    seconds: float


class Exploration:
    """A scenario with its FMUs, and the values that are set on the page; the same for all pages of a server.

    `unpacked`: the FMUs are an SSP file's, and do not outlast this process. Raises UserError for a scenario that cannot be
    run or judged.
    """

    def __init__(self, scenario: Scenario, folder: Path, fmus: Path, *, unpacked: bool = False) -> None:
        self.folder, self.fmus, self.unpacked = folder, fmus, unpacked
        check_outputs(scenario, fmus, folder)
        self.laws = _laws(scenario, fmus, folder)
        self.shown = [law for law in self.laws if law in USUAL] or self.laws[:2]
        self.design = pendulum_design(scenario, fmus, folder)
        self.base = with_disturbance(with_tolerances(scenario, fmus, folder), fmus, folder)
        self.values: dict[str, Any] = {}
        components = build_system(self.base, fmus, folder).components
        started = (c for c in components if c.name == CONTROLLER)
        self._controller = next(({**start_values_of(c.path), **c.start} for c in started), {})
        self._closed, self._busy = threading.Event(), threading.Lock()
        self._prepared = {law: Prepared(_with_law(self.base, law), fmus, folder) for law in self.laws}
        self._designs: dict[float, Design] = {}
        peak, self._slow = self._first_run()
        self._pool = ThreadPoolExecutor(
            1 if self._slow else len(self.laws)
        )  # Python runs one at a time, two in turns slower
        self.groups = groups_of(self.base, fmus, folder, self.design, peak)

    def _first_run(self) -> tuple[float, bool]:
        """Return the largest control of a run as the scenario stands, 0 where that fails; and whether Python runs it."""
        try:
            result = run_scenario(self.base, self.fmus, self.folder)
        except (SimulationError, FmuError):
            return 0.0, False
        metrics = evaluate(result)
        peaks = [metrics.values[q.name] for q in metrics.quantities.values() if q.role == "peak"]
        return next((peak for peak in peaks if math.isfinite(peak)), 0.0), result.metadata["engine"] == "fmpy"

    def end(self) -> None:
        """Let what runs end soon; nothing is run any more."""
        self._closed.set()

    def scenario(self) -> tuple[Scenario, Design | None]:
        """Return the scenario as it is set, and the design that its controller then has where that is not its own."""
        scenario = self.base.changed(self._entries())
        mu, scale = (self.values.get(name) for name in (MU, SCALE))
        if self.design is None or (mu is None and scale is None):
            return scenario, None
        solved = self.design if mu is None else self._solved(mu)
        return scenario, solved.scaled_to(u_max=float(self.design.u_max[0]) if scale is None else scale)

    def _entries(self) -> dict[str, Any]:
        """Return the entries of the scenario that are set, noises by the Kalman filter's gain; without a design's."""
        noises = {name.removeprefix(KALMAN): v for name, v in self.values.items() if name.startswith(KALMAN)}
        entries = {
            name: v for name, v in self.values.items() if name not in (MU, SCALE) and not name.startswith(KALMAN)
        }
        if not noises:
            return entries
        own = {name.removeprefix(START): value for name, value in entries.items() if name.startswith(START)}
        known = {**self._controller, **own}
        nominal = {name: value for name, value in known.items() if name.startswith("nominal_")}
        gain = kalman_values(nominal, float(known["sample_time"]), KalmanOptions(**noises))
        return {f"{START}{name}": value for name, value in gain.items()} | entries

    def _solved(self, mu: float) -> Design:
        """Return the design with another mu, for the same linear controller and decay."""
        if mu not in self._designs:
            assert self.design is not None
            self._designs[mu] = inverse_design(self.design.system, Options(mu=mu, alpha=self.design.alpha, u_max=1.0))
        return self._designs[mu]

    def outcome(self, wanted: Callable[[], bool]) -> Outcome:
        """Run the scenario as it is set with each law that is shown; return what there is to see.

        Raises UserError, SimulationError and FmuError as a run, and NotWantedError soon after `wanted` says no.
        """
        with self._busy:
            begin = time.monotonic()

            def progress(_done: int, _total: int) -> None:
                late = time.monotonic() - begin > PATIENCE and not wanted()
                if late or self._closed.is_set():
                    raise NotWantedError

            results = self._run(self.shown, self._changes(), progress)
            return _seen(results, time.monotonic() - begin, self._slow)

    def _changes(self) -> dict[str, Any]:
        """Return what is set as changes of the scenario, a design by the start values that it decides."""
        scenario, design = self.scenario()
        if design is None:
            return self._entries()
        own = scenario.controller.start
        start = {**design_values(design, None, float({**self._controller, **own}["voltage_limit"])), **own}
        return {f"{START}{name}": value for name, value in start.items()} | self._entries()

    def _run(self, laws: Sequence[str], changes: Mapping[str, Any], progress: Progress) -> dict[str, Result]:
        """Run the laws, at the same time where C runs them; return their results, or raise what the first one raises."""
        running = {law: self._pool.submit(self._prepared[law].run, changes, progress) for law in laws}
        wait(running.values())
        return {law or self.base.name: _named(future.result(), law) for law, future in running.items()}

    def write(self, name: str, folder: Path = Path()) -> str:
        """Write the scenario as it is set to the folder, with what lies beside it; return in a sentence how it is run.

        Raises UserError for a name that is none of a file's, and for files that must stay.
        """
        stem = name.strip().removesuffix(".toml")
        if not is_plain(stem):
            raise UserError(f"the name must be a plain one of a file (no path, not empty), found {name!r}")
        scenario, design = self.scenario()
        used = files(scenario, self.fmus, self.folder)
        fmus = [path for path in used.fmus.values() if self.unpacked or path.parent.absolute() != self.fmus.absolute()]
        parameters = parameter_files.file_of(scenario.plant.parameters, self.folder)
        beside = {*fmus, *used.tables.values(), parameters, used.design if design is None else None} - {None}
        with staging(folder) as place:
            for path in beside:
                _copy(path, folder / path.name, place / path.name)
            if design is not None:
                design.save(place / f"{stem}.json")
                scenario = scenario.changed({"controller.design": f"{stem}.json"})
            write_file(place / f"{stem}.toml", scenario.to_toml())
        elsewhere = "" if len(fmus) == len(used.fmus) or self.fmus == FMUS else f" --fmus {self.fmus}"
        return f"wrote {(folder / stem).absolute()}.toml; it runs by: qube-ihc run {stem}.toml{elsewhere}"


def pictures_of(scenario: Scenario, results: Path = Path("results")) -> list[Path]:
    """Return the pictures of the scenario's maps and tunings that lie in the results."""
    return [path for kind in ("region", "tune") for path in sorted((results / f"{kind}_{scenario.name}").glob("*.png"))]


def _laws(scenario: Scenario, fmus: Path, folder: Path) -> list[str]:
    """Return the controller's laws; one without a name where it has none."""
    try:
        return laws_of(scenario, fmus, folder)
    except UserError:  # another's controller: it is shown as it stands
        return [""]


def _with_law(scenario: Scenario, law: str) -> Scenario:
    return scenario.changed({LAW: law}) if law else scenario


def _named(result: Result, law: str) -> Result:
    """Return a result with its law, which decides colours, and without the norm, which is not recorded."""
    judged = evaluation_in(result).model_copy(update={"norm": None})
    return replace(result, judged_by=judged, metadata={"start_values": {CONTROLLER: {"law": law}}, **result.metadata})


def _seen(results: Mapping[str, Result], seconds: float, slow: bool) -> Outcome:
    metrics = evaluate_alike(results)
    plots = Plots(results)
    plots.add_judged()
    drawn, _ = plots.data(dict.fromkeys(results, ""), MOST_ROWS)
    for chart, of in zip(drawn["charts"], plots.charts, strict=True):
        chart |= {"text": plots.text(of), "remark": of.remark}
    base, *others = results
    quantities = metrics[base].quantities
    table = zip(quantities.values(), side_by_side(list(metrics.values())), strict=True)
    rows = [
        [*row, *(_change(metrics[law], metrics[base], q) for law in others)] for q, row in table if q.role not in UNTOLD
    ]
    kept = ("yes" if kept_upright(result) else "no" for result in results.values())
    rows.append(["kept upright" if is_pendulum(quantities) else "acting to the end", *kept, *("" for _ in others)])
    notes = [f"{law}: {text}" for law, result in results.items() for text in overflow(result)]
    notes += [f"* {law}: {why}" for law, m in metrics.items() if (why := unsteady(m))]
    if slow:
        notes.append("an FMU in Python, or for model exchange, answers slowly")
    headings = ["", *results, *(f"{law} over {base}" for law in others)]
    return Outcome(drawn, headings, rows, [*notes, f"computed in {1e3 * seconds:.0f} ms"], seconds)


def _change(metrics: Metrics, base: Metrics, q: MetricMeaning) -> str:
    """Return by which part a metric lies above the base's; empty where that says nothing."""
    value, below = metrics.values[q.name], base.values[q.name]
    unsteady_window = q.of_window and not (metrics.steady and base.steady)
    if q.role == "capture" or unsteady_window or math.isnan(value) or not below > q.zero:
        return ""
    return change_text(MeanEstimate(value / below - 1.0))


def _copy(path: Path, last: Path, place: Path) -> None:
    """Copy a file to `place`, from where it becomes `last`; raises UserError where that is another file."""
    content = path.read_bytes()
    if last.is_file() and last.read_bytes() != content:
        raise UserError(f"{last} is another file than {path}, which the scenario needs beside it, and stays")
    if not last.is_file():
        write_file(place, content)
