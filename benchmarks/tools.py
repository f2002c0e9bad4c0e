"""The programs that `native_pair.py` compares, each run the way its users run a fixed step.

A tool's `run(steps)` runs the closed loop from t = 0 and returns the seconds that the stepping alone took, and the values
at the end. Where a tool loads, steps and frees in one call, the seconds are the difference of a long run and a short one.
"""

from __future__ import annotations

import ctypes
import logging
import os
import sys
import tempfile
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import fmpy
from fmpy.fmi2 import (
    FMU2Slave,
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
)
from fmpy.ssp.simulation import simulate_ssp

from benchmarks.monolithic import Monolithic
from cosim.master import simulate
from cosim.pendulum import WIRES
from cosim.pendulum_export import Kind, export_units
from cosim.rig import Engine, Order
from cosim.structure import Component, SystemStructure
from fmu_export.variables import Value
from ihc_fmu.pendulum.start_values import controller_start_values, default_design
from ihc_fmu.sliding_mode import fitted_smc
from plant_fmu.interface import start_values as plant_start_values

STEP = 1e-4
"""Communication step, and sample time of the controller [s]."""

CHANGES: dict[str, dict[str, Value]] = {"controller": {"sample_time": STEP}, "plant": {"delta_0": 0.1}}

ENDS = ("plant.theta", "plant.delta", "controller.mode")

SHORT_RUN = 10
"""Steps of the run that is subtracted where loading cannot be told from stepping."""

MANY, SOME, FEW = 10**9, 20_000, 5_000
"""Most steps of a timed run: as many as asked for, fewer for slow tools, fewest for the slowest."""

FirstInputs = Literal["outputs", "zeros"]
"""What a unit's inputs are in the first step: the other unit's initial outputs, or zeros."""


class NotInstalledError(Exception):
    """A tool that is left out; the message says how to get it."""


@dataclass(frozen=True)
class Pair:
    """The files of the closed loop, and the start values in them."""

    plant: Path
    controller: Path
    ssp: Path
    plant_start: dict[str, Value]
    controller_start: dict[str, Value]

    @property
    def system(self) -> SystemStructure:
        """The loop as this project's master takes it."""
        return SystemStructure(
            (Component("controller", self.controller), Component("plant", self.plant)), WIRES["encoders"]
        )


def export_pair(folder: Path, kind: Kind = Kind.native) -> Pair:
    """Export both FMUs and the SSP to `folder`."""
    design = default_design()
    plant, unit, ssp = export_units(design, output=folder, changes=CHANGES, kind=kind)
    start = controller_start_values(design, "ident", fitted_smc(design.A, design.b)) | CHANGES["controller"]
    return Pair(plant, unit, ssp, plant_start_values("ident") | CHANGES["plant"], start)


@dataclass(frozen=True)
class End:
    """Where a run ended [rad]; mode is None where a tool cannot read an enumeration."""

    theta: float
    delta: float
    mode: int | None

    def distance(self, other: End) -> float:
        """Return the largest difference of the angles [rad]; infinite where the modes differ."""
        if None not in (self.mode, other.mode) and self.mode != other.mode:
            return float("inf")
        return max(abs(self.theta - other.theta), abs(self.delta - other.delta))


class Tool(ABC):
    """A program that runs the closed loop."""

    records: str = "nothing"
    order: Order = "controller-first"
    first_inputs: FirstInputs = "outputs"
    most_steps: int = MANY

    @abstractmethod
    def run(self, steps: int) -> tuple[float, End]:
        """Return (seconds of stepping, the end) of a run of `steps` steps."""


def _by_difference(call: Callable[[int], End], steps: int) -> tuple[float, End]:
    """Return the seconds that `steps` steps take, from a run of so many and a short one, and where the long one ended."""
    start = time.perf_counter()
    call(SHORT_RUN)
    middle = time.perf_counter()
    end = call(steps)
    seconds = (time.perf_counter() - middle) - (middle - start)
    return seconds * steps / (steps - SHORT_RUN), end


