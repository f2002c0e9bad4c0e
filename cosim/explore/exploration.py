"""A scenario as it is set on a page: run with its laws, told in curves and numbers, written as a file."""

from __future__ import annotations

import math
import shlex
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from filing.files import staging, write_file
from fmu_export.errors import UserError

from ..fmu import FmuError
from ..judged_signals import evaluation_in, kept_upright, overflow
from ..metric_meanings import QUANTITIES, MetricMeaning, kept_words, quantities_of
from ..metrics import Metrics, evaluate, evaluate_alike, unsteady
from ..names import is_plain
from ..prepared import Prepared
from ..remarks import remarks_before
from ..report.charts import Plots
from ..results import Result, SimulationError
from ..rig import Progress
from ..scenario import Scenario
from ..scenario_files import portable
from ..scenario_run import run_scenario, with_tolerances
from ..scenario_system import build_system, evaluation
from ..studies.estimates import MeanEstimate, change_text
from ..studies.experiments import LAW, check_outputs, laws_of
from ..studies.tunables import MU, Setting
from ..tables import side_by_side
from ..wiring import CONTROLLER
from .adjustables import Adjustable, controller_of, decided, groups_of, with_disturbance
from .maps import commands_of

MOST_ROWS = 1200
"""Of a curve: two for each of some hundred columns of pixels, the smallest and the largest value in them."""

START = f"{CONTROLLER}.start."

SEED = "run.seed"
NEAR = 0.99
"""Of the mu that is solved for first, times the design's."""

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
    """What the page shows: what its script draws, the table, sentences; each law's metrics, the time of the runs [s]."""

    drawn: Mapping[str, Any]
    headings: Sequence[str]
    rows: Sequence[Sequence[str]]
    notes: Sequence[str]
    metrics: Mapping[str, Mapping[str, float]]
    seconds: float


@dataclass
class Wanted:
    """What is set on a page: values by their entries, and the laws that are shown."""

    laws: list[str]
    values: dict[str, Any] = field(default_factory=dict)

    def copy(self) -> Wanted:
        """Return the same, which stays when this is changed."""
        return Wanted([*self.laws], {**self.values})


