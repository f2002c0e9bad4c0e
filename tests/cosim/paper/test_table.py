"""A table: exact in the CSV, well-formed in Markdown."""

import csv
import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.paper.table import Column, Table

NAN = math.nan


def saved(table, folder):
    table.save(folder)
    with (folder / f"{table.name}.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.reader(file)), (folder / f"{table.name}.md").read_text(encoding="utf-8")


def cells_of(line):
    """Split a row of a Markdown table at the bars that are not escaped."""
    assert line.startswith("|")
    assert line.endswith("|")
    return [cell.strip().replace("\\|", "|") for cell in re.split(r"(?<!\\)\|", line)[1:-1]]


def small(*rows):
    columns = (Column("what |x|", "what"), Column("value [V]", "value", 3), Column("count", "count"))
    return Table("small", "A title", "A note.", columns, rows)


@given(st.lists(st.floats(), min_size=1))
def test_csv_keeps_every_number_to_the_last_bit(tmp_path_factory, values):
    table = small(*(("x", value, 1) for value in values))
    (_, *rows), _ = saved(table, tmp_path_factory.getbasetemp())
    np.testing.assert_array_equal([float(value) for _, value, _ in rows], values)


def test_csv_keeps_texts_as_they_are_and_leaves_nothing_empty_but_what_there_is_not(tmp_path):
    texts = ["a, b", 'c "d"', "e | f", "two\nlines", "θ — δ"]
    table = small(*((text, None, True) for text in texts))
    (head, *rows), _ = saved(table, tmp_path)
    assert head == ["what", "value", "count"]
    assert rows == [[text, "", "True"] for text in texts]
    assert [file.name for file in sorted(tmp_path.iterdir())] == ["small.csv", "small.md"]


def test_what_there_is_not_is_a_dash_for_the_reader():
    table = small(("a", None, None), ("b", NAN, np.float64("nan")), ("c", 0.0, 0))
    assert table.shown() == [["a", "–", "–"], ["b", "–", "–"], ["c", "0", "0"]]


def test_the_reader_sees_the_columns_digits_yes_and_no():
    table = small(("a", 12.3456, 200), ("b", -0.00123456, True), ("c", np.float64(2e-9), False), ("d", math.inf, 7))
    assert table.shown() == [["a", "12.3", "200"], ["b", "-0.00123", "yes"], ["c", "2e-09", "no"], ["d", "inf", "7"]]


def test_markdown_has_as_many_columns_in_each_row_and_escapes_bars(tmp_path):
    table = small(("a | b", 1.0, 2), ("|q|", None, 3))
    _, text = saved(table, tmp_path)
    mark, _, text = text.partition("\n\n")
    assert (mark, text) == ("<!-- written by qube-ihc -->", table.markdown())
    title, _, note, _, head, rule, *rows = text.splitlines()
    assert (title, note) == ("## A title", "A note.")
    assert cells_of(head) == ["what |x|", "value [V]", "count"]
    assert rule == "|---|---|---|"
    assert [cells_of(row) for row in rows] == [["a | b", "1", "2"], ["|q|", "–", "3"]]


def test_a_row_of_another_length_is_no_table():
    with pytest.raises(ValueError, match="zip"):
        small(("a", 1.0)).shown()