def _timed(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


class MonolithicProgram(Tool):
    """One C program without FMI: the limit."""

    records = "all outputs"

    def __init__(self, pair: Pair) -> None:
        self.program = Monolithic(pair.plant_start, pair.controller_start)

    def run(self, steps: int) -> tuple[float, End]:
        return _by_difference(self._run, steps)

    def _run(self, steps: int) -> End:
        row = self.program.run(steps, STEP)[-1]
        return End(float(row["plant.theta"]), float(row["plant.delta"]), int(row["controller.mode"]))


class Master(Tool):
    """This project's master."""

    def __init__(
        self,
        pair: Pair,
        engine: Engine,
        order: Order = "controller-first",
        *,
        end_only: bool = False,
        most_steps: int = MANY,
    ) -> None:
        self.records = "3 outputs, at the end" if end_only else "all outputs"
        self.most_steps = min(most_steps, SOME) if engine == "fmpy" else most_steps
        self.system, self.order, self.end_only = pair.system, order, end_only
        self.engine: Engine = engine

    def run(self, steps: int) -> tuple[float, End]:
        return _by_difference(self._run, steps)

    def _run(self, steps: int) -> End:
        result = simulate(
            self.system,
            STEP,
            steps * STEP,
            self.order,
            engine=self.engine,
            record=ENDS if self.end_only else None,
            every=steps if self.end_only else 1,
        )
        theta, delta, mode = (result[name][-1] for name in ENDS)
        return End(float(theta), float(delta), int(mode))


class FmpyUnit:
    """One FMU in FMPy's FMU2Slave: unpacked once, instantiated for each run."""

    def __init__(self, path: Path) -> None:
        self.description = fmpy.read_model_description(str(path), validate=False)
        self.folder = fmpy.extract(str(path), tempfile.mkdtemp(dir=path.parent))
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}

    @contextmanager
    def running(self) -> Iterator[FMU2Slave]:
        """Give an instance that is ready to step."""
        assert self.description.coSimulation is not None
        fmu = FMU2Slave(
            guid=self.description.guid,
            unzipDirectory=self.folder,
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName=self.description.modelName,
        )
        fmu.instantiate(callbacks=_CALLBACKS)
        fmu.setupExperiment(startTime=0.0)
        fmu.enterInitializationMode()
        fmu.exitInitializationMode()
        try:
            yield fmu
        finally:
            fmu.terminate()
            fmu.freeInstance()

    def of(self, *names: str) -> list[Any]:
        """Return the value references of `names`."""
        return [self.references[name] for name in names]


_CALLBACKS = fmi2CallbackFunctions()
_CALLBACKS.logger = fmi2CallbackLoggerTYPE(lambda *_: None)
_CALLBACKS.allocateMemory = fmi2CallbackAllocateMemoryTYPE(fmpy.calloc)
_CALLBACKS.freeMemory = fmi2CallbackFreeMemoryTYPE(fmpy.free)


class FmpyLoop(Tool):
    """A loop over FMPy's FMU2Slave as a user writes it: setReal, doStep, getReal, a row appended to a list."""

    records, most_steps = "voltage, 4 angles", SOME

    def __init__(self, pair: Pair, order: Order = "controller-first", first_inputs: FirstInputs = "outputs") -> None:
        self.order, self.first_inputs = order, first_inputs
        self.plant, self.controller = FmpyUnit(pair.plant), FmpyUnit(pair.controller)
        self.angles = self.plant.of("theta_encoder", "delta_encoder", "theta", "delta")
        self.measured = self.controller.of("theta", "delta")
        self.commanded, self.voltage = self.controller.of("voltage"), self.plant.of("voltage")
        self.mode = self.controller.of("mode")

    def run(self, steps: int) -> tuple[float, End]:
        loop = self._controller_first if self.order == "controller-first" else self._parallel
        with self.controller.running() as controller, self.plant.running() as plant:
            rows: list[tuple[float, ...]] = []
            seconds = _timed(lambda: loop(controller, plant, steps, rows))
            theta, delta = rows[-1][-2:]
            return seconds, End(theta, delta, int(controller.getInteger(self.mode)[0]))

    def _controller_first(
        self, controller: FMU2Slave, plant: FMU2Slave, steps: int, rows: list[tuple[float, ...]]
    ) -> None:
        angles = plant.getReal(self.angles)
        for k in range(steps):
            time = k * STEP
            controller.setReal(self.measured, angles[:2])
            controller.doStep(time, STEP)
            voltage = controller.getReal(self.commanded)
            plant.setReal(self.voltage, voltage)
            plant.doStep(time, STEP)
            angles = plant.getReal(self.angles)
            rows.append((time + STEP, *voltage, *angles))

    def _parallel(self, controller: FMU2Slave, plant: FMU2Slave, steps: int, rows: list[tuple[float, ...]]) -> None:
        known = self.first_inputs == "outputs"
        angles = plant.getReal(self.angles) if known else [0.0] * 4
        voltage = controller.getReal(self.commanded) if known else [0.0]
        for k in range(steps):
            time = k * STEP
            controller.setReal(self.measured, angles[:2])
            plant.setReal(self.voltage, voltage)
            controller.doStep(time, STEP)
            plant.doStep(time, STEP)
            angles, voltage = plant.getReal(self.angles), controller.getReal(self.commanded)
            rows.append((time + STEP, *voltage, *angles))


