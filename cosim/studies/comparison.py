"""What a comparison of laws, or of other choices, has come to: means over the draws, changes, tables, files."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from filing.files import write_file
from fmu_export.files import FilePath
from ihc_fmu.arguments import check_among

from ..judged_signals import overflow
from ..metric_meanings import WINDOW, MetricMeaning, kept_words, lost_words, measure_of
from ..metrics import Metrics
from ..results import Result
from ..scenario import Scenario
from ..tables import mark
from .described import csv_row, pair, save_described
from .draws import PENDULUM, Chance, drawn
from .estimates import MeanEstimate, change_of, change_text, estimate_text, mean, root_mean_square

if TYPE_CHECKING:
    from ihc_fmu.design import Design

    from ..plots import Picture

CONTENTS = "comparison.json"

UNSTEADY = 0.25
"""Share of draws without a steady state above which a mean over the window is flagged; single runs are wrongly so in a few
of a hundred."""

FORMAT = "qube-ihc comparison 1"


@dataclass(frozen=True)
class Draw:
    """One run of a comparison: its law, the draw's number (None: the scenario as it stands), whether the law took over once
    and acted to the end, the metrics.
    """

    law: str
    number: int | None
    kept: bool
    metrics: Metrics


@dataclass(frozen=True)
class Comparison:
    """All draws of a scenario, and each law's full result of a typical draw, for the pictures.

    The typical draw is the one whose steady-state RMS is the median for the first law: the draw is the same for all laws,
    and chosen by the law that the others are compared with. Means are over the draws in which the law took over once and
    acted to the end, over all where there is none such.

    Parameters
    ----------
    scenario
        What was run, as it stands.
    draws
        One for each run: `law`, `number` of the draw (None: the scenario as it stands), `kept` (whether the law acted to
        the end), `metrics`.
    results
        The whole result of the typical draw by law.
    chance
        What was drawn: `offsets`, names of the plant's start values, and `noise`.

    Examples
    --------
    >>> import cosim
    >>> tilted = {"plant.start.angle_0": 0.1, "run.duration": 8.0}
    >>> compared = cosim.compare("fmus/arm.ssp", ["LC", "IHC"], tilted)
    >>> settling = "settling_time[plant.angle]"
    >>> [round(compared.value(law, settling).value, 2) for law in compared.results]
    [2.92, 1.48]
    >>> round(compared.change("IHC", "LC", settling).value, 2)
    -0.49
    >>> compared.count, compared.kept("IHC"), compared.unsettled("IHC"), compared.steady("IHC")
    (1, 1, 0, True)
    >>> for title, headings, rows in compared.tables():
    ...     print(title, headings, rows[0])
    arm: one run ['', 'LC', 'IHC'] ['settling |e angle| [s]', '2.915', '1.477']
    arm: over LC ['', 'IHC'] ['settling |e angle|', '-49.3 %']
    >>> compared.remarks()
    ['nothing is left to chance: the plant has neither encoder offsets nor noise, so one run says all']
    >>> compared.overflows(), compared.summary()["laws"]["IHC"]["steady"]
    ([], True)
    >>> len(compared.plot().axes), compared.report("compared.html").name
    (6, 'compared.html')
    >>> compared.save("compared")
    """

    scenario: Scenario
    draws: tuple[Draw, ...]
    results: dict[str, Result]
    chance: Chance = PENDULUM

    def __repr__(self) -> str:
        return f"<Comparison: {self.scenario.name}, {', '.join(self.results)}, runs of each: {self.count}>"

    def _repr_html_(self) -> str:
        """Return what `compare` prints as tables, for notebooks."""
        from html import escape  # noqa: PLC0415

        from ihc_fmu.html import html_table  # noqa: PLC0415

        remarks = "".join(f"<p>{escape(remark)}</p>" for remark in self.remarks())
        return "".join(html_table(*table) for table in self.tables()) + remarks

    def _means(self) -> list[list[str]]:
        """Return a row for each metric with a cell for each law, and one for the draws in which the law acted to the end."""
        rows = []
        for q in (self.quantities[name] for name in self.shown):
            cells = []
            for law in self._of_law:
                value = self.value(law, q.name)
                cells.append(estimate_text(value, q.text) + mark(q, self.steady(law), value.value))
            rows.append([q.heading, *cells])
        kept = (f"{self.kept(law)} of {self.count}" for law in self._of_law)
        return [*rows, [kept_words(self.quantities), *kept]]

    def _changes(self) -> list[list[str]]:
        """Return a row for each metric with each other law's change over the first one's."""
        base, *others = self._of_law
        quantities = self.quantities
        names = [name for name in self.shown if quantities[name].role != "capture"]
        return [
            [quantities[name].symbol, *(change_text(self.change(law, base, name)) for law in others)] for name in names
        ]

    def tables(self) -> list[tuple[str, list[str], list[list[str]]]]:
        """Return the means, and by how much those of each law differ from the first one's, as tables of text.

        Returns
        -------
        list of (str, list of str, list of list of str)
            Title, headings and rows of each table.
        """
        name, count, (base, *others) = self.scenario.name, self.count, self._of_law
        drawn = (
            f"means ± 95 % interval over {count} draws of the encoders' offsets (steady RMS: root mean square)"
            if count > 1
            else "one run"
        )
        tables = [(f"{name}: {drawn}", ["", *self._of_law], self._means())]
        if others:
            drawn = ", in the same draws; ± 95 % interval" if count > 1 else ""
            tables.append((f"{name}: over {base}{drawn}", ["", *others], self._changes()))
        return tables

    def plot(self) -> Picture:
        """Draw what the laws are judged by, over each other, of the typical draw.

        Returns
        -------
        matplotlib.figure.Figure
            The picture; nothing is written.
        """
        from ..plots import errors_of  # noqa: PLC0415 - heavy

        return errors_of(self.results)

    def report(
        self,
        path: FilePath,
        *,
        notes: Sequence[str] = (),
        design: Design | None = None,
        folder: FilePath | None = None,
    ) -> Path:
        """Write a page about the comparison, HTML in one file: tables, remarks, plots to zoom into, what was run.

        Parameters
        ----------
        path
            The page, `*.html`.
        notes
            What is to be known besides the remarks.
        design
            The controller's design, whose certificate the page shows; None: no certificate.
        folder
            Where `save` writes the comparison to, to whose tables the page has links; None: no links.

        Returns
        -------
        pathlib.Path
            The page.

        Raises
        ------
        UserError
            Where it cannot be written, or would replace a file of somebody else.
        """
        from ..report.pages import Findings, Table, Verdict, write_results  # noqa: PLC0415 - heavy

        base, *others = self._of_law
        settling = sum(m.role == "settling" for m in self.quantities.values())
        roles = ("settling", "integral") if settling == 1 else ("settling",)
        verdicts = []
        for law in others:
            for meaning in (m for m in self.quantities.values() if m.role in roles):
                text = change_text(self.change(law, base, meaning.name))
                kind = {"better": "good", "worse": "bad"}.get(text.rpartition(" ")[2], "")
                verdicts.append(Verdict(text, f"{meaning.symbol}, {law} over {base}", kind))
        tables = [Table(title.partition(": ")[2], headings, rows) for title, headings, rows in self.tables()]
        return write_results(
            path,
            self.results,
            self.scenario.description or self.scenario.name,
            Findings(verdicts, tables, notes, self.remarks()),
            {} if folder is None else {law: Path(folder) / f"{law}.csv" for law in self.results},
            design,
        )

    @property
    def quantities(self) -> Mapping[str, MetricMeaning]:
        """The system's metrics by name."""
        return self.draws[0].metrics.quantities

    @property
    def shown(self) -> list[str]:
        """The names of the metrics of which means are stated."""
        return [name for name, q in self.quantities.items() if q.role not in ("trend", "captures")]

    @cached_property
    def _of_law(self) -> dict[str, dict[int | None, Draw]]:
        """The draws by law and number."""
        by_law: dict[str, dict[int | None, Draw]] = {}
        for draw in self.draws:
            by_law.setdefault(draw.law, {})[draw.number] = draw
        return by_law

    @property
    def count(self) -> int:
        """Number of draws of each law."""
        return len(self.draws) // len(self._of_law)

    def _counted(self, law: str) -> list[Draw]:
        """Return the draws that the means are over: those in which the law acted to the end, all if in none."""
        draws = self._draws_of(law)
        return [d for d in draws if d.kept] or draws

    def _draws_of(self, law: str) -> list[Draw]:
        check_among("law", law, self._of_law)
        return list(self._of_law[law].values())

    def kept(self, law: str) -> int:
        """Return in how many draws the law took over once and acted to the end.

        Parameters
        ----------
        law
            One of those compared.

        Returns
        -------
        int
            At most `count`.

        Raises
        ------
        UserError
            For another law.
        """
        return sum(d.kept for d in self._draws_of(law))

    def _never(self, law: str, name: str) -> int:
        """Return how many of the counted draws do not have the metric: a time of settling, for one."""
        return sum(math.isnan(d.metrics.values[name]) for d in self._counted(law))

    def steady(self, law: str) -> bool:
        """Return whether the window at the end is a steady state, in at least three quarters of the counted draws.

        Parameters
        ----------
        law
            One of those compared.

        Returns
        -------
        bool
            Whether the numbers over that window mean something.

        Raises
        ------
        UserError
            For another law.
        """
        draws = self._counted(law)
        return sum(not d.metrics.steady for d in draws) <= UNSTEADY * len(draws)

    def value(self, law: str, name: str) -> MeanEstimate:
        """Return a metric's mean (of steady_rms, the root mean square) over the counted draws, with its interval.

        A draw that never settles or captures counts the run's duration.

        Parameters
        ----------
        law
            One of those compared.
        name
            A metric's name, one of `quantities`.

        Returns
        -------
        MeanEstimate
            `value` and `half_width` of the 95 % interval, in the metric's unit; `half_width` is NaN for one draw, `value`
            where no draw ever settles or captures, or one has no number.

        Raises
        ------
        UserError
            For another law or metric.
        """
        check_among("metric", name, self.quantities)
        draws = self._counted(law)
        if self._never(law, name) == len(draws):
            return MeanEstimate(math.nan)
        values = np.array([self._number(d, name) for d in draws])
        return root_mean_square(values) if self.quantities[name].over_draws == "rms" else mean(values)

    def change(self, law: str, base: str, name: str) -> MeanEstimate:
        """Return by which part the metric's mean with `law` lies above that with `base`, over the draws that both count.

        Parameters
        ----------
        law, base
            Two of those compared.
        name
            A metric's name, one of `quantities`.

        Returns
        -------
        MeanEstimate
            `value` and `half_width` of the 95 % interval, -0.5 for half of the mean with `base`. NaN where there is no such
            draw, one law has no value at all, or there is no steady state to compare: none, or zero.

        Raises
        ------
        UserError
            For another law or metric.
        """
        check_among("metric", name, self.quantities)
        quantity = self.quantities[name]
        numbers = [{d.number: self._number(d, name) for d in self._counted(one)} for one in (law, base)]
        both = [n for n in numbers[0] if n in numbers[1]]
        none = any(self._never(one, name) == len(self._counted(one)) for one in (law, base))
        if none or (quantity.of_window and not (self.steady(law) and self.steady(base))):
            return MeanEstimate(math.nan)
        values, bases = (np.array([of[n] for n in both]) for of in numbers)
        return change_of(values, bases, quantity)

    def _number(self, draw: Draw, name: str) -> float:
        value = float(draw.metrics.values[name])
        return self.scenario.run.duration if math.isnan(value) and self.quantities[name].never else value

    def unsettled(self, law: str) -> int:
        """Return in how many of the counted draws something never settled.

        Parameters
        ----------
        law
            One of those compared.

        Returns
        -------
        int
            Their number.

        Raises
        ------
        UserError
            For another law.
        """
        names = [q.name for q in self.quantities.values() if q.role == "settling"]
        return sum(any(math.isnan(d.metrics.values[name]) for name in names) for d in self._counted(law))

    def remarks(self) -> list[str]:
        """Return what has to be known to read the means.

        Returns
        -------
        list of str
            A sentence each.
        """
        said = []
        laws = list(self._of_law)
        lost = {law: self.count - self.kept(law) for law in laws}
        if any(lost.values()):
            several = ", ".join(f"{law} {n}" for law, n in lost.items())
            said.append(
                f"{lost_words(self.quantities)}, and not in the means unless in all draws: {several} of {self.count}"
            )
        if not self.chance:
            said.append(
                "nothing is left to chance: the plant has neither encoder offsets nor noise, so one run says all"
            )
        said += self.overflows()
        late = {law: self.unsettled(law) for law in laws}
        if self.count > 1 and any(late.values()):
            several = ", ".join(f"{law} {n}" for law, n in late.items())
            said.append(f"never settled, counted as {self.scenario.run.duration:g} s: {several} of {self.count}")
        loose = [law for law in laws if not self.steady(law)]
        if loose:
            said.append(
                f"* not steady: {self._norm} of {', '.join(loose)} has a trend over the last {WINDOW:g} s, or the run is "
                "shorter; make run.duration longer"
            )
        return said

    def overflows(self) -> list[str]:
        """Return what leaves the range of numbers first, for each law in whose typical draw something does.

        Returns
        -------
        list of str
            A sentence each; `remarks` has them too.
        """
        return [f"{law}: {text}" for law, result in self.results.items() for text in overflow(result)]

    @property
    def _norm(self) -> str:
        return measure_of(self.quantities, "rms").symbol.removeprefix("steady RMS ")

    def save(self, folder: FilePath, pictures: Callable[[Path], object] | None = None) -> None:
        """Write each law's result, all draws as comparison.csv, what `pictures` writes to a folder, and comparison.json.

        The last has the means, and under `files` the SHA-256 of each of the others. They reach `folder` together, and
        what an earlier comparison has left there and this one does not replace is removed.

        Parameters
        ----------
        folder
            Where the files go; it is made where it is missing.
        pictures
            Is called with the folder to write further files to; None: there are none.

        Raises
        ------
        UserError
            Where they cannot be written.
        """

        def write(place: Path) -> None:
            self._save(place)
            if pictures is not None:
                pictures(place)

        save_described(folder, CONTENTS, self.summary(), write)

    def _save(self, folder: Path) -> None:
        for law, result in self.results.items():
            result.save(folder / f"{law}.csv")
        offsets, names = self.chance.offsets, list(self.quantities)
        lines = [csv_row("law", "draw", *offsets, "kept", *names)]
        for d in self.draws:
            start = self.scenario.plant.start
            if d.number is not None:
                start = drawn(self.scenario, d.number, self.chance).plant.start
            cells = ["" if d.number is None else d.number, *(start.get(name, "") for name in offsets)]
            lines.append(csv_row(d.law, *cells, int(d.kept), *(repr(d.metrics.values[n]) for n in names)))
        write_file(folder / "comparison.csv", "\n".join(lines) + "\n")

    def summary(self) -> dict[str, Any]:
        """Return the means, their intervals and the changes from the first law on, safe for JSON.

        Returns
        -------
        dict
            What comparison.json holds besides `files`.
        """
        base, *others = self._of_law
        laws: dict[str, Any] = {}
        for law in self._of_law:
            laws[law] = {name: pair(self.value(law, name)) for name in self.shown}
            laws[law] |= {"kept": self.kept(law), "steady": self.steady(law)}
            laws[law]["never_settled"] = self.unsettled(law)
        return {
            "format": FORMAT,
            "scenario": self.scenario.model_dump(mode="json"),
            "draws": self.count,
            "laws": laws,
            "change": {law: {name: pair(self.change(law, base, name)) for name in self.shown} for law in others},
            "remarks": self.remarks(),
        }
