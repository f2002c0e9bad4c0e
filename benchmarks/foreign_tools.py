"""The exported pair in other people's tools, each in a virtual environment of its own: does it run, and to the same end?

    python -m benchmarks.foreign_tools [--environments FOLDER] [--only NAME ...]

Each tool closes the loop for 500 steps of 1 ms from a tilt of 0.1 rad. Where it ends is compared with our own master
in the same coupling order. A tool that cannot be installed or does not run is named with its reason. Tools that take every
output for a real number get the pair exported with `--outputs`.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from cosim.master import simulate
from cosim.pendulum import WIRES
from cosim.pendulum_export import export_units
from cosim.rig import Order
from cosim.structure import Component, SystemStructure
from ihc_fmu.pendulum.start_values import default_design

STEP, STEPS = 1e-3, 500
ENDS = ("plant.theta_encoder", "plant.delta_encoder")
REAL_ONLY = ("controller.voltage", *ENDS)

WIRED = """
import json, sys
folder, step, steps = sys.argv[1], float(sys.argv[2]), int(sys.argv[3])
files = {"controller": f"{folder}/IhcController.fmu", "plant": f"{folder}/QubeServo2.fmu"}
wires = [("controller", "voltage", "plant", "voltage"), ("plant", "theta_encoder", "controller", "theta"),
         ("plant", "delta_encoder", "controller", "delta")]
ssp = f"{folder}/QubeWithController.ssp"
"""

FMPY = """
from fmpy.ssp.simulation import simulate_ssp
last = simulate_ssp(ssp, stop_time=(steps - 0.5) * step, step_size=step)[-1]
end = [last["plant.theta_encoder"], last["plant.delta_encoder"]]
"""

LIBCOSIM = """
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimObserver import CosimObserver
execution = CosimExecution.from_ssp_file(ssp, step_size=round(step * 1e9))
observer = CosimObserver.create_last_value()
execution.add_observer(observer)
assert execution.step(steps)
plant = execution.slave_index_from_instance_name("plant")
references = {v.name.decode(): v.reference for v in execution.slave_variables(plant)}
end = observer.last_real_values(plant, [references["theta_encoder"], references["delta_encoder"]])
"""

ECOS = """
import ctypes, pathlib
for library in (pathlib.Path(sys.prefix) / "lib").glob("libtbb.so.12"):
    ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
from ecospy import EcosSimulation
simulation = EcosSimulation(step, ssp_path=ssp)
simulation.init()
simulation.step(steps)
end = [simulation.get_real(f"plant::{name}_encoder") for name in ("theta", "delta")]
simulation.terminate()
"""

SOFIRPY = """
import sofirpy
connections = {name: [] for name in files}
for a, x, b, y in wires:
    connections[b].append({"parameter_name": y, "connect_to_system": a, "connect_to_external_parameter": x})
names = ["theta_encoder", "delta_encoder"]
options = {"fmu_paths": files, "connections_config": connections, "parameters_to_log": {"plant": names}}
table = sofirpy.simulate(steps * step, step, **options)
end = [float(table[f"plant.{name}"].iloc[-1]) for name in names]
"""

COFMUPY = """
import tempfile
from cofmupy.coordinator import Coordinator
def place(unit, variable):
    return {"id": unit, "variable": variable, "unit": "", "type": "fmu"}
with tempfile.NamedTemporaryFile("w", suffix=".json") as file:
    json.dump({
        "root": "", "cosim_method": "jacobi", "iterative": False,
        "fmus": [{"id": name, "name": name, "path": path} for name, path in files.items()],
        "connections": [{"source": place(a, x), "target": place(b, y)} for a, x, b, y in wires],
    }, file)
    file.flush()
    coordinator = Coordinator()
    coordinator.start(file.name)
for _ in range(steps):
    coordinator.do_step(step)
end = [float(coordinator.get_variable(("plant", f"{name}_encoder"))[0]) for name in ("theta", "delta")]
"""

PATHSIM = """
from pathsim import Connection, Simulation
from pathsim_fmi import CoSimulationFMU
units = {name: CoSimulationFMU(path, instance_name=name, dt=step) for name, path in files.items()}
connections = [Connection(units[a][x], units[b][y]) for a, x, b, y in wires]
Simulation(list(units.values()), connections, dt=step, log=False).run((steps - 1) * step)  # it steps at both ends
end = [float(x) for x in units["plant"].outputs.to_array()]
"""

TOOLBOX = """
import subprocess
for path in files.values():
    subprocess.run([sys.executable, "-m", "fmu_manipulation_toolbox", "-input", path, "-check"], check=True)
