"""The page: sliders in groups, beside them curves and metrics of the laws and maps, a button that writes the scenario."""

from __future__ import annotations

import asyncio
from dataclasses import asdict
from html import escape
from pathlib import Path
from typing import Any

from fastapi import FastAPI
from nicegui import app as library
from nicegui import ui
from nicegui.element import Element
from nicegui.elements.mixins.value_element import ValueElement

from fmu_export.errors import UserError

from .. import report
from ..fmu import FmuError
from ..report.page import CHARTS
from ..results import SimulationError
from .adjustables import Adjustable, Choice, Group, Slider
from .exploration import Exploration, NotWantedError, pictures_of

THROTTLE = 0.02
"""Seconds between two values of a slider that moves."""

SLOW = 0.3
"""Seconds of a run from which on the page says that the next one computes."""

FAILURES = (UserError, SimulationError, FmuError)
"""What is said on the page in a sentence."""

_REPORT = Path(report.__file__).parent
_STYLES = ("style.css", "uplot/uPlot.min.css")


class Seen(Element, component="outcome.js", default_classes="seen"):
    """What an outcome shows; one message draws all of it."""


class Lever(ValueElement, component="lever.js", default_classes="lever"):
    """A number to be typed or moved; it goes along by itself, and its values arrive while it moves."""

    LOOPBACK = None

    def __init__(self, of: Slider, value: float, on_change: Any) -> None:
        super().__init__(value=value, on_value_change=on_change, throttle=THROTTLE)
        self._props |= {"label": of.label, "meaning": of.meaning, "min": of.low, "max": of.high, "step": of.step}


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
    """One page in a browser; what is set on it is the exploration's, so that it is there after a reload."""

    def __init__(self, exploration: Exploration) -> None:
        self.exploration = exploration
        self.wanted = self.drawn = 0
        self.busy, self.seconds = False, 0.0

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
                    self._maps()
                self._writing()
        ui.timer(0.0, self.refresh, once=True)

    @ui.refreshable_method
    def _settings(self) -> None:
        if len(self.exploration.laws) > 1:
            with ui.element("div").props('role=group aria-label="Laws"'):
                for law in self.exploration.laws:
                    self._law(law)
        ui.button("reset", on_click=self._reset).props("outline dense no-caps")
        for group in self.exploration.groups:
            self._group(group)

    def _law(self, law: str) -> None:
        async def change(event: Any) -> None:
            await self._show(law, event.value)

        ui.checkbox(law, value=law in self.exploration.shown, on_change=change).props["aria-label"] = law

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
            value = self.exploration.values.get(member.entry, member.value)
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
        async def moved(event: Any) -> None:
            await self._set(of, of.number(event.value))

        Lever(of, of.number(value), moved)

    async def _set(self, member: Adjustable, value: Any) -> None:
        if value == member.value:
            self.exploration.values.pop(member.entry, None)
        else:
            self.exploration.values[member.entry] = value
        await self.refresh()

    async def _show(self, law: str, wanted: bool) -> None:
        shown = [one for one in self.exploration.laws if (wanted if one == law else one in self.exploration.shown)]
        if shown:
            self.exploration.shown = shown
            await self.refresh()
        else:
            self._settings.refresh()

    async def _reset(self) -> None:
        self.exploration.values.clear()
        self._settings.refresh()
        await self.refresh()

    def _maps(self) -> None:
        pictures = pictures_of(self.exploration.base)
        if pictures:
            with ui.element("section").props('aria-label="Maps"'):
                for path in pictures:
                    ui.image(path).props("fit=contain").props["alt"] = str(path)
                    ui.label(str(path)).classes("note")

    def _writing(self) -> None:
        def write() -> None:
            try:
                said = self.exploration.write(name.value or "")
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
        self.busy = True
        try:
            while self.drawn != self.wanted:
                number = self.wanted
                await self._computed(number)
                self.drawn = number
        finally:
            self.busy = False

    async def _computed(self, number: int) -> None:
        if self.seconds > SLOW:
            self.seen.run_method("say", "computing …")
        try:
            outcome = await asyncio.to_thread(self.exploration.outcome, lambda: number == self.wanted)
        except NotWantedError:
            return
        except FAILURES as error:
            self.problem.text = str(error)
            self.seen.run_method("keep")
            return
        self.problem.text, self.seconds = "", outcome.seconds
        self.seen.run_method("draw", number, asdict(outcome))


def _heading(tag: str, text: str) -> None:
    ui.html(escape(text), tag=tag, sanitize=False)
