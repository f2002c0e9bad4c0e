"""The page: sliders in groups, beside them metrics, maps and curves of the laws, a button that writes the scenario."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from html import escape
from pathlib import Path
from typing import Any

from fastapi import FastAPI
from nicegui import app as library
from nicegui import ui
from nicegui.element import Element
from nicegui.events import GenericEventArguments

from fmu_export.errors import UserError

from .. import report
from ..fmu import FmuError
from ..report.page import CHARTS
from ..results import SimulationError
from .adjustables import Adjustable, Choice, Group, Slider
from .exploration import Exploration, NotWantedError, Outcome
from .maps import Map, Metrics, maps_of

THROTTLE = 0.02
"""Seconds between two values of a slider that moves."""

SLOW = 0.3
"""Seconds that what is seen is behind what is set, from which on the page says that it computes."""

FAILURES = (UserError, SimulationError, FmuError)
"""What is said on the page in a sentence."""

_REPORT = Path(report.__file__).parent
_STYLES = ("style.css", "uplot/uPlot.min.css")


class Seen(Element, component="outcome.js", default_classes="seen"):
    """What an outcome shows; one message draws all of it."""


class Lever(Element, component="lever.js", default_classes="lever"):
    """A number to be typed or moved; it goes along by itself, and its values arrive while it moves."""

    def __init__(self, of: Slider, value: float, taken: Callable[[GenericEventArguments], Any]) -> None:
        super().__init__()
        self._props |= {"label": of.label, "meaning": of.meaning, "min": of.low, "max": of.high, "step": of.step}
        self._props |= {"logarithmic": of.logarithmic, "whole": of.whole, "start": value}
        self.on("taken", taken, throttle=THROTTLE)


class Chart(Element, component="map.js"):
    """A map that is clicked."""

    def __init__(self, of: Map, marks: list[dict[str, Any]], chosen: Callable[[GenericEventArguments], Any]) -> None:
        super().__init__()
        self._props |= {"title": of.title, "notes": of.notes, "marks": marks, **of.drawn()}
        self.on("choose", chosen)


def install(app: FastAPI, exploration: Exploration) -> None:
    """Put the page of an exploration into an application."""
    library.add_static_files("/report", _REPORT)
    styles = "".join((_REPORT / name).read_text(encoding="utf-8") for name in _STYLES)
    own = (Path(__file__).parent / "explore.css").read_text(encoding="utf-8")
    head = f"<style>@layer base {{ {styles} }}\n{own}</style>"
    head += "".join(f'<script src="/report/{name}"></script>' for name in CHARTS)

    def root() -> None:
        ui.add_head_html(head)
        Desk(exploration).build()

    title = f"explore {exploration.base.name}"
    ui.run_with(app, root=root, title=title, dark=None, tailwind=False, show_welcome_message=False)


class Desk:
    """One page in a browser, with what is set on it; another page, and this one when it is reloaded, begins with that."""

    def __init__(self, exploration: Exploration) -> None:
        self.exploration, self.asked = exploration, exploration.last.copy()
        self.levers: dict[str, Lever] = {}
        self.maps: list[tuple[Map, Chart]] = []
        self.metrics: Metrics = {}
        self.wanted = self.drawn = 0
        self.busy, self.behind = False, 0.0

    def build(self) -> None:
        """Make the page's elements and begin to compute."""
        scenario = self.exploration.base
        _heading("h1", scenario.description or scenario.name)
        with ui.element("div").classes("desk"):
            with ui.element("section").classes("levers").props('aria-label="Settings"'):
                self._settings()
            with ui.element("div"):
                self.problem = ui.label().classes("problem").props("role=alert")
                with Seen() as self.seen:
                    self.place = ui.element("section").props('aria-label="Maps"').classes("maps")
                self._writing()
        ui.timer(0.0, self.refresh, once=True)
        ui.timer(0.0, self._maps, once=True)

    @ui.refreshable_method
    def _settings(self) -> None:
        if len(self.exploration.laws) > 1:
            with ui.element("div").props('role=group aria-label="Laws"').classes("laws"):
                for law in self.exploration.laws:
                    self._law(law)
        ui.button("reset", on_click=self._reset).props("outline dense no-caps")
        for group in self.exploration.groups:
            self._group(group)

    def _law(self, law: str) -> None:
        async def change(event: Any) -> None:
            await self._show(law, event.value)

        ui.checkbox(law, value=law in self.asked.laws, on_change=change).props("dense").props["aria-label"] = law

    def _group(self, group: Group) -> None:
        if group.folded:
            with ui.element("details"):
                _heading("summary", group.title)
                self._members(group)
        else:
            _heading("h2", group.title)
            self._members(group)

    def _members(self, group: Group) -> None:
        for member in group.members:
            value = self.asked.values.get(member.entry, member.value)
            if isinstance(member, Choice):
                self._choice(member, value)
            else:
                self._slider(member, value)

    def _choice(self, choice: Choice, value: Any) -> None:
        async def change(event: Any) -> None:
            await self._set(choice, event.value)

        field = ui.select(dict(choice.items), label=choice.name, value=value, on_change=change)
        field.props("dense options-dense").props["title"] = choice.meaning

    def _slider(self, of: Slider, value: float) -> None:
        async def taken(event: GenericEventArguments) -> None:
            await self._set(of, event.args)

        self.levers[of.entry] = Lever(of, value, taken)

    async def _set(self, member: Adjustable, value: Any) -> None:
        try:
            self.asked.values[member.entry] = member.taken(value)
        except UserError as error:
            self._say(str(error))
            self._show_values()
            return
        await self._changed()

    def _show_values(self) -> None:
        """Show in every field of a number what is set."""
        for entry, lever in self.levers.items():
            lever.run_method("show", self.asked.values.get(entry, self.exploration.members[entry].value))

    async def _changed(self) -> None:
        """Leave out values that are the scenario's own; show where they are in the maps; run."""
        members = self.exploration.members
        self.asked.values = {e: v for e, v in self.asked.values.items() if v != members[e].value}
        self.exploration.last = self.asked.copy()
        self._mark()
        await self.refresh()

    def _mark(self) -> None:
        for one, chart in self.maps:
            chart.run_method("set", one.marks(self.asked.values, self.metrics))

    async def _show(self, law: str, wanted: bool) -> None:
        shown = [one for one in self.exploration.laws if (wanted if one == law else one in self.asked.laws)]
        if shown:
            self.asked.laws = shown
            await self._changed()
        else:
            self._settings.refresh()

    async def _reset(self) -> None:
        self.asked.values = {}
        self.levers.clear()
        self._settings.refresh()
        await self._changed()

    async def _maps(self) -> None:
        """Draw the maps that lie in the results, and say by which commands the others come."""
        base, own = self.exploration.base, self.exploration
        found, said = await asyncio.to_thread(maps_of, base, own.members, own.quantities)
        missing = {title: how for title, how in own.commands.items() if title not in {one.title for one in found}}
        with self.place:
            for one in found:
                chart = Chart(one, one.marks(self.asked.values, self.metrics), self._chosen(one))
                self.maps.append((one, chart))
            for text in said:
                ui.label(text).classes("note")
            for title, how in missing.items():
                text = f"{escape(title)}: none yet to click in. It comes by <code>{escape(how)}</code>"
                ui.html(text, sanitize=False).classes("note")

    def _chosen(self, of: Map) -> Callable[[GenericEventArguments], Any]:
        async def chosen(event: GenericEventArguments) -> None:
            try:
                self.asked.values = of.chosen(self.asked.values, event.args)
            except UserError as error:
                self._say(str(error))
                return
            self._show_values()
            await self._changed()

        return chosen

    def _writing(self) -> None:
        def write() -> None:
            try:
                said = self.exploration.write(name.value or "", self.asked.values)
            except FAILURES as error:
                said = str(error)
            status.text = said

        _heading("h2", "the scenario as it stands")
        with ui.element("div").classes("writing"):
            name = ui.input("name of the file", value=f"{self.exploration.base.name}_explored").props("dense")
            ui.button("write scenario", on_click=write).props("no-caps")
        status = ui.label().classes("note").props("role=status")

    async def refresh(self) -> None:
        """Compute and draw what is set, and again while that changes meanwhile; what is not wanted any more is dropped."""
        self.wanted += 1
        if self.busy:
            return
        self.busy, self.behind = True, time.monotonic()
        try:
            while self.drawn != self.wanted:
                number = self.wanted
                await self._computed(number)
                self.drawn = number
        finally:
            self.busy = False

    async def _computed(self, number: int) -> None:
        asked = self.asked.copy()
        running = asyncio.ensure_future(
            asyncio.to_thread(
                self.exploration.outcome, asked, lambda: number == self.wanted and not self.seen.is_deleted
            )
        )
        done, _ = await asyncio.wait([running], timeout=max(0.0, self.behind + SLOW - time.monotonic()))
        if not done:
            self.seen.run_method("wait")
        try:
            outcome = await running
        except NotWantedError:
            return
        except FAILURES as error:
            self._say(str(error))
            self.seen.run_method("keep")
            self.behind = time.monotonic()
            return
        self._say("")
        self.behind = time.monotonic()
        self.metrics = outcome.metrics
        self._mark()
        self.seen.run_method("draw", number, _told(outcome))

    def _say(self, problem: str) -> None:
        self.problem.text = problem


def _told(outcome: Outcome) -> dict[str, Any]:
    """Return what an outcome tells the page's script."""
    return {name: getattr(outcome, name) for name in ("drawn", "headings", "rows", "notes")}


def _heading(tag: str, text: str) -> None:
    ui.html(escape(text), tag=tag, sanitize=False)
