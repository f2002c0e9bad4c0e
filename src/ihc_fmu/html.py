"""Tables as HTML, for notebooks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape


def html_table(caption: str, headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table as HTML without style; the first cell of a row names it, line breaks stay."""

    def cells(kind: str, texts: Sequence[str]) -> str:
        return "".join(
            f'<{kind} style="text-align: {"right" if n else "left"}; white-space: pre-line">{escape(text)}</{kind}>'
            for n, text in enumerate(texts)
        )

    head = f"<thead><tr>{cells('th', headings)}</tr></thead>" if headings else ""
    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    return f'<table><caption style="text-align: left">{escape(caption)}</caption>{head}<tbody>{body}</tbody></table>'
