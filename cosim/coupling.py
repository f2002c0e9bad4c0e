"""The coupling of FMUs by names, with all that can be checked of it before anything runs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from fmu_export.units import same_unit
from fmu_export.variables import did_you_mean

from .errors import UserError
from .fmu import RECORDED
from .integration import opened
from .structure import Signal, SystemStructure, Wire
from .unit_definitions import NO_UNIT, check_units, declared_unit, unit_in, unit_of


class Coupling:
    """The instances of a system with its wires resolved; construction checks everything that can be checked."""

    def __init__(self, system: SystemStructure) -> None:
        names = [c.name for c in system.components]
        if len(set(names)) != len(names) or not all(name.isidentifier() for name in names):
            raise UserError(f"instances need unique names of letters, digits and underscores, found {', '.join(names)}")
        self.instances = {c.name: opened(c.name, Path(c.path), c.interface) for c in system.components}
        self.start = {c.name: self.instances[c.name].checked_start(c.start) for c in system.components}
        self.wires = [(self._end(w.source, "output"), self._end(w.target, "input"), w) for w in system.wires]
        self._plain_wires = tuple(system.wires)
        self.signals = [(self._end(s.target, "input"), s) for s in system.signals]
        for source, target, wire in self.wires:
            self._check_wire(source, target, wire)
        for (instance, variable), _ in self.signals:
            kind = self.instances[instance].variables[variable].type
            if kind not in RECORDED:
                raise UserError(f"{instance}.{variable} cannot follow a function of time, it is a {kind}")
        self._check_single_sources()

    def drive(self, signals: Sequence[Signal]) -> None:
        """Replace the signals by others on the same inputs, in the same order."""
        self.signals = [(target, signal) for (target, _), signal in zip(self.signals, signals, strict=True)]

    def outputs(self) -> list[str]:
        """Return the names of all that is recorded by default: the outputs, and inputs whose signals want it."""
        return [
            *(f"{i.name}.{v.name}" for i in self.instances.values() for v in i.outputs()),
            *(".".join(target) for target, driver in self.signals if driver.recorded),
        ]

    def checked_outputs(self, names: Sequence[str] | None) -> list[str]:
        """Return the outputs to record, all for None; raise UserError for names that are not outputs."""
        if names is None:
            for instance in self.instances.values():
                if texts := instance.texts():
                    instance.messages.append(f"warning: String outputs are not recorded: {', '.join(texts)}")
            return self.outputs()
        driven = {".".join(target) for target, _ in self.signals}
        for name in names:
            instance, variable = self._end(name, "input" if name in driven else "output")
            kind = self.instances[instance].variables[variable].type
            if kind not in RECORDED:
                raise UserError(f"the output {name} cannot be recorded, it is a {kind}")
        if len(set(names)) != len(names):
            raise UserError(f"outputs to record must be named once each, found {', '.join(names)}")
        return list(names)

    def unit(self, name: str) -> str:
        """Return the unit of `instance.variable`, see `unit_in`."""
        return unit_in(name, {owner: one.variables for owner, one in self.instances.items()}, self._plain_wires)

    def _end(self, name: str, causality: str) -> tuple[str, str]:
        instance, variable = split(name)
        if not variable or instance not in self.instances:
            raise UserError(f"{name!r} names no instance's variable{did_you_mean(instance, self.instances)}")
        declared = self.instances[instance].variable(variable)
        if declared.causality != causality:
            raise UserError(f"{name} must be an {causality}, found {declared.causality}")
        return instance, variable

    def _check_wire(self, source: tuple[str, str], target: tuple[str, str], wire: Wire) -> None:
        a = self.instances[source[0]].variables[source[1]]
        b = self.instances[target[0]].variables[target[1]]
        text = f"the wire {'.'.join(source)} -> {'.'.join(target)}"
        if a.type != b.type:
            raise UserError(f"{text} must join equal types, found {a.type} and {b.type}")
        if a.type not in RECORDED:
            raise UserError(f"{text} must join numbers or Booleans, found {a.type}")
        if wire.converts:
            if a.type != "Real" or not (math.isfinite(wire.factor) and math.isfinite(wire.offset)):
                raise UserError(f"{text} may convert real numbers by finite ones, found {a.type}, {_conversion(wire)}")
            return
        check_units(wire, {name: instance.description for name, instance in self.instances.items()})
        units = declared_unit(a), declared_unit(b)
        if same_unit(*(unit or NO_UNIT for unit in units)) or same_unit(unit_of(a), unit_of(b)):
            return
        (owner, name), variable, unit = (target, b, units[0]) if units[0] else (source, a, units[1])
        described = unit_of(variable)
        but = "" if described == NO_UNIT else f", although its description says {described},"
        self.instances[owner].messages.append(f"warning: {name} declares no unit{but} and is taken to be in {unit}")

    def _check_single_sources(self) -> None:
        targets = [".".join(t) for _, t, _ in self.wires] + [".".join(t) for t, _ in self.signals]
        for target in targets:
            if targets.count(target) > 1:
                raise UserError(f"the input {target} must have one source, found {targets.count(target)}")


def split(name: str) -> tuple[str, str]:
    """Return (instance, variable) of `instance.variable`; a variable's name may have dots, an instance's has none."""
    instance, _, variable = name.partition(".")
    return instance, variable


def _conversion(wire: Wire) -> str:
    return f"factor {wire.factor:g} and offset {wire.offset:g}"