class FmpySsp(Tool):
    """FMPy's `simulate_ssp`; its inputs are 0 in the first step."""

    records, most_steps = "all connectors", FEW
    order, first_inputs = "parallel", "zeros"

    def __init__(self, pair: Pair) -> None:
        self.ssp = str(pair.ssp)

    def run(self, steps: int) -> tuple[float, End]:
        return _by_difference(self._run, steps)

    def _run(self, steps: int) -> End:
        rows = simulate_ssp(self.ssp, stop_time=(steps - 0.5) * STEP, step_size=STEP)  # it steps while t < stop_time
        last: Any = rows[-1]
        return End(float(last["plant.theta"]), float(last["plant.delta"]), int(last["controller.mode"]))


class Libcosim(Tool):
    """libcosim from the SSP, `execution.step(n)`, without an observer; it cannot read enumerations.

    The observer that tells the end is added before the last step, which is not timed.
    """

    order, most_steps = "parallel", SOME

    def __init__(self, pair: Pair) -> None:
        try:
            from libcosimpy import CosimExecution, CosimLogging, CosimObserver  # noqa: PLC0415 # pyright: ignore
        except ImportError as error:
            raise NotInstalledError("not installed: pip install libcosimpy") from error
        CosimLogging.log_output_level(CosimLogging.CosimLogLevel.ERROR)
        self.executions, self.observers = CosimExecution.CosimExecution, CosimObserver.CosimObserver
        self.ssp = str(pair.ssp)

    def run(self, steps: int) -> tuple[float, End]:
        execution = self.executions.from_ssp_file(self.ssp, step_size=round(STEP * 1e9))
        seconds = _timed(lambda: _check(execution.step(steps - 1), "libcosim"))
        observer = self.observers.create_last_value()
        execution.add_observer(observer)
        _check(execution.step(1), "libcosim")
        plant = execution.slave_index_from_instance_name("plant")
        references = {v.name.decode(): v.reference for v in execution.slave_variables(plant)}
        theta, delta = observer.last_real_values(plant, [references["theta"], references["delta"]])
        return seconds * steps / (steps - 1), End(theta, delta, None)


class Ecos(Tool):
    """Ecos from the SSP, `simulation.step(n)`, without a CSV writer; it cannot read enumerations.

    It steps FMUs in parallel by threads; with FMUs as fast as these one thread is faster, so it gets one: its threads are
    counted, once per process, from the cores that the process may use when it first steps.
    """

    order = "parallel"

    def __init__(self, pair: Pair) -> None:
        for library in (Path(sys.prefix) / "lib").glob("libtbb.so.12"):  # of the package tbb
            ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
        try:
            from ecospy import EcosSimulation  # noqa: PLC0415 # pyright: ignore
        except ImportError as error:
            raise NotInstalledError("not installed: pip install ecospy tbb") from error
        except OSError as error:
            raise NotInstalledError(f"does not load ({error}): pip install tbb, or install the library") from error
        self.simulations, self.ssp = EcosSimulation, str(pair.ssp)
        with _one_core():
            self.run(SHORT_RUN)

    def run(self, steps: int) -> tuple[float, End]:
        simulation = self.simulations(STEP, ssp_path=self.ssp)
        _check(simulation.init(), "Ecos")
        seconds = _timed(lambda: simulation.step(steps))
        end = End(simulation.get_real("plant::theta"), simulation.get_real("plant::delta"), None)
        simulation.terminate()
        simulation.free()
        return seconds, end


