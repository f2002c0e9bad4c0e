"""A linear system x' = A x + B u, y = C x with the names, units, limits and sensors that its controller needs to know.

It is made from arrays, from a `control.StateSpace` or from a TOML file.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from filing.files import write_file
from fmu_export.errors import UserError
from fmu_export.files import FilePath
from fmu_export.reading import read_toml

from .arrays import Array
from .block_form import BlockForm, block_form
from .observer_wish import ObserverWish
from .quantity import Quantity, index_of
from .state_space import fields_of_model
from .system_entries import called_as_given, entries_of, fields_of, toml_of
from .system_rules import checked

PENDULUM = "rotary_pendulum"
"""Name of the systems whose controller is the pendulum's, with swing-up."""
OF_OUTPUTS = {"outputs": (), "set_points": (), "biases": (), "y_eq": None, "resolutions": None, "deviations": None}
"""What becomes of fields about the outputs where C changes."""


@dataclass(frozen=True, eq=False, kw_only=True)
class System:
    """A plant's linear model and the linear controller that works on it: x' = A x + B (u - u_eq), y - y_eq = C x.

    x is the deviation of the states from x_eq.

    Parameters
    ----------
    A
        Shape (n, n).
    B
        Shape (n, m), or (n,) for one input.
    C
        What is measured, shape (p, n); None: the states themselves.
    K
        The linear controller u = K x, shape (m, n), or (n,) for one input; None: none yet.
    name
        A C identifier; FMUs and files are named after it.
    states, inputs, outputs
        Names with units, as `Quantity` or "name [unit]"; none: x1, x2, ..., u1, ..., y1, ...
    lower, upper
        Limits of the inputs as the plant takes them, shape (m,), infinite for none.
    resolutions
        Step of a counting sensor, shape (p,), 0 for none [units of y].
    deviations
        Standard deviation of a sensor's noise, shape (p,), 0 for none [units of y].
    sample_time
        Of the controller [s].
    x_eq, u_eq, y_eq
        The equilibrium, shapes (n,), (m,), (p,); None: 0.
    set_points
        Outputs with a reference.
    biases
        Outputs whose bias a Kalman filter is to estimate.
    bandwidth
        Of the filter's estimate of the disturbances [rad/s], 0: none, None: chosen.
    integral
        K_i of a linear PI controller that works, u = K x + v, v' = K_i x, shape (m, n), or "direct", which chooses one;
        None: no integral action.
    observer
        A homogeneous observer in place of a Kalman filter.

    Raises
    ------
    UserError
        Names the entry, its rule and what was found.

    Examples
    --------
    >>> from ihc_fmu import System
    >>> cart = System(A=[[0, 1], [0, 0]], B=[0, 1], states=("position [m]", "velocity [m/s]"), inputs=("force [N]",))
    >>> cart.n, cart.m, cart.measures_state, cart.output("velocity")
    (2, 1, True, 1)
    >>> cart = cart.with_lqr(Q=[4, 0], R=[1]).changed(name="cart", lower=[-5], upper=[5])
    >>> cart.K.round(6).tolist(), cart.room.tolist()
    ([[-2.0, -2.0]], [5.0])
    >>> cart.save("cart.toml")
    >>> System.load("cart.toml").as_dict() == cart.as_dict()
    True
    """

    A: Array
    B: Array
    C: Array | None = None
    K: Array | None = None
    name: str = "system"
    states: tuple[Quantity, ...] = ()
    inputs: tuple[Quantity, ...] = ()
    outputs: tuple[Quantity, ...] = ()
    lower: Array | None = None
    upper: Array | None = None
    resolutions: Array | None = None
    deviations: Array | None = None
    sample_time: float = 1e-3
    x_eq: Array | None = None
    u_eq: Array | None = None
    y_eq: Array | None = None
    set_points: tuple[str, ...] = ()
    biases: tuple[str, ...] = ()
    bandwidth: float | None = None
    integral: Array | str | None = None
    observer: ObserverWish | None = None
    measures_state: bool = field(init=False)

    if TYPE_CHECKING:  # what is taken is wider than what is held

        def __init__(
            self,
            *,
            A: ArrayLike,
            B: ArrayLike,
            C: ArrayLike | None = None,
            K: ArrayLike | None = None,
            name: str = "system",
            states: Sequence[Quantity | str] = (),
            inputs: Sequence[Quantity | str] = (),
            outputs: Sequence[Quantity | str] = (),
            lower: ArrayLike | None = None,
            upper: ArrayLike | None = None,
            resolutions: ArrayLike | None = None,
            deviations: ArrayLike | None = None,
            sample_time: float = 1e-3,
            x_eq: ArrayLike | None = None,
            u_eq: ArrayLike | None = None,
            y_eq: ArrayLike | None = None,
            set_points: Sequence[str] = (),
            biases: Sequence[str] = (),
            bandwidth: float | None = None,
            integral: ArrayLike | str | None = None,
            observer: ObserverWish | None = None,
        ) -> None: ...

    def __post_init__(self) -> None:
        for name, value in checked(vars(self)).items():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
            object.__setattr__(self, name, value)

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.A)

    @property
    def m(self) -> int:
        """Number of inputs."""
        return self.B.shape[1]

    @property
    def p(self) -> int:
        """Number of outputs."""
        return len(self.outputs)

    @property
    def room(self) -> Array:
        """What the limits leave around the inputs at the equilibrium, on the nearer side; infinite for none, shape (m,)."""
        return np.minimum(self.upper - self.u_eq, self.u_eq - self.lower)  # type: ignore[operator]

    @cached_property
    def form(self) -> BlockForm:
        """The block form of (A, B); raises UserError for a pair that is not controllable."""
        return block_form(self.A, self.B, [q.name for q in self.states])

    @property
    def b(self) -> Array:
        """The only column of B, shape (n,); UserError for several inputs."""
        if self.m != 1:
            raise UserError(f"b is for systems with one input, found {self.m} inputs")
        return self.B[:, 0]

    def output(self, name: str, what: str = "output") -> int:
        """Return the index of an output.

        Parameters
        ----------
        name
            Its name.
        what
            What an error calls it.

        Returns
        -------
        int
            From 0.

        Raises
        ------
        UserError
            For another name.
        """
        return index_of(name, self.outputs, what, "outputs")

    def changed(self, **changes: Any) -> System:
        """Return the system with fields replaced; C stays absent where it was, and a new C has new outputs.

        Parameters
        ----------
        **changes
            Fields by name.

        Returns
        -------
        System
            Checked as a new one.
        """
        kept: dict[str, Any] = {"C": None, "outputs": (), "y_eq": None} if self.measures_state else {}
        return replace(self, **{**(OF_OUTPUTS if "C" in changes else kept), **changes})

    def with_lqr(self, Q: ArrayLike, R: ArrayLike) -> System:
        """Return the system with the gain of the linear-quadratic regulator, K = -R^-1 B' S.

        S solves A' S + S A - S B R^-1 B' S + Q = 0.

        Parameters
        ----------
        Q
            Weights of the states, shape (n, n), or (n,) for a diagonal.
        R
            Weights of the inputs, shape (m, m), or (m,).

        Returns
        -------
        System
            With K.

        Raises
        ------
        UserError
            For weights without a stabilizing solution, also where (A, B) is not controllable, and where none is found in
            double precision.
        """
        from .riccati import lqr_gain  # noqa: PLC0415 - needs SciPy

        return self.changed(K=lqr_gain(self.A, self.B, Q, R, [q.name for q in self.states]))

    @classmethod
    def from_state_space(cls, model: Any, K: ArrayLike | None = None, law: str | None = None, **rest: Any) -> System:
        """Return the system of a `control.StateSpace`, or of any object with A, B, C, D of a continuous-time model.

        Labels of the model become names where none are given. A C that is the unit matrix stands for measured states.

        Parameters
        ----------
        model
            With D = 0.
        K
            Gain of the linear controller, shape (m, n).
        law
            How K is meant: "u = K x" as here, or "u = -K x" as `control.lqr` returns it; with K it must be given.
        **rest
            Other fields of `System`.

        Returns
        -------
        System
            Checked as a new one.

        Raises
        ------
        UserError
            For another model, or a K without its law.

        Examples
        --------
        >>> from scipy.signal import StateSpace
        >>> model = StateSpace([[0, 1], [0, 0]], [[0], [1]], [[1, 0]], [[0]])
        >>> System.from_state_space(model, K=[[4, 4]], law="u = -K x", outputs=["position [m]"]).K.tolist()
        [[-4.0, -4.0]]
        """
        return cls(**{**fields_of_model(model, K, law), **rest})

    @classmethod
    def load(cls, path: FilePath) -> System:
        """Return the system of a TOML file.

        Parameters
        ----------
        path
            The file.

        Returns
        -------
        System
            Named after the file where the file does not name it.

        Raises
        ------
        UserError
            Names the file, the entry and its rule.
        """
        path = Path(path)
        data = read_toml(path, "system")
        try:
            return cls.from_dict({"name": re.sub(r"\W|^(?=\d)", "_", path.stem, flags=re.ASCII) or "system", **data})
        except UserError as error:
            raise UserError(f"{path}: {error}") from None

    @classmethod
    def from_dict(cls, data: Any) -> System:
        """Return the system that the entries of a file mean.

        Parameters
        ----------
        data
            Entries by name, in plain types, as a TOML file holds them and `as_dict` returns them.

        Returns
        -------
        System
            With the gain of the regulator where `lqr` gives its weights.

        Raises
        ------
        UserError
            Names the entry and its rule.

        Examples
        --------
        >>> System.from_dict({"A": [[0, 1], [0, 0]], "b": [0, 1], "k_lin": [-4, -4]}).K.tolist()
        [[-4.0, -4.0]]
        """
        fields, weights = fields_of(data)
        try:
            system = cls(**fields)
        except UserError as error:
            raise UserError(called_as_given(str(error), data)) from None
        return system.with_lqr(**weights) if weights else system

    def as_dict(self) -> dict[str, Any]:
        """Return the entries of a system file in plain types; what is as by default is left out.

        Returns
        -------
        dict
            Numbers, texts, and lists of them.
        """
        return entries_of(vars(self))

    def to_toml(self, comment: str = "") -> str:
        """Return the text of a TOML file that `load` reads.

        Parameters
        ----------
        comment
            Lines that stand at its head.

        Returns
        -------
        str
            The text.

        Examples
        --------
        >>> System(A=[[-1]], B=[2], name="tank").to_toml("of water").splitlines()[:3]
        ['# written by qube-ihc', '# of water', 'name = "tank"']
        """
        return toml_of(self.as_dict(), comment)

    def save(self, path: FilePath, comment: str = "") -> None:
        """Write the TOML file, whole or not at all.

        Parameters
        ----------
        path
            The file.
        comment
            Lines that stand at its head.

        Raises
        ------
        UserError
            Where it cannot be written, or would replace a file that is not this project's.
        """
        write_file(Path(path), self.to_toml(comment))
