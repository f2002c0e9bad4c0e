"""A linear system x' = A x + B u, y = C x with the names, units, limits and sensors that its controller needs to know.

It is made from arrays, from a `control.StateSpace` or from a TOML file:

    name = "crane"
    A = [[0, 1, 0, 0], [0, -0.5, 2.4, 0], [0, 0, 0, 1], [0, -1.1, -27.0, -0.1]]
    B = [[0], [1.0], [0], [2.2]]            # b = [...] for one input
    K = [[-3.2, -4.1, 9.0, 0.6]]            # u = K x, k_lin = [...] for one input; or lqr = { Q = [...], R = [...] }
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from filing.files import write_file
from filing.origin import WRITTEN
from fmu_export.errors import UserError, counted, shown
from fmu_export.files import FilePath
from fmu_export.reading import read_toml
from fmu_export.variables import did_you_mean

from .block_form import BlockForm, block_form
from .riccati import regulator_gain, unseen_frequency

Array = np.ndarray

QUIET = np.errstate(over="ignore", invalid="ignore", divide="ignore")
"""Numbers beyond the range end in a refusal, by the block form, the certificate or a check, not in warnings."""
LARGEST = 1e300
"""Numbers of a system are smaller."""
LONGEST_NAME = 100
"""Most characters of a name or a unit."""
DIRECT = "direct"
"""In place of a gain of integral action: choose one."""
PENDULUM = "rotary_pendulum"
"""Name of the systems whose controller is the pendulum's, with swing-up."""
GAIN_CONVENTIONS = ("u = K x", "u = -K x")
"""How a gain may be meant."""


