"""The command `tune`."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from filing.ownership import check_replaceable

from ..errors import UserError
from .display import console, escaped, print_front, print_tuning, remove_earlier, resumable, say_notes, staged_progress
from .options import (
    SCENARIO_HELP,
    ClusterOption,
    FmusOption,
    SetOption,
    WorkersOption,
    assignments,
    loaded_design,
    workers_at,
)

if TYPE_CHECKING:
    from ..scenario import Scenario
    from ..studies.engine import Workers
    from ..studies.journal import Journal
    from ..studies.pareto_front import Search
    from ..studies.tunables import Tunable, TunedController
    from ..studies.tuning import Grid, TuningProblem


def tune(
    scenario: Annotated[str, typer.Argument(help=SCENARIO_HELP)],
    measure: Annotated[
        str | None,
        typer.Option(
            help="Metric to make small; of the pendulum integral_q2, steady_rms, settling_time, energy or "
            "voltage_variation; none: the integral of the squared error."
        ),
    ] = None,
    most_chattering: Annotated[
        float | None, typer.Option(help="Largest variation of the controls, relative to the LC's; none: no limit.")
    ] = None,
    a_min: Annotated[str | None, typer.Option(help="Values of a_min, separated by commas; none: 1 to 0.1.")] = None,
    b_max: Annotated[str | None, typer.Option(help="Values of b_max; none: 1, 1.25, 1.6, 2.")] = None,
    u_max: Annotated[
        str | None, typer.Option(help="Scales of the pendulum's P, |k x| on the unit ball [V]; none: 1.5, 3, 10.")
    ] = None,
    mu: Annotated[str | None, typer.Option(help="Values of the pendulum's mu; none: 0.5, 1.")] = None,
    draws: Annotated[
        int, typer.Option(min=1, help="Encoder offsets and noise, the same for each point; best a power of two.")
    ] = 16,
    pareto: Annotated[
        str | None,
        typer.Option(
            metavar="NAME,NAME,...",
            help="Look for the front of these objectives instead, the first above all: roles (settling, integral, rms, "
            "energy, variation) or names of metrics.",
        ),
    ] = None,
    over: Annotated[
        list[str] | None,
        typer.Option(
            metavar="controller.NAME=LOW..HIGH",
            help="What is varied for the front, may be repeated; none: a_min, b_max, the scale of P (u_max), of the "
            "pendulum mu and the noises of its Kalman filter.",
        ),
    ] = None,
    gain: Annotated[bool, typer.Option("--gain", help="Vary the entries of K for the front too.")] = False,
    linear: Annotated[
        bool,
        typer.Option(
            "--linear", help="Also look for what the LC itself can have, K and filter as free; drawn and judged beside."
        ),
    ] = False,
    limit: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=FACTOR",
            help="Largest value of an objective for the chosen point, relative to the LC's, e.g. `energy=1`; may be "
            "repeated; none: 1 for every objective but the first, or with --goal no limit.",
        ),
    ] = None,
    goal: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=FACTOR",
            help="Value to reach of an objective, relative to the LC's, e.g. `settling=0.2`; may be repeated: the search "
            "goes on towards all at once, and the chosen point is the nearest to them within the limits.",
        ),
    ] = None,
    case: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME:ENTRY=VALUE",
            help="Also run each point with this entry changed, e.g. `pushed:disturbance.gain=200`, and keep the plant "
            "there; `rms@pushed` is an objective of it; may be repeated, with one name for several entries.",
        ),
    ] = None,
    hold: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ENTRY=VALUE",
            help="From there each point must come to rest in every draw, e.g. `plant.delta_0=0.6`; may be repeated.",
        ),
    ] = None,
    reference: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ENTRY=VALUE or SCENARIO",
            help="What the LC of the comparison has otherwise, e.g. `controller.velocity_source=filter`, or all that the "
            "controller of another scenario has, e.g. `tilt`; may be repeated.",
        ),
    ] = None,
    population: Annotated[int | None, typer.Option(help="Points of a generation; none: 32.")] = None,
    generations: Annotated[int | None, typer.Option(help="Generations of the search; none: 20.")] = None,
    held_out: Annotated[
        int | None, typer.Option(help="Draws that judge the front, none of the search's; none: 64.")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Of the search; the same finds the same front; none: 1.")] = None,
    design: Annotated[
        Path | None,
        typer.Option(
            help="The pendulum's design file with your A, b, k_lin and alpha; none: that of the controller FMU. Another "
            "controller keeps the design that it was exported with."
        ),
    ] = None,
    workers: WorkersOption = None,
    cluster: ClusterOption = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder to write to; none: `results/tune_NAME`.")
    ] = None,
    fmus: FmusOption = Path("fmus"),
    change: SetOption = None,
) -> None:
    """Tune a_min and b_max, of the pendulum the scale of P and mu too: from the LC on, as long as the measure improves.

    Writes all points as a table and a picture, and the best as a scenario and a design. With --pareto it looks for the
    front of several objectives. Finished runs are kept: the same command, or one with more values, goes on from there.
    """
    from ..pendulum import is_controller
    from ..remarks import remarks_before
    from ..scenario import load_located
    from ..scenario_run import with_tolerances
    from ..scenario_system import build_system, controller_design, controller_values
    from ..studies.cases import cases_of
    from ..studies.journal import Journal
    from ..studies.numbers import PURPOSE
    from ..studies.pareto_front import Search, factors_of, objectives_of
    from ..studies.tunables import TunedController
    from ..studies.tuning import Grid, TuningProblem

    sizes = {"population": population, "generations": generations, "held_out": held_out, "seed": seed}
    sizes = {name: value for name, value in sizes.items() if value is not None}
    if pareto is None and (over or gain or linear or limit or goal or case or hold or reference or sizes):
        raise UserError(
            "--over, --gain, --linear, --limit, --goal, --case, --hold, --reference, --population, --generations, "
            "--held-out and --seed are for a front; --pareto names its objectives"
        )
    if pareto is not None and (measure is not None or most_chattering is not None):
        raise UserError(
            "--measure and --most-chattering are for the rule; a front has --pareto and --limit in their place"
        )
    loaded_scenario, folder, fmus = load_located(scenario, fmus)
    loaded_scenario = loaded_scenario.changed(dict(assignments(change)))
    given = {"a_min": a_min, "b_max": b_max, "u_max": u_max, "mu": mu}
    grid = Grid(
        **{name: _numbers(f"--{name.replace('_', '-')}", text) for name, text in given.items() if text is not None}
    )
    own_design = None if design is None else loaded_design(design)
    pendulum = is_controller(controller_values(loaded_scenario, fmus, folder))
    if not pendulum and (u_max is not None or mu is not None):
        raise UserError("--u-max and --mu are for the pendulum's controller; another keeps those of its design")
    system = build_system(loaded_scenario, fmus, folder)
    known = own_design or controller_design(system, loaded_scenario, folder)[0]
    limit_of_chattering = math.inf if most_chattering is None else most_chattering
    problem = TuningProblem(
        loaded_scenario, folder, fmus, known if pendulum else own_design, measure, limit_of_chattering, draws
    )
    problem.check_tunable()
    target = _target(output, scenario, loaded_scenario.name)
    controller = TunedController(loaded_scenario, fmus, folder, known)
    search = None
    if pareto is not None:
        place = loaded_scenario, fmus, folder
        cases = cases_of(_entries("--case", case, *place), _entries("--hold", hold, *place))
        found = objectives_of(pareto.split(","), problem.quantities, cases)
        factors = factors_of("--limit", limit or [], found), factors_of("--goal", goal or [], found)
        other = _reference(reference or [], *place)
        search = Search(found, tuple(_varied(controller, over, gain)), *factors, cases, other, linear=linear, **sizes)
        problem = replace(problem, measure=search.objectives[0].quantity.name)
    check_replaceable(*(target / name for name in _files(search)))
    say_notes(remarks_before(system, loaded_scenario))
    problem = replace(problem, scenario=with_tolerances(loaded_scenario, fmus, folder))
    with (
        resumable(target / "runs.sqlite") as finished,
        workers_at(workers, cluster) as where,
        Journal(finished, PURPOSE) as journal,
    ):
        if search is None:
            _follow_the_rule(problem, grid, target, journal, where)
        else:
            _look_for_the_front(problem, search, controller, grid, target, journal, where)


def _varied(controller: TunedController, over: list[str] | None, gain: bool) -> list[Tunable]:
    from ..studies.tunables import ranges_over

    numbers = controller.tunables(ranges_over(over or []), gain)
    if controller.filtered and controller.noises is None and not over:
        say_notes(["the Kalman filter's gain belongs to no noises, so that these are not varied"])
    return numbers


def _target(output: Path | None, scenario: str, name: str) -> Path:
    """Return the folder to write to; raise UserError where the scenario lies there that the search would replace."""
    target, path = output or Path("results") / f"tune_{name}", Path(scenario)
    if path.suffix == ".toml" and path.resolve() == (target / "best.toml").resolve():
        raise UserError(f"the search of {scenario} would replace it by its result; --output names another folder")
    return target


def _files(search: Search | None) -> tuple[str, ...]:
    from ..studies import pareto_files, tuning_files

    return (tuning_files if search is None else pareto_files).WRITTEN_FILES


def _follow_the_rule(problem: TuningProblem, grid: Grid, target: Path, journal: Journal, workers: Workers) -> None:
    from ..studies.tuning import tune as run_tuning
    from ..studies.tuning_files import save

    with staged_progress() as report:
        tuning = run_tuning(problem, grid, journal, workers, report)
    paths = save(tuning, problem, target)
    print_tuning(tuning)
    _say_written(paths)


def _look_for_the_front(
    problem: TuningProblem,
    search: Search,
    controller: TunedController,
    grid: Grid,
    target: Path,
    journal: Journal,
    workers: Workers,
) -> None:
    from ..studies.pareto import pareto
    from ..studies.pareto_files import WRITTEN_FILES, save

    with staged_progress() as report:
        front = pareto(problem, search, controller, grid, journal, workers, report, console.print)
    paths = save(front, problem, target)
    print_front(front)
    _say_written(paths)
    for name in WRITTEN_FILES:
        if target / name not in paths:
            remove_earlier(target / name, "chosen point")


def _say_written(paths: list[Path]) -> None:
    for path in paths:
        console.print(f"wrote {escaped(path)}")


def _entries(
    option: str, items: list[str] | None, scenario: Scenario, fmus: Path, folder: Path | None
) -> list[tuple[str, Any]]:
    """Return entries as the scenario has them, a case's name before them where there is one, and their values."""
    from ..studies.entries import entry_of

    pairs = []
    for text, value in assignments(items, option):
        name, colon, entry = text.rpartition(":")
        pairs.append((f"{name}{colon}{entry_of(entry, scenario, fmus, folder)}", value))
    return pairs


def _reference(items: list[str], scenario: Scenario, fmus: Path, folder: Path | None) -> dict[str, Any]:
    """Return what the LC of the comparison has otherwise: entries, and the controllers of scenarios, in their order."""
    from ..scenario import load_located
    from ..studies.tunables import controller_over

    found: dict[str, Any] = {}
    for item in items:
        if "=" in item:
            found |= _entries("--reference", [item], scenario, fmus, folder)
            continue
        other, beside, others = load_located(item, fmus)
        found |= controller_over((other, others, beside), (scenario, fmus, folder))
    return found


def _numbers(option: str, text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise UserError(f"{option} takes numbers separated by commas, found {text!r}") from None
