"""From Python what the command line does: export a design's FMUs, run a scenario, compare the laws in it."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fmu_export.files import FilePath
from ihc_fmu.arguments import as_names, check_kind, check_whole

from .remarks import remarks_after, remarks_before, rest_remarks
from .scenario import Scenario, load_located
from .scenario_run import run_scenario
from .scenario_system import build_system

if TYPE_CHECKING:
    from ihc_fmu.design import Design

    from .results import Result
    from .studies.comparison import Comparison


def export(
    design: Design, folder: FilePath = "fmus", changes: Mapping[str, Mapping[str, Any]] | None = None
) -> list[Path]:
    """Write the FMUs of a design, its controller and a plant, and both with their wires as an SSP file.

    A design of the system `rotary_pendulum` gives the QUBE-Servo 2 and its controller with swing-up; any other gives
    NAME_linear_plant.fmu, NAME_controller.fmu and NAME.ssp. Native FMUs, for which nothing is compiled.

    Parameters
    ----------
    design
        The certified design.
    folder
        Where the files are written to; other files there stay.
    changes
        Start values that differ, by unit ("plant", "controller") and name.

    Returns
    -------
    list[Path]
        The files: plant, controller, SSP.

    Raises
    ------
    UserError
        For what cannot be exported, such as a state that no measurement tells, or a start value outside its rule.

    See Also
    --------
    cosim.design_export.export_design : with platforms, Python FMUs, and the pendulum's parameter sets.

    Examples
    --------
    >>> import cosim, ihc_fmu
    >>> arm = ihc_fmu.System(A=[[0, 1], [4, 0]], B=[[0], [1]], K=[[-8, -4]], name="arm")
    >>> [path.name for path in cosim.export(ihc_fmu.synthesize(arm), "exported")]
    ['arm_linear_plant.fmu', 'arm_controller.fmu', 'arm.ssp']
    """
    from ihc_fmu.design import Design  # noqa: PLC0415 - heavy

    from .design_export import export_design  # noqa: PLC0415

    check_kind("design", design, Design, "a Design")
    return export_design(design, folder, changes)


def run(scenario: FilePath | Scenario, changes: Mapping[str, Any] | None = None, fmus: FilePath = "fmus") -> Result:
    """Run a scenario.

    Parameters
    ----------
    scenario
        A scenario's file (`*.toml`), an SSP file (`*.ssp`), the name of a built-in scenario, or a `Scenario`.
    changes
        Entries that differ, by the names of the reference, as `{"run.duration": 20.0, "plant.start.angle_0": 0.1}`.
    fmus
        Folder of the FMUs, where they are not beside the scenario; an SSP file brings its own.

    Returns
    -------
    Result
        Signals at the communication points, with units and metadata.

    Raises
    ------
    UserError
        For a scenario that cannot be run; nothing was run then.
    SimulationError
        Where an FMU fails; its `result` holds what was recorded until then.
    Interrupted
        On Ctrl-C; its `result` holds what was recorded until then.

    Warns
    -----
    UserWarning
        For what is to be known of the run: start values that no certificate covers, a plant at rest, numbers that
        overflow, and the like.

    Examples
    --------
    >>> import cosim
    >>> result = cosim.run("fmus/arm.ssp", {"plant.start.angle_0": 0.1, "run.duration": 3.0})
    >>> bool(abs(result["plant.angle"][-1]) < 1e-4)
    True
    """
    located, folder, place = _located(scenario, changes, fmus)
    system = build_system(located, place, folder)
    _warn(remarks_before(system, located))
    result = run_scenario(located, place, folder)
    _warn(remarks_after(result, system))
    return result


def compare(
    scenario: FilePath | Scenario,
    laws: Sequence[str] | None = None,
    changes: Mapping[str, Any] | None = None,
    fmus: FilePath = "fmus",
    draws: int = 128,
    workers: int | None = None,
) -> Comparison:
    """Run a scenario with each law, all on the same draws of sensor offsets and noise.

    Parameters
    ----------
    scenario, changes, fmus
        As in `run`.
    laws
        Values of the controller's `law`; None: those of LC, SMC and IHC that it has.
    draws
        Draws of the plant's offsets and noise, best a power of two; 0: the scenario as it stands, once. A plant that has
        neither is run once.
    workers
        Threads; None: one per core.

    Returns
    -------
    Comparison
        Metrics of all draws, and the whole result of a typical one for each law.

    Raises
    ------
    UserError
        For a scenario that cannot be run or judged, or a law that its controller does not have.
    SimulationError
        Where an FMU fails.
    KeyboardInterrupt
        On Ctrl-C, as `Interrupted` where a single run is on; nothing is kept.

    Warns
    -----
    UserWarning
        As `run`.

    Examples
    --------
    >>> import cosim
    >>> comparison = cosim.compare("fmus/arm.ssp", ["LC", "IHC"], {"plant.start.angle_0": 0.1, "run.duration": 3.0})
    >>> [f"{comparison.value(law, 'peak').value:.2f}" for law in ("LC", "IHC")]
    ['0.80', '1.37']
    """
    from .studies.experiments import LAWS, Experiment, laws_of, run_experiments  # noqa: PLC0415 - heavy

    check_whole("draws", draws, 0)
    if workers is not None:
        check_whole("workers", workers, 1)
    if laws is not None:
        laws = as_names("laws", laws)
    located, folder, place = _located(scenario, changes, fmus)
    if laws is None:
        laws = [law for law in laws_of(located, place, folder) if law in LAWS]
    system = build_system(located, place, folder)
    _warn(remarks_before(system, located))
    (comparison,) = run_experiments([Experiment(located, folder, draws)], place, laws, workers)
    _warn([*comparison.overflows(), *rest_remarks(next(iter(comparison.results.values())), system)])
    return comparison


def _located(
    scenario: FilePath | Scenario, changes: Mapping[str, Any] | None, fmus: FilePath
) -> tuple[Scenario, Path, Path]:
    """Return the scenario with its changes, its folder and the folder of its FMUs."""
    if isinstance(scenario, Scenario):
        return scenario.changed(changes or {}), Path(), Path(fmus)
    loaded, folder, place = load_located(os.fspath(scenario), Path(fmus))
    return loaded.changed(changes or {}), folder, place


def _warn(sentences: Sequence[str]) -> None:
    for sentence in sentences:
        warnings.warn(sentence, UserWarning, stacklevel=3)
