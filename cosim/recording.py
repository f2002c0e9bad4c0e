"""Signals over time with units and metadata: what metrics, pictures and files are made of."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from .errors import UserError

if TYPE_CHECKING:
    import pandas

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Recording:
    """Signals at communication points.

    time [s] of shape (rows,); signals by name `instance.variable`, each of shape (rows,), float64 or int64; units by
    the same names; metadata as JSON types. A row holds every output at its time; with the order controller-first the
    voltage of a row is the one that was applied over the step that ended there, with parallel the one of the next step.
    """

    time: Array
    signals: dict[str, Array]
    units: dict[str, str]
    metadata: dict[str, Any] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Array:
        try:
            return self.signals[name]
        except KeyError:
            raise UserError(f"the result has no signal {name!r}; it has {', '.join(self.signals)}") from None

    def to_dataframe(self) -> pandas.DataFrame:
        """Return the table with the time [s] as its index and a column for each signal; `attrs` has units and metadata.

        Raises UserError where pandas is not installed.
        """
        try:
            import pandas  # noqa: PLC0415 - optional
        except ImportError:
            raise UserError("to_dataframe needs pandas, which is not installed: pip install pandas") from None
        table = pandas.DataFrame(dict(self.signals), index=pandas.Index(self.time, name="time"))
        table.attrs |= {"units": dict(self.units), "metadata": self.metadata}
        return table