class Exploration:
    """A scenario with its FMUs, and what can be set of it; for all pages of a server, each of which wants its own.

    `last`: what was set last on any of them, with which another page begins. `arguments`: by which commands find the
    scenario and its FMUs. Raises UserError for a scenario that cannot be run or judged.
    """

    def __init__(self, scenario: Scenario, folder: Path, fmus: Path, arguments: Sequence[str] = ()) -> None:
        self.folder, self.fmus = folder, fmus
        check_outputs(scenario, fmus, folder)
        self.laws = _laws(scenario, fmus, folder)
        self.last = Wanted([law for law in self.laws if law in USUAL] or self.laws[:2])
        self.controller = controller_of(scenario, fmus, folder)
        self.base = with_disturbance(with_tolerances(scenario, fmus, folder), fmus, folder)
        self._closed, self._busy = threading.Event(), threading.Lock()
        self._prepared = {law: Prepared(_with_law(self.base, law), fmus, folder) for law in self.laws}
        peak, self.slow = self._first_run()
        self._pool = ThreadPoolExecutor(
            1 if self.slow else len(self.laws)
        )  # Python runs one at a time, two in turns slower
        self.groups = groups_of(self.base, fmus, folder, self.controller, peak)
        self.members: dict[str, Adjustable] = {m.entry: m for group in self.groups for m in group.members}
        judged = evaluation(self.base, fmus, folder)
        self.quantities = QUANTITIES if judged is None else quantities_of(judged)
        self.commands = commands_of(self.groups, self.quantities, self.laws, arguments)

    def _first_run(self) -> tuple[float, bool]:
        """Return the largest control of a run as the scenario stands, 0 where that fails; and whether Python runs it."""
        try:
            result = run_scenario(self.base, self.fmus, self.folder)
        except (SimulationError, FmuError):
            return 0.0, False
        metrics = evaluate(result)
        peaks = [metrics.values[q.name] for q in metrics.quantities.values() if q.role == "peak"]
        return next((peak for peak in peaks if math.isfinite(peak)), 0.0), result.metadata["engine"] == "fmpy"

    def warm(self) -> None:
        """Solve a design, where that can be: what it needs is loaded then, so that the first one on a page is not late."""
        if self.controller is not None and self.controller.redesigned:
            with suppress(UserError):  # another mu need not have a proof
                self.controller.setting({MU: NEAR * self.controller.start[MU]})

    def end(self) -> None:
        """Let what runs end soon; nothing is run any more."""
        self._closed.set()

    def changes(self, values: Mapping[str, Any]) -> tuple[dict[str, Any], Setting | None]:
        """Return values as changes of the scenario, and what those that are no entries of it make of the controller.

        Of what a design decides, the start values that the scenario or the page gives stay. Raises UserError where no design
        is proven.
        """
        entries = {name: value for name, value in values.items() if name not in self._decided}
        if SEED in entries:  # a run takes it unchecked
            self.base.changed({SEED: entries[SEED]})
        chosen = {name: values[entry] for entry, name in self._decided.items() if entry in values}
        if self.controller is None or not chosen:
            return entries, None
        own = {name.removeprefix(START): v for name, v in entries.items() if name.startswith(START)}
        numbers = {name: float(v) for name, v in own.items() if isinstance(v, int | float)}
        setting = self.controller.setting({**numbers, **chosen})
        kept = {f"{START}{name}" for name in self.base.controller.start} - setting.plain.keys()
        return {name: v for name, v in setting.changes.items() if name not in kept} | entries, setting

    @cached_property
    def _decided(self) -> dict[str, str]:
        """The names of the numbers on the page that decide start values, by their entries."""
        names = (m.entry.rpartition(".")[2] for m in self.members.values())
        return {decided(name): name for name in names if decided(name) in self.members}

    def outcome(self, asked: Wanted, wanted: Callable[[], bool]) -> Outcome:
        """Run the scenario with each law and the values that are asked for; return what there is to see.

        Raises UserError, SimulationError and FmuError as a run, and NotWantedError soon after `wanted` says no.
        """
        with self._busy:
            begin = time.monotonic()

            def progress(_done: int, _total: int) -> None:
                late = time.monotonic() - begin > PATIENCE and not wanted()
                if late or self._closed.is_set():
                    raise NotWantedError

            changes, _ = self.changes(asked.values)
            results = self._run(asked.laws, changes, progress)
            return _seen(results, time.monotonic() - begin, self.slow)

    def _run(self, laws: Sequence[str], changes: Mapping[str, Any], progress: Progress) -> dict[str, Result]:
        """Run the laws, at the same time where C runs them; return their results, or raise what the first one raises."""
        running = {law: self._pool.submit(self._prepared[law].run, changes, progress) for law in laws}
        wait(running.values())
        return {law or self.base.name: _named(future.result(), law) for law, future in running.items()}

    def write(self, name: str, values: Mapping[str, Any], folder: Path = Path()) -> str:
        """Write the scenario with values to the folder, with what lies beside it; return in a sentence how it is run.

        Raises UserError for a name that is none of a file's, and for files that must stay.
        """
        stem = name.strip().removesuffix(".toml")
        if not is_plain(stem):
            raise UserError(f"the name must be a plain one of a file (no path, not empty), found {name!r}")
        changes, setting = self.changes(values)
        own = None if self.controller is None else self.controller.design
        design = None if setting is None or setting.design is own else setting.design
        named = self.controller is not None and self.controller.pendulum and design is not None
        if named and setting is not None:  # the pendulum's controller takes the rest from the design's file
            changes = {**setting.plain, **{entry: v for entry, v in values.items() if entry not in self._decided}}
            changes["controller.design"] = None
        asked = self.base.changed(changes)
        remarks_before(build_system(asked, self.fmus, self.folder), asked)  # raises UserError as a run would
        moved, beside = portable(asked, self.fmus, self.folder)
        with staging(folder) as place:
            for file, path in beside.items():
                _copy(path, folder / file, place / file)
            if design is not None:
                design.save(place / f"{stem}.json")
            scenario = moved.changed({"controller.design": f"{stem}.json"}) if named else moved
            write_file(place / f"{stem}.toml", scenario.to_toml())
        alone = all(part.fmu in beside for part in scenario.parts.values())
        elsewhere = "" if alone or self.fmus == FMUS else f" --fmus {shlex.quote(str(self.fmus))}"
        return f"wrote {(folder / stem).absolute()}.toml; it runs by: qube-ihc run {shlex.quote(f'{stem}.toml')}{elsewhere}"


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
    rows.append([kept_words(quantities), *kept, *("" for _ in others)])
    notes = [f"{law}: {text}" for law, result in results.items() for text in overflow(result)]
    notes += [f"* {law}: {why}" for law, m in metrics.items() if (why := unsteady(m))]
    if slow:
        notes.append("an FMU in Python, or for model exchange, answers slowly")
    headings = ["", *results, *(f"{law} over {base}" for law in others)]
    notes.append(f"computed in {1e3 * seconds:.0f} ms")
    return Outcome(drawn, headings, rows, notes, {law: m.values for law, m in metrics.items()}, seconds)


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
