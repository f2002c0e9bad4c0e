"""What a sweep runs: a scenario, what is varied in it, the laws, and all that was drawn."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from fmu_export.errors import UserError
from fmu_export.files import FilePath
from ihc_fmu.arguments import check_whole

from ..metric_meanings import QUANTITIES, MetricMeaning, quantities_of
from ..metrics import LEAST
from ..room import check_memory
from ..scenario import Scenario
from ..scenario_run import with_tolerances
from ..scenario_system import evaluation, plant_values
from .draws import Chance, chance_of
from .experiments import LAW, LAWS, check_names, check_outputs, laws_of
from .sampling import Sampling, grid, points
from .variation import Entries, Variation, variation_of

Array = np.ndarray

OWN = "own"
"""What the one law of a controller is called that has no choice of laws."""
DRAWS = 256
"""Draws where nothing is said."""
NUMBER_BYTES = 100
"""Of a draw and law in memory and in the tables that are written, for each column about."""


@dataclass(frozen=True, eq=False)
class SweepPlan:
    """What is run: the scenario as all runs have it, what is varied, the laws, and what was drawn.

    `drawn`: an array for each variation and each encoder offset by its path; of a list, the numbers of its values.
    `seeded`: the noise has the draw's number as its seed. `units`: of all that is drawn, by its path.
    """

    scenario: Scenario
    fmus: Path
    folder: Path | None
    variations: tuple[Variation, ...]
    laws: tuple[str, ...]
    sampling: Sampling
    seed: int
    drawn: Mapping[str, Array]
    seeded: bool
    quantities: Mapping[str, MetricMeaning]
    units: Mapping[str, str]

    @property
    def count(self) -> int:
        """The number of draws."""
        return len(next(iter(self.drawn.values())))

    @cached_property
    def names(self) -> dict[str, str]:
        """What is drawn, as it is called in tables, by its path; offsets by the names of the plant's variables."""
        given = {variation.path: variation.name for variation in self.variations}
        return {path: given.get(path, f"plant.{path.rpartition('.')[2]}") for path in self.drawn}

    @cached_property
    def _of_path(self) -> dict[str, Variation]:
        return {variation.path: variation for variation in self.variations}

    def listed(self, path: str) -> tuple[Any, ...]:
        """Return the values of the list that an entry is taken from; none where it is drawn from a distribution."""
        variation = self._of_path.get(path)
        return () if variation is None else variation.values

    def logarithmic(self, path: str) -> bool:
        """Return whether an entry is drawn evenly in its logarithm, about."""
        return path in self._of_path and self._of_path[path].logarithmic

    def values(self, path: str) -> Array:
        """Return what the scenario takes of an entry in each draw: numbers, or texts where a list has other values."""
        listed = self.listed(path)
        if not listed:
            return self.drawn[path]
        kinds = {type(value) for value in listed}
        same = len(kinds) == 1 or kinds == {int, float}
        return np.array(listed if same else [str(value) for value in listed])[self.drawn[path]]

    def changes(self, draw: int, law: str) -> dict[str, Any]:
        """Return what is changed in the scenario for a draw, counted from 1, and a law."""
        changes: dict[str, Any] = {}
        for path, column in self.drawn.items():
            variation = self._of_path.get(path)
            changes[path] = float(column[draw - 1]) if variation is None else variation.value(column[draw - 1])
        if self.seeded:
            changes["plant.start.noise_seed"] = draw
        if law != OWN:
            changes[LAW] = law
        return changes