end = None
"""

OMSIMULATOR = """
from OMSimulator import SSP, CRef
model = SSP(ssp)
instance = model.instantiate()
instance.setStopTime(steps * step)
instance.initialize()
instance.simulate()
end = [instance.getValue(CRef("default", "plant", f"{name}_encoder")) for name in ("theta", "delta")]
instance.terminate()
"""


@dataclass(frozen=True)
class ForeignTool:
    """What to install, what to run there, and in which order it couples the units."""

    packages: tuple[str, ...]
    script: str
    order: Order = "parallel"
    real_only: bool = False


TOOLS = {
    "FMPy simulate_ssp": ForeignTool(("fmpy",), FMPY),
    "libcosimpy": ForeignTool(("libcosimpy",), LIBCOSIM),
    "ecospy": ForeignTool(("ecospy", "tbb"), ECOS),
    "sofirpy": ForeignTool(("sofirpy",), SOFIRPY),
    "cofmupy": ForeignTool(("cofmupy",), COFMUPY, real_only=True),
    "pathsim-fmi": ForeignTool(("pathsim-fmi",), PATHSIM, "controller-first", real_only=True),
    "fmu-manipulation-toolbox -check": ForeignTool(("fmu-manipulation-toolbox",), TOOLBOX),
    "OMSimulator": ForeignTool(("OMSimulator",), OMSIMULATOR),
}


def main() -> int:
    """Run every tool; return 1 where one that was installed failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--environments", type=Path, help="folder that keeps the environments; none: a temporary one")
    parser.add_argument("--only", nargs="+", choices=TOOLS, default=list(TOOLS), metavar="NAME")
    arguments = parser.parse_args()
    failed = 0
    with tempfile.TemporaryDirectory() as temporary:
        changes = {"plant": {"delta_0": 0.1}}
        pairs = {False: Path(temporary, "all"), True: Path(temporary, "real")}
        for real_only, folder in pairs.items():
            export_units(default_design(), output=folder, changes=changes, outputs=REAL_ONLY if real_only else None)
        for name in arguments.only:
            tool = TOOLS[name]
            home = (arguments.environments or Path(temporary, "environments")) / tool.packages[0]
            python, reason = installed(home, tool.packages)
            if reason:
                print(f"{name}: skipped, {reason}", flush=True)
                continue
            found, said = ran(python, tool, pairs[tool.real_only])
            failed += not said.endswith("ran")
            print(f"{name}: {said}{distance(found, tool.order, pairs[False])}", flush=True)
    return int(failed > 0)


def installed(home: Path, packages: tuple[str, ...]) -> tuple[Path, str]:
    """Return the interpreter of an environment that has the packages, and why it has not."""
    python = home / "bin" / "python"
    if not python.is_file():
        subprocess.run([sys.executable, "-m", "venv", str(home)], check=True)
    command = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *packages]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    lines = [line for line in done.stderr.splitlines() if line.startswith("ERROR")]
    return python, "" if done.returncode == 0 else f"pip says: {(lines or ['nothing'])[-1]}"


def ran(python: Path, tool: ForeignTool, folder: Path) -> tuple[list[float] | None, str]:
    """Run the tool on the pair in `folder`; return where it ended, and a word about it."""
    program = WIRED + tool.script + "\nprint('END', json.dumps(end and [float(x) for x in end]))\n"
    command = [str(python), "-c", program, str(folder), repr(STEP), str(STEPS)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=600)
    ends = [line for line in done.stdout.splitlines() if line.startswith("END ")]
    if done.returncode != 0 or not ends:
        return None, f"FAILED, {(done.stderr or done.stdout).strip().splitlines()[-1]}"
    return json.loads(ends[-1][4:]), "ran"


def distance(found: list[float] | None, order: Order, folder: Path) -> str:
    """Tell how far from this project's master a tool ended; masters differ in what the first step's inputs are."""
    if found is None:
        return ""
    components = (
        Component("controller", folder / "IhcController.fmu"),
        Component("plant", folder / "QubeServo2.fmu"),
    )
    system = SystemStructure(components, WIRES["encoders"])
    result = simulate(system, STEP, STEPS * STEP, order, record=ENDS)
    difference = max(abs(a - float(result[name][-1])) for a, name in zip(found, ENDS, strict=True))
    return f", {difference:.3g} rad from this project's master ({order})"


if __name__ == "__main__":
    sys.exit(main())
