"""The page inside an FMU: well-formed, complete, and saying what the FMU really starts with."""

import zipfile
from html.parser import HTMLParser

import pytest

from fmu_export.documentation import documentation
from fmu_export.variables import Interface, Variable

VOID = {"meta", "br", "hr", "img", "link"}


class Page(HTMLParser):
    """The rows of all tables as lists of texts; refuses tags that are not closed in order."""

    def __init__(self, html):
        super().__init__()
        self.open, self.rows, self.text = [], [], ""
        self.feed(html)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        if tag not in VOID:
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data
        if "td" in self.open or "th" in self.open:
            self.rows[-1][-1] += data


def as_value(text, variable):
    """Read a start value back from its cell."""
    if variable.items:
        return variable.items.index(text) + 1
    return {"true": True, "false": False}[text] if variable.type == "Boolean" else float(text)


def test_page_lists_every_variable_with_unit_start_and_description(name, slaves, start):
    interface = slaves[name].interface
    rows = {row[0]: row for row in Page(documentation(interface, start[name], "")).rows if row[0] != "name"}
    in_order = [v for causality in ("input", "output", "parameter") for v in interface.of(causality)]
    assert list(rows) == [v.name for v in in_order]
    for variable in in_order:
        _, unit, value, variability, description = rows[variable.name]
        assert (unit, description) == (variable.unit, variable.description)
        assert variability == (variable.variability if variable.causality == "parameter" else "")
        if variable.calculated:
            assert value == ""
        else:
            assert as_value(value, variable) == pytest.approx(start[name][variable.name], rel=1e-9)


def test_exported_page_shows_the_start_values_asked_for_and_the_notes(tmp_path, slaves):
    from fmu_export.python_fmu import export_python_fmu

    changes = {"delta_0": 0.125, "motor_model": "inductance", "back_emf": False}
    path = export_python_fmu(
        slaves["QubeServo2"], tmp_path / "p.fmu", changes, notes="<p>made for <b>this</b> test</p>"
    )
    with zipfile.ZipFile(path) as archive:
        page = Page(archive.read("documentation/index.html").decode())
    shown = {row[0]: row[2] for row in page.rows}
    assert (shown["delta_0"], shown["motor_model"], shown["back_emf"]) == ("0.125", "inductance", "false")
    assert "made for this test" in page.text


def test_texts_with_markup_characters_are_shown_as_they_are():
    variables = (
        Variable("x", "parameter", "x < 1 & y > <b>", "m", variability="fixed", start=2.0),
        Variable("kind", "parameter", "", type="Enumeration", variability="fixed", start=1, items=("<a>&", "b")),
    )
    interface = Interface("Thing", "for x<y & z", variables, step_size=0.25, stop_time=1.0, variable_step=True)
    page = Page(documentation(interface, interface.start_values(), ""))
    assert [row for row in page.rows if row[0] in ("x", "kind")] == [
        ["x", "m", "2", "fixed", "x < 1 & y > <b>"],
        ["kind", "1", "<a>&", "fixed", ""],
    ]
    assert "for x<y & z" in page.text
    assert "0.25 s" in page.text
