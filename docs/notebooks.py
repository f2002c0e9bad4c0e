"""The notebooks of examples/notebooks: run, and as pages of the site.

python docs/notebooks.py                     # runs all of them and writes their outputs anew
python docs/notebooks.py your_plant.ipynb    # one
"""

from __future__ import annotations

import argparse
import base64
import io
import json
import os
import re
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parents[1] / "examples" / "notebooks"
PATIENCE = 120
"""Longest time for a cell [s]."""
COLOURS = 64
"""Of a picture: lines and letters need no more, and the files stay small."""
COLOUR_CODES = re.compile(r"\x1b\[[\d;]*m")
SHELL = "%%bash\n"


def executed(path: Path, folder: Path) -> dict[str, Any]:
    """Return a notebook with the outputs of a run in `folder`, without what differs from run to run.

    Raises nbclient's CellExecutionError where a cell fails.
    """
    import nbformat  # noqa: PLC0415 - the site's build needs neither
    from nbclient import NotebookClient  # noqa: PLC0415

    notebook = nbformat.read(path, as_version=4)
    commands = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    client = NotebookClient(
        notebook,
        timeout=PATIENCE,
        kernel_name="python3",
        coalesce_streams=True,
        record_timing=False,
        resources={"metadata": {"path": str(folder)}},
    )
    client.execute(env={**os.environ, "PATH": commands})
    notebook.metadata = {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    }
    for cell in notebook.cells:
        for output in cell.get("outputs", ()):
            if "text" in output:
                output.text = COLOUR_CODES.sub("", output.text)
            data = output.get("data", {})
            if len(data) > 1:
                data.pop("text/plain", None)  # of a picture or a table: what nobody reads
            if "image/png" in data:
                data["image/png"] = _smaller(data["image/png"])
    return json.loads(nbformat.writes(notebook))


def _smaller(picture: str) -> str:
    """Return a PNG with fewer colours, both in base 64."""
    from PIL import Image  # noqa: PLC0415

    buffer = io.BytesIO()
    Image.open(io.BytesIO(base64.b64decode(picture))).convert("RGB").quantize(COLOURS).save(
        buffer, "PNG", optimize=True
    )
    return base64.b64encode(buffer.getvalue()).decode()


def page(text: str) -> str:
    """Return a notebook's text (JSON) as a page in MyST Markdown: cells and outputs in their order."""
    return "\n\n".join(part for cell in json.loads(text)["cells"] for part in _parts(cell)) + "\n"


def _parts(cell: dict[str, Any]) -> Iterator[str]:
    source = "".join(cell["source"])
    if cell["cell_type"] == "markdown":
        yield source
        return
    is_shell = source.startswith(SHELL)
    yield _block("sh" if is_shell else "python", source.removeprefix(SHELL))
    for output in cell["outputs"]:
        if output["output_type"] == "stream":
            yield _block("text", "".join(output["text"]))
        elif "image/png" in output["data"]:
            picture = "".join(output["data"]["image/png"]).strip()
            yield _block(
                "{raw} html", f'<img src="data:image/png;base64,{picture}" alt="the picture that the cell draws">'
            )
        elif "text/html" in output["data"]:
            yield _block("{raw} html", "".join(output["data"]["text/html"]))
        else:
            yield _block("text", "".join(output["data"]["text/plain"]))


def _block(kind: str, text: str) -> str:
    return f"````{kind}\n{text.rstrip()}\n````"


def main() -> int:
    """Run notebooks and write their outputs into them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="notebooks by their files' names; none: all")
    names = parser.parse_args().names or sorted(path.name for path in FOLDER.glob("*.ipynb"))
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            notebook = executed(FOLDER / name, Path(folder))
        (FOLDER / name).write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        print(name)
    return 0


if __name__ == "__main__":
    sys.exit(main())
