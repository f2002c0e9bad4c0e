"""A table: once as CSV with exact numbers, as Markdown and for the HTML report."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from filing.files import write_file
from filing.origin import WRITTEN

Cell = str | float | int | bool | None


@dataclass(frozen=True)
class Column:
    """A column: heading (with its unit), name in the CSV, digits of numbers when shown."""

    heading: str
    name: str
    digits: int = 4


@dataclass(frozen=True)
class Table:
    """Rows under columns; `name` is the files', `title` the reader's, `note` says what decides the numbers."""

    name: str
    title: str
    note: str
    columns: tuple[Column, ...]
    rows: Sequence[Sequence[Cell]]

    def save(self, folder: Path) -> None:
        """Write NAME.csv and NAME.md."""
        write_file(folder / f"{self.name}.md", f"<!-- {WRITTEN} -->\n\n{self.markdown()}")
        self.save_csv(folder)

    def save_csv(self, folder: Path) -> None:
        """Write NAME.csv."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow([column.name for column in self.columns])
        writer.writerows([["" if cell is None else cell for cell in row] for row in self.rows])
        write_file(folder / f"{self.name}.csv", text.getvalue())

    def markdown(self) -> str:
        """Return the table as Markdown, with its title and note."""
        lines = [f"## {self.title}", "", self.note, ""]
        lines.append("| " + " | ".join(_plain(column.heading) for column in self.columns) + " |")
        lines.append("|" + "---|" * len(self.columns))
        lines += ["| " + " | ".join(_plain(text) for text in row) + " |" for row in self.shown()]
        return "\n".join(lines) + "\n"

    def shown(self) -> list[list[str]]:
        """Return the cells as a reader sees them."""
        return [
            [_shown(cell, column.digits) for cell, column in zip(row, self.columns, strict=True)] for row in self.rows
        ]


def _plain(text: str) -> str:
    return text.replace("|", "\\|")


def _shown(cell: Cell, digits: int) -> str:
    if cell is None or (isinstance(cell, float) and math.isnan(cell)):
        return "–"
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    return f"{cell:.{digits}g}" if isinstance(cell, float) else str(cell)