@contextmanager
def _one_core() -> Iterator[None]:
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


def _check(worked: bool, tool: str) -> None:
    if not worked:
        raise RuntimeError(f"{tool} failed")


class Container(Tool):
    """An FMU Manipulation Toolbox container of both FMUs, sequential, stepped through FMPy.

    A doStep for each communication step, so that the host could record; or, with `whole`, one for the whole run, which the
    container divides into its own steps in C.
    """

    def __init__(self, pair: Pair, *, whole: bool = False) -> None:
        self.most_steps, self.whole = MANY if whole else SOME, whole
        self.unit = FmpyUnit(_container(pair))

    def run(self, steps: int) -> tuple[float, End]:
        with self.unit.running() as fmu:
            seconds = _timed(lambda: self._step(fmu, steps))
            theta, delta = fmu.getReal(self.unit.of("theta", "delta"))
            return seconds, End(theta, delta, int(fmu.getInteger(self.unit.of("mode"))[0]))

    def _step(self, fmu: FMU2Slave, steps: int) -> None:
        if self.whole:
            fmu.doStep(0.0, steps * STEP)
            return
        for k in range(steps):
            fmu.doStep(k * STEP, STEP)


def _container(pair: Pair) -> Path:
    """Build the container beside the FMUs; return its path."""
    try:
        from fmu_manipulation_toolbox.assembly import AssemblyNode  # noqa: PLC0415 # pyright: ignore
    except ImportError as error:
        raise NotInstalledError("not installed: pip install fmu-manipulation-toolbox") from error
    logging.getLogger("fmu_manipulation_toolbox").setLevel(logging.CRITICAL)
    path = pair.plant.with_name("Container.fmu")
    node = AssemblyNode(path.name, STEP, sequential=True, auto_link=False, auto_input=False, auto_output=False)
    files = {"controller": pair.controller.name, "plant": pair.plant.name}
    for file in files.values():
        node.add_fmu(file)
    for wire in WIRES["encoders"]:
        (source, output), (target, variable) = wire.source.split("."), wire.target.split(".")
        node.add_link(files[source], output, files[target], variable)
    for unit, variable in (("plant", "theta"), ("plant", "delta"), ("controller", "mode")):
        node.add_output(files[unit], variable, variable)
    node.make_fmu(pair.plant.parent, filename=str(path))
    return path


MONOLITHIC = "one C program, no FMI (the limit)"
NATIVE = "qube-ihc, engine native"

TOOLS: dict[str, Callable[[Pair], Tool]] = {
    MONOLITHIC: MonolithicProgram,
    NATIVE: lambda pair: Master(pair, "native"),
    "qube-ihc, engine native, end only": lambda pair: Master(pair, "native", end_only=True),
    "qube-ihc, engine fmpy": lambda pair: Master(pair, "fmpy"),
    "qube-ihc, Python FMUs": lambda pair: Master(
        export_pair(pair.plant.parent / "python", Kind.python), "auto", most_steps=FEW
    ),
    "FMPy, loop over FMU2Slave": FmpyLoop,
    "FMPy, simulate_ssp": FmpySsp,
    "libcosim (libcosimpy)": Libcosim,
    "Ecos (ecospy), one thread": Ecos,
    "FMU container (fmu-manipulation-toolbox), FMPy doStep": Container,
    "FMU container (fmu-manipulation-toolbox), one doStep": lambda pair: Container(pair, whole=True),
}
"""All tools, in the order of their turns; making one raises NotInstalledError where its package is missing."""


def reference(pair: Pair, tool: Tool, steps: int) -> End:
    """Return where this project's master ends in the tool's order; a loop over FMPy where the first inputs are zeros."""
    if tool.first_inputs == "zeros":
        return FmpyLoop(pair, tool.order, "zeros").run(steps)[1]
    return Master(pair, "native", tool.order).run(steps)[1]
