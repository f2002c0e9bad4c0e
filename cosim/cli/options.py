"""Options that several commands have, and how they are read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from filing.ownership import check_replaceable

from ..errors import UserError
from ..typed import value_of

if TYPE_CHECKING:
    from ihc_fmu.design import Design

    from ..studies.engine import Workers


FAILED = 1
"""Exit code of a run, a device or a compiler that failed."""

OTHER_FMU = "this FMU is not the file that the log was made with (another GUID)"

SCENARIOS = Path(__file__).parents[1] / "scenarios"
SCENARIO_HELP = f"TOML or SSP file, or a built-in name: {', '.join(sorted(f.stem for f in SCENARIOS.glob('*.toml')))}."

FmusOption = Annotated[Path, typer.Option("--fmus", help="Folder with the exported FMUs.")]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="ENTRY=VALUE",
        help="Change an entry of the scenario, e.g. `run.duration=20`, `plant.parameters=hcs`, or of a component's start "
        "values `controller.a_min=0.7`; may be repeated.",
    ),
]

ReportOption = Annotated[
    bool, typer.Option("--report", help="Also write a page (HTML, in one file) beside the results.")
]
ReportFileOption = Annotated[
    Path | None,
    typer.Option("--report-file", help="The page's file (*.html), which is then written; none: see --report."),
]

WorkersOption = Annotated[int | None, typer.Option(min=1, help="Threads; none: one per core.")]
ClusterOption = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS", help="Run on the workers of a Dask cluster, e.g. `tcp://10.0.0.5:8786`, not in threads here."
    ),
]

RunArgument = Annotated[Path, typer.Argument(help="Result of `hil` (CSV, with its JSON beside it).")]
ControllerOption = Annotated[
    Path | None, typer.Option(help="Controller FMU; none: the scenario's, in the folder of `--fmus`.")
]


def loaded_design(path: Path) -> Design:
    """Return the design that a file holds."""
    from ihc_fmu.design import Design

    return Design.load(path)


@dataclass(frozen=True)
class Page:
    """A page to write: where, None: at its usual place; notes that were printed; the design of the controller."""

    path: Path | None
    notes: Sequence[str] = ()
    design: Design | None = None


def page_wanted(report: bool, file: Path | None, usual: Path | None) -> Page | None:
    """Return the page that --report and --report-file ask for, None where neither does.

    `usual` is where it is without a name, None: not known yet, and free. Raises UserError for a name that is none of a
    page's, and for a file there that must stay.
    """
    if file is None and not report:
        return None
    from ..report.pages import check_name

    path = file or usual
    if path is not None:
        check_replaceable(check_name(path))
    return Page(path)


@contextmanager
def workers_at(workers: int | None, cluster: str | None) -> Iterator[Workers]:
    """Give where runs are to be made, as --workers and --cluster say it; raise UserError where both do."""
    if cluster is None:
        yield workers
        return
    if workers is not None:
        raise UserError(
            f"--workers counts threads of this process, and --cluster runs elsewhere: give one, found {workers}"
        )
    from ..studies.cluster import Cluster

    connected = Cluster(cluster)
    try:
        yield connected
    finally:
        connected.close()


def assignments(items: list[str] | None, option: str = "--set") -> list[tuple[str, Any]]:
    """Return (name, value) of each NAME=VALUE of an option; values as `value_of` reads them."""
    pairs = []
    for item in items or []:
        name, equals, text = item.partition("=")
        if not equals or not name:
            raise UserError(f"{option} takes NAME=VALUE, found {item!r}")
        pairs.append((name, value_of(text, f"{option} {name}")))
    return pairs


def varied(text: str) -> tuple[str, dict[str, Any]]:
    """Return the entry and its values by their texts, of ENTRY=VALUE,VALUE,...; values are read as those of --set."""
    name, equals, values = text.partition("=")
    if not equals or not name.strip():
        raise UserError(f"--vary takes ENTRY=VALUE,VALUE, found {text!r}")
    texts = [value.strip() for value in values.split(",")]
    if len(set(texts)) < len(texts) or not all(texts):
        raise UserError(f"--vary takes different values, found {text!r}")
    return name.strip(), {value: value_of(value, f"--vary {name}") for value in texts}