def plan_sweep(
    scenario: Scenario,
    vary: Mapping[str, str | Sequence[Any]],
    fmus: FilePath,
    folder: FilePath | None = None,
    laws: Sequence[str] | None = None,
    draws: int | None = None,
    sampling: Sampling | None = None,
    seed: int = 1,
) -> SweepPlan:
    """Return what a sweep runs; nothing of it has run but the scenario as it stands, where its tolerances need that.

    `vary`: specifications by names of entries, see `variation`. `draws` None: DRAWS, of a grid 1 for each combination.
    `sampling` None: a grid where only lists are varied, otherwise a Sobol set. Raises UserError for what cannot be.
    """
    if not vary:
        raise UserError("a sweep needs something to vary, such as --vary plant.m_p=±10%")
    entries = Entries(scenario, fmus, folder)
    variations = tuple(variation_of(name, spec, entries) for name, spec in vary.items())
    paths = [variation.path for variation in variations]
    twice = next((path for path in paths if paths.count(path) > 1), None)
    if twice is not None:
        raise UserError(f"--vary names {twice} twice")
    listed = all(variation.quantile is None for variation in variations)
    sampling = sampling or ("grid" if listed else "sobol")
    if sampling == "grid" and not listed:
        first = next(v for v in variations if v.quantile is not None)
        raise UserError(
            f"a grid takes lists of values only, and {first.name} is drawn; --sampling sobol or latin draws"
        )
    count = (1 if sampling == "grid" else DRAWS) if draws is None else draws
    check_whole("--draws", count, 1)
    check_whole("--seed", seed, 0)
    chosen = _laws(scenario, fmus, folder, laws)
    chance = _chance(scenario, fmus, folder, paths)
    offsets = [f"plant.start.{name}" for name in chance.offsets]
    total = count * (math.prod(len(v.values) for v in variations) if sampling == "grid" else 1)
    columns = len(paths) + len(offsets) + len(QUANTITIES)
    check_memory(
        f"a sweep of {total} draws", float(total) * len(chosen) * columns * NUMBER_BYTES, "fewer --draws would do"
    )
    drawn = _drawn(variations, offsets, sampling, count, seed)
    for variation in variations:
        column = drawn[variation.path]
        entries.check(variation, variation.values or (float(column.min()), float(column.max())))
    judged = with_tolerances(scenario, fmus, folder)
    if set(judged.evaluate.tolerances or ()) == {LEAST}:
        raise UserError(
            "nothing moves in the scenario as it stands, so settling has no tolerance; --set evaluate.tolerance gives one, "
            "or start it elsewhere"
        )
    own: dict[str, Any] = {"controller.other_model": True, "record.every": 1}  # checked as the scenario stands
    if chance and "run.seed" not in paths:
        own["run.seed"] = None
    base = judged.changed(own)
    entered = [{v.path: value} for v in variations for value in v.values if ".start." not in v.path]
    for changes in [*({} if law == OWN else {LAW: law} for law in chosen), *entered]:
        check_outputs(base.changed(changes), fmus, folder)
    found = evaluation(base, fmus, folder)
    return SweepPlan(
        base,
        Path(fmus),
        None if folder is None else Path(folder),
        variations,
        chosen,
        sampling,
        seed,
        drawn,
        chance.noise,
        QUANTITIES if found is None else quantities_of(found),
        {path: entries.unit(path) for path in drawn},
    )


def _laws(scenario: Scenario, fmus: FilePath, folder: FilePath | None, laws: Sequence[str] | None) -> tuple[str, ...]:
    try:
        known = laws_of(scenario, fmus, folder)
    except UserError:
        if laws is not None:
            raise
        return (OWN,)
    names = [name for name in known if name in LAWS] if laws is None else list(laws)
    if not names or not set(names) <= set(known) or len(set(names)) < len(names):
        raise UserError(f"--laws must be different ones of {', '.join(known)}, found {', '.join(names) or 'none'}")
    check_names(names)
    return tuple(names)


def _chance(scenario: Scenario, fmus: FilePath, folder: FilePath | None, paths: Sequence[str]) -> Chance:
    """Return what of the plant is left to chance: neither fixed by the scenario nor varied."""
    if "run.seed" in paths:
        return Chance((), False)
    chance = chance_of(plant_values(scenario, fmus, folder))
    fixed = {*scenario.plant.start, *(path.removeprefix("plant.start.") for path in paths)}
    offsets = tuple(name for name in chance.offsets if name not in fixed)
    return Chance(offsets, chance.noise and "noise_seed" not in fixed)


def _drawn(
    variations: Sequence[Variation], offsets: Sequence[str], sampling: Sampling, count: int, seed: int
) -> dict[str, Array]:
    """Return an array for each variation and offset by its path."""
    paths = [variation.path for variation in variations]
    if sampling == "grid":
        combinations = grid([len(variation.values) for variation in variations], count)
        cube = points("sobol", len(offsets), count, seed)
        tiled = np.tile(cube, (len(combinations) // count, 1))
        return {**dict(zip(paths, combinations.T, strict=True)), **dict(zip(offsets, tiled.T, strict=True))}
    cube = points(sampling, len(paths) + len(offsets), count, seed)
    columns = [v.drawn(cube[:, k]) for k, v in enumerate(variations)]
    return {**dict(zip(paths, columns, strict=True)), **dict(zip(offsets, cube.T[len(paths) :], strict=True))}
