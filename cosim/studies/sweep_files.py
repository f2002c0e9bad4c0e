"""What a sweep leaves: a table of all runs, pictures, its summary, and the worst draws as scenarios that run alone."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from filing.files import write_file
from filing.origin import SOFTWARE
from filing.ownership import check_replaceable
from fmu_export.errors import UserError
from fmu_export.files import FilePath

from ..plots import save_figure
from ..scenario_files import portable
from .described import csv_row, save_described
from .sweep import Sweep
from .sweep_pictures import distribution, scatter, sensitivities, tornado
from .sweep_plan import SweepPlan
from .sweep_tables import summary, title_of

CONTENTS = "sweep.json"
WORST = 3
"""Worst draws of each law that are written."""


def written_files(laws: Sequence[str], worst: int = WORST) -> list[str]:
    """Return the names of what `save` writes, besides files that lie beside the scenario."""
    pictures = [f"{name}.png" for name in ("distribution", "scatter", "tornado", "sensitivity")]
    scenarios = [_worst_name(law, k) for law in laws for k in range(1, worst + 1)]
    return ["sweep.csv", "sweep.parquet", CONTENTS, *pictures, *scenarios]


def check_parquet() -> Any:
    """Return pyarrow; raise UserError where it is not installed."""
    try:
        import pyarrow  # noqa: PLC0415 - optional
    except ImportError:
        raise UserError(
            'a sweep writes its table as Parquet, which needs pyarrow: pip install "qube-ihc[sweep]"'
        ) from None
    return pyarrow


def table(sweep: Sweep) -> Any:
    """Return the pyarrow.Table of all runs: draw, law, what was drawn, whether the law kept the plant, all metrics.

    Raises UserError where pyarrow is not installed.
    """
    arrow, plan = check_parquet(), sweep.plan
    laws, draws = len(plan.laws), np.arange(1, plan.count + 1, dtype=np.int32)
    columns: dict[str, Any] = {
        "draw": np.repeat(draws, laws),
        "law": arrow.DictionaryArray.from_arrays(np.tile(np.arange(laws, dtype=np.int8), plan.count), list(plan.laws)),
        **{name: np.repeat(plan.values(path), laws) for path, name in plan.names.items()},
        "kept": _by_run(sweep, "kept") == 1.0,
        "failed": np.isnan(_by_run(sweep, "kept")),
        "steady": _by_run(sweep, "steady") == 1.0,
    }
    columns |= {name: _by_run(sweep, name) for name in sweep.quantities}
    arrays = [
        column if isinstance(column, arrow.Array) else arrow.array(column, from_pandas=True)
        for column in columns.values()
    ]
    return arrow.table(arrays, names=list(columns), metadata={"software": SOFTWARE})


def _by_run(sweep: Sweep, name: str) -> np.ndarray:
    """Return a number of all runs: the laws of a draw one after the other."""
    return np.stack([sweep.column(law, name) for law in sweep.plan.laws], axis=1).ravel()


def save(sweep: Sweep, folder: FilePath, measure: str | None = None, worst: int = WORST) -> list[Path]:
    """Write table, pictures, summary and the `worst` draws of each law by `measure` (None: `Sweep.measure`).

    Where no draw counts there are no pictures.
    FMUs, tables, designs and parameter files that lie beside the scenario are copied beside the worst ones. Raises
    UserError where something cannot be written, or would replace a file of somebody else.
    """
    check_replaceable(*(Path(folder) / file for file in written_files(sweep.plan.laws, worst)))
    name = measure or sweep.measure
    ranked = {law: sweep.worst(law, name, worst) for law in sweep.plan.laws}

    def write(place: Path) -> None:
        _write_tables(sweep, place)
        if sweep.counts:
            _draw(sweep, name, place)
        for law, draws in ranked.items():
            for k, draw in enumerate(draws, 1):
                _write_scenario(sweep.plan, law, draw, place, _worst_name(law, k))

    told = {
        law: [
            {"draw": draw, "file": _worst_name(law, k), name: _number(sweep.ranked(law, name)[draw - 1])}
            for k, draw in enumerate(draws, 1)
        ]
        for law, draws in ranked.items()
    }
    return save_described(folder, CONTENTS, {**summary(sweep), "worst": {"measure": name, **told}}, write)


def _draw(sweep: Sweep, measure: str, place: Path) -> None:
    for picture, figure in (
        ("distribution", distribution(sweep)),
        ("scatter", scatter(sweep, measure)),
        ("tornado", tornado(sweep, measure)),
        ("sensitivity", sensitivities(sweep)),
    ):
        if figure is not None:
            save_figure(figure, place / f"{picture}.png", f"{sweep.plan.scenario.name}: {title_of(sweep)}")


def _worst_name(law: str, number: int) -> str:
    return f"worst_{law}_{number}.toml"


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _write_tables(sweep: Sweep, place: Path) -> None:
    import pyarrow.csv  # noqa: PLC0415 - optional
    import pyarrow.parquet  # noqa: PLC0415

    runs = table(sweep)
    parquet, text = io.BytesIO(), io.BytesIO()
    pyarrow.parquet.write_table(runs, parquet)
    write_file(place / "sweep.parquet", parquet.getvalue())
    text.write(f"{csv_row(*runs.column_names)}\n".encode())
    pyarrow.csv.write_csv(runs, text, pyarrow.csv.WriteOptions(include_header=False, quoting_style="needed"))
    write_file(place / "sweep.csv", text.getvalue())


def _write_scenario(plan: SweepPlan, law: str, draw: int, place: Path, name: str) -> None:
    scenario, beside = portable(plan.scenario.changed(plan.changes(draw, law)), plan.fmus, plan.folder)
    for file, path in beside.items():
        content = path.read_bytes()
        if not (place / file).is_file():
            write_file(place / file, content)
        elif (place / file).read_bytes() != content:
            raise UserError(f"files that a sweep varies must have different names, found two named {file}")
    write_file(place / name, scenario.to_toml())
