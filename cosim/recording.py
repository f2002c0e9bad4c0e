"""Signals over time with units and metadata: what metrics, pictures and files are made of."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from .errors import UserError

if TYPE_CHECKING:
    import pandas

    from .evaluation import Evaluation

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Recording:
    """Signals at communication points.

    A row holds every output at its time. With the order `controller-first` the control of a row is the one that was applied
    over the step that ended there, with `parallel` it is the one of the next step. `recording["plant.theta"]` is a signal.

    Parameters
    ----------
    time
        Communication points [s], shape (rows,).
    signals
        Signals by name `instance.variable`, each of shape (rows,), float64 or int64.
    units
        Their units by the same names, "1" for none.
    metadata
        How it came about, in JSON types: scenario, FMUs, start values, wires, versions, messages.
    judged_by
        What it is judged by; None: what the metadata keep of that.
    """

    time: Array
    signals: dict[str, Array]
    units: dict[str, str]
    metadata: dict[str, Any] = field(default_factory=dict)
    judged_by: Evaluation | None = field(default=None, repr=False)

    def __getitem__(self, name: str) -> Array:
        try:
            return self.signals[name]
        except KeyError:
            raise UserError(f"the result has no signal {name!r}; it has {', '.join(self.signals)}") from None

    def to_dataframe(self) -> pandas.DataFrame:
        """Return the table as a pandas data frame.

        Returns
        -------
        pandas.DataFrame
            The time [s] as its index, a column for each signal; `attrs` has `units` and `metadata`.

        Raises
        ------
        UserError
            Where pandas is not installed.
        """
        try:
            import pandas  # noqa: PLC0415 - optional
        except ImportError:
            raise UserError("to_dataframe needs pandas, which is not installed: pip install pandas") from None
        table = pandas.DataFrame(dict(self.signals), index=pandas.Index(self.time, name="time"))
        table.attrs |= {"units": dict(self.units), "metadata": self.metadata}
        return table
