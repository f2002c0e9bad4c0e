"""Base of the example plants: x' = rates(x, u) as a co-simulation FMU of PythonFMU, standard library only.

A subclass names its parameters, states and inputs, each with start value, unit and description, and gives `rates`. Every
state S is an output with the parameter S_0 as initial value, so that `qube-ihc linearize` finds the states; every input
has a second one, <input>_disturbance, that is added to it. PythonFMU writes no units: this class does.
"""

import math
from typing import ClassVar
from xml.etree.ElementTree import Element, SubElement

from pythonfmu import DefaultExperiment, Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

Quantities = dict[str, tuple[float, str, str]]
"""Start value, unit and description by name."""


class Quantity(Real):
    """A real variable with a unit."""

    def __init__(self, name, unit, **about):
        super().__init__(name, **about)
        self.unit = unit

    def to_xml(self):
        """Return the element of the model description."""
        element = super().to_xml()
        element.find("Real").set("unit", self.unit)
        return element


class Rk4Plant(Fmi2Slave):
    """Runge-Kutta steps of fourth order, each at most `internal_step` [s], with the inputs held."""

    parameters: ClassVar[Quantities] = {}
    states: ClassVar[Quantities] = {}
    inputs: ClassVar[Quantities] = {}
    sensors: ClassVar[Quantities] = {}
    """Outputs besides the states: methods of these names compute them; the start value is of no use."""
    internal_step = 1e-3
    default_experiment = DefaultExperiment(start_time=0.0, stop_time=10.0, step_size=1e-3)

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        fixed = {"causality": Fmi2Causality.parameter, "variability": Fmi2Variability.fixed}
        entering, leaving = {"causality": Fmi2Causality.input}, {"causality": Fmi2Causality.output}
        for name, quantity in self.parameters.items():
            self._add(name, quantity, fixed)
        for name, (value, unit, text) in self.states.items():
            self._add(f"{name}_0", (value, unit, f"initial {text}"), fixed)
            self._add(name, (value, unit, text), leaving)
        for name, (value, unit, text) in self.inputs.items():
            self._add(name, (value, unit, text), entering)
            self._add(f"{name}_disturbance", (0.0, unit, f"disturbance, added to {name}"), entering)
        for name, quantity in self.sensors.items():
            compute = getattr(self, name)
            self._add(name, quantity, {**leaving, "getter": compute, "setter": lambda value: None})

    def rates(self, x, u):
        """Return x' [states' units per s] for the states x and the inputs u, both lists."""
        raise NotImplementedError

    def enter_initialization_mode(self):
        """Take the initial values that are set so far, for outputs that are read in initialization."""
        self.exit_initialization_mode()

    def exit_initialization_mode(self):
        """Take the initial values."""
        self._take([getattr(self, f"{name}_0") for name in self.states])

    def do_step(self, current_time, step_size):
        """Advance by `step_size` [s]."""
        u = [getattr(self, name) + getattr(self, f"{name}_disturbance") for name in self.inputs]
        count = max(1, math.ceil(step_size / self.internal_step - 1e-9))
        x = [getattr(self, name) for name in self.states]
        for _ in range(count):
            x = self._stepped(x, u, step_size / count)
        self._take(x)
        return all(map(math.isfinite, x))

    def to_xml(self, model_options=None):
        """Return the model description, with units and with what is unknown at the start."""
        root = super().to_xml(model_options or {})
        units = Element("UnitDefinitions")
        for unit in sorted({v.unit for v in self.vars.values()}):
            SubElement(units, "Unit", name=unit)
        root.insert(1, units)
        structure = root.find("ModelStructure")
        unknowns = SubElement(structure, "InitialUnknowns")
        for output in structure.find("Outputs"):
            SubElement(unknowns, "Unknown", index=output.get("index"))
        return root

    def _add(self, name, quantity, about):
        value, unit, description = quantity
        if name not in self.sensors:
            setattr(self, name, value)
        self.register_variable(Quantity(name, unit, description=description, **about))

    def _take(self, x):
        for name, value in zip(self.states, x, strict=True):
            setattr(self, name, value)

    def _stepped(self, x, u, h):
        k1 = self.rates(x, u)
        k2 = self.rates([a + 0.5 * h * b for a, b in zip(x, k1, strict=True)], u)
        k3 = self.rates([a + 0.5 * h * b for a, b in zip(x, k2, strict=True)], u)
        k4 = self.rates([a + h * b for a, b in zip(x, k3, strict=True)], u)
        slopes = zip(x, k1, k2, k3, k4, strict=True)
        return [a + h / 6.0 * (b + 2.0 * c + 2.0 * d + e) for a, b, c, d, e in slopes]


def solved(M, f):
    """Return q'' of M q'' = f for a symmetric positive definite matrix M (rows), by Gauss' elimination."""
    n = len(f)
    rows = [[*M[i], f[i]] for i in range(n)]
    for i in range(n):
        for k in range(i + 1, n):
            factor = rows[k][i] / rows[i][i]
            rows[k] = [a - factor * b for a, b in zip(rows[k], rows[i], strict=True)]
    q = [0.0] * n
    for i in reversed(range(n)):
        q[i] = (rows[i][n] - sum(rows[i][k] * q[k] for k in range(i + 1, n))) / rows[i][i]
    return q