class Quantity(NamedTuple):
    """A state, an input or an output.

    Parameters
    ----------
    name
        Its name.
    unit
        Its unit, "1" for none.
    """

    name: str
    unit: str = "1"

    def __str__(self) -> str:
        return self.name if self.unit == "1" else f"{self.name} [{self.unit}]"

    @property
    def suffix(self) -> str:
        """What stands behind a number: a blank and the unit, nothing without one."""
        return "" if self.unit == "1" else f" {self.unit}"

    @classmethod
    def parse(cls, text: str, what: str = "a quantity") -> Quantity:
        """Return the quantity that "position [m]" or "position" means; the bracket of a unit stands behind a blank.

        Parameters
        ----------
        text
            Name and perhaps a unit.
        what
            What an error calls it.

        Returns
        -------
        Quantity
            Name and unit.

        Raises
        ------
        UserError
            For a text without a printable name, or one that is too long.
        """
        match = re.fullmatch(r"(.*\S)\s+\[([^\[\]]+)\]", text.strip())
        name, unit = (match[1], match[2].strip()) if match else (text.strip(), "1")
        for part in (name, unit):
            if not part or len(part) > LONGEST_NAME or not part.isprintable():
                raise UserError(f"{what} must be a printable name and perhaps a [unit], found {shown(text)}")
        return cls(name, unit)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ObserverWish:
    """A homogeneous observer in place of a Kalman filter: its linear gain and its numbers, None: chosen.

    L (n, p): A + L C is Hurwitz; or poles (n,): its eigenvalues, real [1/s]; or Q (n, n) or (n,), R (p, p) or (p,): weights
    of the dual of an LQ regulator, L = -S C' R^-1. nu in [-1, 0]: degree. q_min, q_max > 0: limits of |C z - y| in the gain;
    q_linear > 0: where the gain is L. Raises UserError that names the entry.
    """

    L: Array | None = None
    poles: Array | None = None
    Q: Array | None = None
    R: Array | None = None
    nu: float | None = None
    q_min: float | None = None
    q_max: float | None = None
    q_linear: float | None = None

    def __post_init__(self) -> None:
        for name in ("L", "poles", "Q", "R"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _matrix(f"observer.{name}", getattr(self, name), flat=True))
        ways = sum(given is not None for given in (self.L, self.poles, self.Q))
        if (self.Q is None) != (self.R is None) or ways > 1:
            raise UserError("observer must have L, or poles, or both Q and R, or none of them")
        if self.poles is not None and not (self.poles < 0.0).all():
            raise UserError(f"observer.poles must be negative [1/s], found {self.poles.max():g}")
        if self.nu is not None and not -1.0 <= self.nu <= 0.0:
            raise UserError(f"observer.nu must lie in [-1, 0], found {self.nu:g}")
        for name in ("q_min", "q_max", "q_linear"):
            value = getattr(self, name)
            if value is not None and not 0.0 < value < LARGEST:
                raise UserError(f"observer.{name} must be positive and finite, found {value:g}")

    @classmethod
    def from_table(cls, table: object) -> ObserverWish:
        """Return the wish of a table of entries."""
        names = [f.name for f in fields(cls)]
        if not isinstance(table, Mapping) or not set(table) <= set(names):
            raise UserError(f"observer must be a table of {', '.join(names)}, found {shown(table)}")
        for name, value in table.items():
            if name in ("L", "poles", "Q", "R"):
                _check_weights(f"observer.{name}", value)
            else:
                _check_numbers(f"observer.{name}", value, 0)
        return cls(**table)

    def as_table(self) -> dict[str, Any]:
        """Return what `from_table` reads, in plain types."""
        given = {f.name: getattr(self, f.name) for f in fields(self)}
        return {
            name: value.tolist() if isinstance(value, np.ndarray) else value
            for name, value in given.items()
            if value is not None
        }


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
        self._set("A", _matrix("A", self.A))
        n = len(self.A)
        if n == 0 or self.A.shape != (n, n):
            raise UserError(f"A must be a square matrix, found shape {self.A.shape}")
        B = _matrix("B", self.B, flat=True)
        self._set("B", B[:, None] if B.ndim == 1 else B)
        if self.B.shape[0] != n or self.B.shape[1] == 0:
            empty = " and columns" if not self.B.shape[1] else ""
            raise UserError(f"B must have {counted(n, 'row')}{empty} to fit A, found shape {self.B.shape}")
        m = self.B.shape[1]
        self._set("measures_state", self.C is None)
        self._set("C", np.eye(n) if self.C is None else _matrix("C", self.C))
        assert self.C is not None
        if self.C.shape[1] != n or not len(self.C):
            raise UserError(f"C must have {counted(n, 'column')} to fit A, found shape {self.C.shape}")
        for i, row in enumerate(self.C):
            if not row.any():
                raise UserError(f"C must have no row of zeros, found that output {i + 1} measures nothing")
        if self.K is not None:
            K = _matrix("K", self.K, flat=True)
            self._set("K", K[None, :] if K.ndim == 1 else K)
            if self.K.shape != (m, n):
                raise UserError(f"K must have {_rows(m, n)} to fit B and A, found shape {self.K.shape}")
        if isinstance(self.integral, str) and self.integral != DIRECT:
            raise UserError(f'integral must be rows of numbers or "{DIRECT}", found {shown(self.integral)}')
        if self.integral is not None and not isinstance(self.integral, str):
            K_i = np.asarray(self.integral, dtype=float)
            self._set("integral", _matrix("integral", K_i[None, :] if K_i.ndim == 1 else K_i))
            if np.shape(self.integral) != (m, n):
                raise UserError(
                    f"integral must have {_rows(m, n)} to fit B and A, found shape {np.shape(self.integral)}"
                )
        self._take_names(n, m, len(self.C))
        self._take_vectors(n, m, len(self.C))
        self._check_observer(n, len(self.C))
        for value in (getattr(self, f.name) for f in fields(self)):
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    def _set(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    def _take_names(self, n: int, m: int, p: int) -> None:
        if not self.name.isidentifier() or not self.name.isascii() or len(self.name) > LONGEST_NAME:
            raise UserError(f"name must be a short C identifier, found {shown(self.name)}")
        if self.measures_state and self.outputs:
            raise UserError("outputs must come with C; without C the states are measured")
        for kind, letter, count in (("states", "x", n), ("inputs", "u", m), ("outputs", "y", p)):
            given = getattr(self, kind) or [f"{letter}{i}" for i in range(1, count + 1)]
            found = tuple(q if isinstance(q, Quantity) else Quantity.parse(q, f"each of {kind}") for q in given)
            if len(found) != count:
                raise UserError(f"{kind} must be {counted(count, 'name')} to fit the matrices, found {len(found)}")
            self._set(kind, found)
        if self.measures_state:
            self._set("outputs", self.states)
        for one, others in (("states", "states"), ("inputs", "inputs"), ("outputs", "outputs")):
            _check_unique([q.name for q in getattr(self, one)], others)
        both = {q.name for q in self.inputs} & {q.name for q in (*self.states, *self.outputs)}
        if both:
            raise UserError(f"inputs must have other names than states and outputs, found {shown(min(both))} twice")
        for kind in ("set_points", "biases"):
            self._set(kind, tuple(getattr(self, kind)))
            _check_unique(getattr(self, kind), kind)
            for name in getattr(self, kind):
                self.output(name, kind)

    def _take_vectors(self, n: int, m: int, p: int) -> None:
        for name, count, of, default in (
            ("x_eq", n, "state", 0.0),
            ("u_eq", m, "input", 0.0),
            ("y_eq", p, "output", 0.0),
            ("resolutions", p, "output", 0.0),
            ("deviations", p, "output", 0.0),
            ("lower", m, "input", -np.inf),
            ("upper", m, "input", np.inf),
        ):
            value = getattr(self, name)
            if name == "y_eq" and self.measures_state:
                value = self._measured_equilibrium(value)
            value = np.full(count, default) if value is None else np.array(value, dtype=float)
            if value.shape != (count,):
                size = len(value) if value.ndim == 1 else f"shape {value.shape}"
                raise UserError(f"{_in_files(name)} must be as many as {of}s, {count}, found {size}")
            self._set(name, value)
        for name in ("x_eq", "u_eq", "y_eq", "resolutions", "deviations"):
            _matrix(_in_files(name), getattr(self, name)[None, :])
        for name in ("resolutions", "deviations"):
            if (getattr(self, name) < 0.0).any():
                raise UserError(f"{name} must not be negative, found {getattr(self, name).min():g}")
        assert self.lower is not None
        assert self.upper is not None
        assert self.u_eq is not None
        for q, low, high, at_rest in zip(self.inputs, self.lower, self.upper, self.u_eq, strict=True):
            if not low < high:
                raise UserError(f"limits must be apart, lower below upper, found {low:g} and {high:g} for {q.name}")
            if not low < at_rest < high:
                raise UserError(
                    f"limits must leave room around the inputs at the equilibrium, found {low:g} and {high:g} around "
                    f"{q.name} = {at_rest:g}"
                )
        if not 0.0 < self.sample_time < LARGEST:
            raise UserError(f"sample_time must be positive and finite [s], found {self.sample_time}")
        if self.bandwidth is not None and not 0.0 <= self.bandwidth < LARGEST:
            raise UserError(f"bandwidth must be 0 or more and finite [rad/s], found {self.bandwidth}")

    def _measured_equilibrium(self, y_eq: object) -> object:
        """Return y_eq of measured states, which is x_eq."""
        if y_eq is not None and not np.array_equal(np.asarray(y_eq, dtype=float), np.asarray(self.x_eq)):
            raise UserError(
                "equilibrium.outputs must be left out without C, as the outputs are the states, found "
                f"{shown(np.asarray(y_eq).tolist())}"
            )
        return self.x_eq

    def _check_observer(self, n: int, p: int) -> None:
        if self.integral is not None and (self.observer is not None or self.bandwidth == 0.0):
            raise UserError(
                "integral needs states that a disturbance does not falsify: measured, or of a Kalman filter that estimates "
                f"disturbances, found {'observer' if self.observer is not None else 'bandwidth = 0'}"
            )
        if self.observer is None:
            return
        if self.measures_state:
            raise UserError("observer is for outputs y = C x; without C the states are measured")
        if self.biases or self.bandwidth is not None:
            name = "biases" if self.biases else "bandwidth"
            raise UserError(f"{name} must be left out with observer: only a Kalman filter estimates such")
        L = self.observer.L
        if L is not None and L.shape != (n, p):
            if L.shape != (n,) or p != 1:
                raise UserError(f"observer.L must have {_rows(n, p)} to fit A and C, found shape {L.shape}")
            self._set("observer", replace(self.observer, L=L[:, None]))

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
        names = [q.name for q in self.outputs]
        if name not in names:
            raise UserError(f"{what} must name outputs, found {shown(name)}{did_you_mean(name, names)}")
        return names.index(name)

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
        if "C" in changes:
            kept = {"y_eq": None, "resolutions": None, "deviations": None, **dict.fromkeys(_OF_OUTPUTS, ())}
        return replace(self, **{**kept, **changes})

    @QUIET
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
        weights = []
        for name, value, size in (("Q", Q, self.n), ("R", R, self.m)):
            W = np.asarray(value, dtype=float)
            W = np.diag(W) if W.ndim == 1 else W
            if W.shape != (size, size) or not np.isfinite(W).all() or np.abs(W - W.T).max() > 1e-9 * np.abs(W).max():
                raise UserError(
                    f"lqr.{name} must be {counted(size, 'number')}, or a symmetric matrix of that size, found {shown(value)}"
                )
            least = float(np.linalg.eigvalsh(W)[0])
            if least < (0.0 if name == "Q" else 1e-300):
                rule = "positive semidefinite" if name == "Q" else "positive definite"
                raise UserError(f"lqr.{name} must be {rule}, found the eigenvalue {least:g}")
            weights.append(W)
        unseen = unseen_frequency(self.A, self.B, weights[0])
        if unseen is not None:
            _ = self.form  # refuses a pair that is not controllable, by its state
            raise UserError(
                "lqr has no stabilizing solution: Q must weigh all that neither grows nor decays, found a motion at "
                f"{unseen:.4g} rad/s that it does not"
            )
        K = regulator_gain(self.A, self.B, *weights)
        if K is not None and np.linalg.eigvals(self.A + self.B @ K).real.max() < 0.0:
            return self.changed(K=K)
        _ = self.form
        raise UserError(
            "lqr could not be decided in double precision: no gain that stabilizes was found, although (A, B) is "
            "controllable; other weights, or states in other units, may do"
        )

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
        """
        if not all(hasattr(model, name) for name in "ABCD"):
            raise UserError(f"the model must have A, B, C and D, found a {type(model).__name__}")
        if getattr(model, "dt", None) not in (None, 0):
            raise UserError(f"the model must be in continuous time, found dt = {model.dt}")
        D = np.asarray(model.D, dtype=float)
        for i, j in np.argwhere(D)[:1]:
            labels = [getattr(model, f"{kind}_labels", None) for kind in ("input", "output")]
            names = [
                label[k] if label else f"{kind}{k + 1}" for label, k, kind in zip(labels, (j, i), "uy", strict=True)
            ]
            raise UserError(f"the model must have D = 0, found {D[i, j]:g} from {names[0]} to {names[1]}")
        C = np.asarray(model.C, dtype=float)
        given: dict[str, Any] = {"A": np.asarray(model.A), "B": np.asarray(model.B), "K": meant(K, law)}
        if C.shape != np.shape(model.A) or not np.array_equal(C, np.eye(len(C))):
            given["C"] = C
        for name, label in (("states", "state_labels"), ("inputs", "input_labels"), ("outputs", "output_labels")):
            if getattr(model, label, None) and not (name == "outputs" and "C" not in given):
                given[name] = tuple(getattr(model, label))
        return cls(**{**given, **rest})

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
            return from_dict({"name": re.sub(r"\W|^(?=\d)", "_", path.stem, flags=re.ASCII) or "system", **data})
        except UserError as error:
            raise UserError(f"{path}: {error}") from None

    def as_dict(self) -> dict[str, Any]:
        """Return the entries of a system file in plain types; what is as by default is left out.

        Returns
        -------
        dict
            Numbers, texts, and lists of them.
        """
        assert self.lower is not None
        assert self.upper is not None
        found: dict[str, Any] = {"name": self.name, "A": self.A.tolist(), "B": self.B.tolist()}
        if not self.measures_state:
            assert self.C is not None
            found["C"] = self.C.tolist()
        if self.K is not None:
            found["K"] = self.K.tolist()
        found |= {kind: [str(q) for q in getattr(self, kind)] for kind in ("states", "inputs")}
        if not self.measures_state:
            found["outputs"] = [str(q) for q in self.outputs]
        if np.isfinite(self.lower).any() or np.isfinite(self.upper).any():
            found["limits"] = [[float(low), float(high)] for low, high in zip(self.lower, self.upper, strict=True)]
        for name in ("resolutions", "deviations"):
            if getattr(self, name).any():
                found[name] = getattr(self, name).tolist()
        found["sample_time"] = self.sample_time
        if self.x_eq.any() or self.u_eq.any() or self.y_eq.any():  # type: ignore[union-attr]
            names = [("states", self.x_eq), ("inputs", self.u_eq)]
            names += [] if self.measures_state else [("outputs", self.y_eq)]
            found["equilibrium"] = {name: value.tolist() for name, value in names}  # type: ignore[union-attr]
        for name in ("set_points", "biases"):
            if getattr(self, name):
                found[name] = list(getattr(self, name))
        if self.bandwidth is not None:
            found["bandwidth"] = self.bandwidth
        if self.integral is not None:
            found["integral"] = self.integral if isinstance(self.integral, str) else self.integral.tolist()
        if self.observer is not None:
            found["observer"] = self.observer.as_table()
        return found

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
        """
        import tomli_w  # noqa: PLC0415

        head = [f"# {line}".rstrip() for line in (WRITTEN, *comment.splitlines())]
        rows, entries = {}, self.as_dict()
        for name in ("A", "B", "C", "K"):  # a row a line, which no writer of TOML does
            data = entries.get(name)
            if data is not None:
                lines = ",\n".join(f"    [{', '.join(map(repr, row))}]" for row in data)
                rows[name] = f"{name} = [\n{lines},\n]\n"
        rest = {name: value for name, value in entries.items() if name not in rows}
        text = tomli_w.dumps({"name": rest.pop("name")}) + "".join(rows.values()) + tomli_w.dumps(rest)
        return "\n".join(head) + "\n" + text

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


_OF_OUTPUTS = ("outputs", "set_points", "biases")


def meant(K: ArrayLike | None, law: str | None) -> Array | None:
    """Return the gain of u = K x, given one and how it is meant, "u = K x", also "u = +K x", or "u = -K x".

    Raises UserError where a gain comes without `law`: toolboxes differ, and a sign is not guessed.
    """
    if K is None:
        return None
    if law == "u = +K x":
        law = GAIN_CONVENTIONS[0]
    if law not in GAIN_CONVENTIONS:
        raise UserError(f"law must say how K is meant, {' or '.join(map(repr, GAIN_CONVENTIONS))}, found {law!r}")
    return np.asarray(K, dtype=float) if law == GAIN_CONVENTIONS[0] else -np.asarray(K, dtype=float)


def _in_files(name: str) -> str:
    """Return what files call a field."""
    return {
        "lower": "limits",
        "upper": "limits",
        **{field: f"equilibrium.{k}" for k, field in _EQUILIBRIUM.items()},
    }.get(name, name)


def _rows(count: int, length: int) -> str:
    return f"{counted(count, 'row')} of {counted(length, 'number')}"


def _check_unique(names: Sequence[str], kind: str) -> None:
    for name in names:
        if names.count(name) > 1:
            raise UserError(f"{kind} must have different names, found {shown(name)} twice")


def vector(what: str, values: ArrayLike, quantities: Sequence[Quantity]) -> Array:
    """Return a number for each quantity as an array; raise UserError that calls them `what` for another length."""
    names = [q.name for q in quantities]
    try:
        found = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        found = None
    if found is None or found.shape != (len(names),):
        seen = shown(values) if found is None or found.ndim == 0 else f"shape {found.shape}"
        raise UserError(f"{what} must be {counted(len(names), 'number')}, {', '.join(names)}, found {seen}")
    return found


def _matrix(name: str, value: object, *, flat: bool = False) -> Array:
    """Return a matrix of finite numbers; with `flat` a row of numbers may stand for a column."""
    try:
        found = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise UserError(f"{name} must be rows of numbers, all of one length, found {shown(value)}") from None
    if found.ndim != 2 and not (flat and found.ndim == 1):
        raise UserError(f"{name} must be rows of numbers, all of one length, found shape {found.shape}")
    if not (np.abs(found) < LARGEST).all():
        raise UserError(f"{name} must be finite, found {found[~(np.abs(found) < LARGEST)].flat[0]}")
    return found


_ALIASES = {"b": "B", "k_lin": "K"}
"""Names for one input, whose values are rows."""
_VECTORS = ("resolutions", "deviations")
_TEXTS = ("states", "inputs", "outputs", "set_points", "biases")
_EQUILIBRIUM = {"states": "x_eq", "inputs": "u_eq", "outputs": "y_eq"}
ENTRIES = (
    *("name", "A", "B", "b", "C", "K", "k_lin", "lqr", *_TEXTS, "limits", *_VECTORS),
    *("sample_time", "equilibrium", "bandwidth", "integral", "observer"),
)
"""Entries of a system file."""


def from_dict(data: object) -> System:
    """Return the system that the entries of a file mean; raise UserError that names the entry, the rule and the value."""
    if not isinstance(data, Mapping):
        raise UserError(f"a system must be a table of entries, found {shown(data)}")
    try:
        return _system_of(data)
    except UserError as error:
        raise UserError(_called_as_given(str(error), data)) from None


def _system_of(data: Mapping[Any, Any]) -> System:
    for name in data:
        if name not in ENTRIES:
            raise UserError(f"a system has no entry {shown(name)}{did_you_mean(str(name), ENTRIES)}")
    for short, long in (*_ALIASES.items(), ("lqr", "K"), ("lqr", "k_lin")):
        if short in data and long in data:
            raise UserError(f"a system has {short} or {long}, found both")
    given = {_ALIASES.get(name, name): value for name, value in data.items()}
    for name in ("A", "B"):
        if name not in given:
            raise UserError(f"a system must have {name}")
    found = {name: _READERS[name](name, value) for name, value in given.items() if name in _READERS}
    found |= _limits(given.get("limits")) | _equilibrium(given.get("equilibrium", {}))
    system = System(**found)
    return _with_lqr(system, given["lqr"]) if "lqr" in given else system


def _called_as_given(message: str, data: Mapping[Any, Any]) -> str:
    """Return a message about an entry by the name that the file has for it: k_lin for K, b for B."""
    name, blank, rest = message.partition(" ")
    short = {long: short for short, long in _ALIASES.items() if short in data}.get(name, name)
    return f"{short}{blank}{rest}"


def _read_text(name: str, value: object) -> str:
    if not isinstance(value, str):
        raise UserError(f"{name} must be a text, found {shown(value)}")
    return value


def _read_texts(name: str, value: object) -> tuple[str, ...]:
    if not isinstance(value, list):
        raise UserError(f"{name} must be a list of texts, found {shown(value)}")
    return tuple(_read_text(f"each of {name}", entry) for entry in value)


def _read_rows(name: str, value: Any) -> Any:
    return _check_numbers(name, value, 1 if name in ("B", "K") and _is_row(value) else 2)


def _read_integral(name: str, value: Any) -> Any:
    return (
        value if isinstance(value, str) else _check_numbers(name, value, 1 if _is_row(value) else 2, f'or "{DIRECT}"')
    )


def _read_number(name: str, value: Any) -> float:
    return float(_check_numbers(name, value, 0))


def _is_row(value: object) -> bool:
    return isinstance(value, list) and not any(isinstance(entry, list) for entry in value)


def _check_numbers(name: str, value: Any, levels: int, otherwise: str = "") -> Any:
    """Return a number, a list or a list of lists of numbers; raise UserError that names it for anything else.

    `otherwise` says what else it could have been.
    """
    if not _are_numbers(value, levels):
        kind = ("a number", "a list of numbers", "rows of numbers")[levels]
        raise UserError(f"{name} must be {kind}{' ' + otherwise if otherwise else ''}, found {shown(value)}")
    return value


def _check_weights(name: str, value: Any) -> Any:
    """Return a matrix of weights or the list of its diagonal; raise UserError that names it for anything else."""
    row = _is_row(value)
    return _check_numbers(name, value, 1 if row else 2, "" if row else "or a list of them")


def _are_numbers(value: object, levels: int) -> bool:
    if not levels:
        return not isinstance(value, bool) and isinstance(value, int | float)
    return isinstance(value, list) and all(_are_numbers(entry, levels - 1) for entry in value)


def _limits(value: Any) -> dict[str, Any]:
    """Return lower and upper from `limits`: per input a number for both sides, or [lower, upper]."""
    if value is None:
        return {}
    if not isinstance(value, list) or not all(
        _are_numbers(entry, 0) or (_are_numbers(entry, 1) and len(entry) == 2) for entry in value
    ):
        raise UserError(f"limits must be a number or [lower, upper] per input, found {shown(value)}")
    for entry in value:
        if not isinstance(entry, list) and not entry > 0.0:
            raise UserError(f"limits must be positive where one number is for both sides, found {entry:g}")
    pairs = [entry if isinstance(entry, list) else [-entry, entry] for entry in value]
    return {"lower": [low for low, _ in pairs], "upper": [high for _, high in pairs]}


def _equilibrium(value: Any) -> dict[str, Any]:
    if not isinstance(value, dict) or not set(value) <= set(_EQUILIBRIUM):
        raise UserError(f"equilibrium must be a table of states, inputs, outputs, found {shown(value)}")
    return {_EQUILIBRIUM[name]: _check_numbers(f"equilibrium.{name}", entry, 1) for name, entry in value.items()}


def _with_lqr(system: System, value: Any) -> System:
    if not isinstance(value, dict) or set(value) != {"Q", "R"}:
        raise UserError(f"lqr must be a table of Q and R, found {shown(value)}")
    weights = {name: _check_weights(f"lqr.{name}", W) for name, W in value.items()}
    return system.with_lqr(**{name: _matrix(f"lqr.{name}", W, flat=True) for name, W in weights.items()})


_READERS: dict[str, Callable[[str, Any], Any]] = {
    "name": _read_text,
    **dict.fromkeys(("A", "B", "C", "K"), _read_rows),
    "integral": _read_integral,
    "observer": lambda _, value: ObserverWish.from_table(value),
    **dict.fromkeys(_VECTORS, partial(_check_numbers, levels=1)),
    **dict.fromkeys(_TEXTS, _read_texts),
    **dict.fromkeys(("sample_time", "bandwidth"), _read_number),
}
"""How the entries of a file become fields of the same names."""
