"""Run everything, judge it, and write tables, figures and one self-contained HTML page."""

from __future__ import annotations

import base64
import json
import os
import shlex
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from filing.files import staging, write_file
from ihc_fmu.largest_rate import largest_alpha
from ihc_fmu.pendulum.paper_system import paper_system
from plant_fmu.linearization import linearize
from plant_fmu.parameters import parameter_set

from ..errors import UserError
from ..fmu_files import describe
from ..report.motion import pendulum_in_motion
from ..report.page import ANIMATION, data, render
from ..results import Result, versions
from ..scenario import BUILT_IN, load_scenario
from ..studies.engine import Job, run_all
from ..studies.journal import Journal
from . import figures, printed, tables
from .claims import Judge, Theory
from .gains import K_LIN, A, B, gain_readings, norm_readings
from .readings import readings
from .study import COMPARED, GAINS, PURPOSE, REFERENCE, Key, Study, numbers, scenario_name
from .verdicts import Claim

HERE = Path(__file__).parent

Progress = Callable[[str, int, int], None]
"""Called with what is being done, how much is done, and how much there is."""

EXPERIMENT_NAMES = {
    "reference": "figures and tables",
    "swing-up": "draws from hanging down",
    "shipped": "draws, shipped swing-up, all sets",
    "tilt": "draws from a tilt, all sets",
    "onset": "disturbance from the first moment",
    "chattering": "a_min and chattering",
    "swing-ups": "random swing-ups",
}


WINDOW = "beside it the same from 5 to 7 s"
FIGURES = {
    "figure_3.png": f"The angles θ and δ over 10 s with LC, IHC and two sliding mode controllers, {WINDOW}",
    "figure_4.png": f"The size of the angles, |q|, over 10 s with the four controllers, {WINDOW}",
    "figure_5.png": f"The voltage over 10 s, above with the LC, below with the IHC, {WINDOW}",
    "figure_6.png": "The size of the angles, |q|, with the four controllers under the disturbance, a row for each gain G",
    "shares.png": "For each ranking and condition the share of draws with its confidence interval, and the line at 50 %",
    "swing_ups.png": "For each random swing-up by how much the LMSE of the IHC differs, over the largest angle of the arm",
    "chattering.png": "The integral of |q|² and the variation of the voltage over a_min, for each estimator and step",
}
"""What the figures show, in words."""


@dataclass(frozen=True)
class Section:
    """A part of the page: title, text, figures by file name, tables, and the names of those that begin folded."""

    title: str
    text: str
    figures: Sequence[str] = ()
    tables: Sequence[tables.Table] = ()
    folded: Sequence[str] = ()


def make(study: Study, progress: Progress | None = None) -> list[Claim]:
    """Run all experiments of `study` that its journal does not hold, write its folder, return the verdicts.

    The journal `runs.sqlite` grows with each finished run, so that a repetition continues where this one was stopped. What
    is made of the runs reaches the folder together, the report last.
    """
    say = progress or (lambda _what, _done, _total: None)
    for fmu in (study.base.plant.fmu, study.base.controller.fmu):
        describe(study.fmus / fmu)  # says what is missing before anything is written
    study.prepare()
    found: dict[Key, dict[str, float]] = {}
    with Journal(study.folder / "runs.sqlite", PURPOSE) as journal:
        for experiment, keys in study.keys().items():
            name = EXPERIMENT_NAMES[experiment]
            found |= study.run(keys, journal, lambda done, total, name=name: say(name, done, total))
            _check(found)
    say("tables, figures, report", 0, 4)
    references = study.keys()["reference"]
    drawn = [key for key in references if key.variant in COMPARED]
    pictures = {(key.gain, key.variant): result for key, result in study.pictures(drawn).items()}
    theory, runs = _theory(study)
    judge = Judge(found)
    claims = [*judge.claims(), *theory.claims()]
    say("tables, figures, report", 1, 4)
    sections = _sections(study, found, judge, claims, theory, runs, pictures)
    with staging(study.folder, last="report.html") as place:
        for section in sections:
            for table in section.tables:
                table.save(place)
        tables.draws_table(found).save_csv(place)
        for key in references:
            study.save_scenario(key, place)
        say("tables, figures, report", 2, 4)
        figures.save_all(place, pictures, found, study, tables.ranking_names(found))
        say("tables, figures, report", 3, 4)
        images = {
            name: base64.b64encode((place / name).read_bytes()).decode("ascii")
            for section in sections
            for name in section.figures
        }
        write_file(place / "report.html", _page(study, sections, claims, pictures, images, len(found)))
    say("tables, figures, report", 4, 4)
    return claims


def _check(found: Mapping[Key, Mapping[str, float]]) -> None:
    """Raise UserError where a reference run failed: without it there is nothing to compare."""
    for key, numbers_of in found.items():
        if key.experiment == "reference" and not numbers_of:
            raise UserError(f"the reference run {scenario_name(key)} failed in an FMU; `qube-ihc run paper` says why")


def _theory(study: Study) -> tuple[Theory, dict[str, dict[str, float]]]:
    """Return what needs no draws: readings of k and P with a run of each, and the claims about model and design."""
    gains = gain_readings()
    norms = norm_readings(study.designs["paper.json"].P)
    tilt = load_scenario(str(BUILT_IN / "tilt.toml"))[0].changed(
        {
            "run.duration": 10.0,
            "plant.parameters": REFERENCE[0],
            "controller.design": "paper.json",
            "controller.start.swing_up_enabled": False,
        }
    )
    jobs: list[Job[str]] = []
    for reading in (*gains, *norms):
        changes = {f"controller.start.{name}": value for name, value in reading.start.items()}
        jobs.append(Job(reading.name, tilt.changed(changes), study.scenarios))
    runs = run_all(jobs, study.fmus, numbers, study.workers)
    linear = study.job(Key("reference", *REFERENCE, 0, "LC", 0))
    ihc = study.job(Key("reference", *REFERENCE, 0, "IHC", 0), **{"controller.start.a_min": 1.0})
    voltages = run_all(
        [Job("LC", linear.scenario, linear.folder), Job("IHC", ihc.scenario, ihc.folder)],
        study.fmus,
        lambda result: result["controller.voltage"],
        study.workers,
    )
    listed_A, listed_b = linearize(parameter_set("listed").parameters, back_emf=False)
    printed_all, listed_all = np.append(A[2:, 1:], B[2:]), np.append(listed_A[2:, 1:], listed_b[2:])
    turning_A, turning_b = linearize(parameter_set("listed").parameters)
    poles = np.linalg.eigvals(turning_A + np.outer(turning_b, K_LIN))
    theory = Theory(
        gains=gains,
        norms=norms,
        largest_alpha=largest_alpha(paper_system(), printed.MU),
        same_as_linear=float(np.max(np.abs(voltages["LC"] - voltages["IHC"]))),
        listed_off=float(np.max(np.abs(listed_all - printed_all)) / np.max(np.abs(printed_all))),
        listed_pole=float(poles.real.max()),
    )
    return theory, runs


def _sections(
    study: Study,
    found: Mapping[Key, Mapping[str, float]],
    judge: Judge,
    claims: Sequence[Claim],
    theory: Theory,
    runs: Mapping[str, Mapping[str, float]],
    pictures: Mapping[tuple[float, str], Result],
) -> list[Section]:
    plain = {variant: pictures[0, variant] for variant in COMPARED}
    k_table, p_table = tables.gains_tables(theory, runs)
    paper_scale = study.designs["paper.json"].extent
    return [
        Section(
            "Verdicts",
            "The paper's main statements; all others are below.",
            tables=[
                tables.claims_table([c for c in claims if c.main], "main_claims", "The main claims"),
                tables.claims_table(claims),
            ],
            folded=("claims",),
        ),
        Section(
            "Figure 3",
            "From hanging down; beside it the window of the paper's insets, 5 to 7 s. The two sliding mode controllers "
            "stand for the paper's one, whose gains it does not print.",
            ["figure_3.png"],
        ),
        Section("Figure 4", "The dotted line is at the 4 s of the paper's text.", ["figure_4.png"]),
        Section(
            "Figure 5",
            "The voltage of LC and IHC; the swing-up is the same.",
            ["figure_5.png"],
        ),
        Section(
            "Table I",
            "",
            tables=[tables.lmse_table(judge, GAINS[:1], "table_1", "Without artificial perturbation")],
        ),
        Section("Control energy", "", tables=[tables.energy_table(judge)]),
        Section(
            "Figure 6",
            "G (0.02 sin 10t + 0.01 sin 3t) V is added to the control from 1.5 s on.",
            ["figure_6.png"],
        ),
        Section(
            "Table II",
            "",
            tables=[tables.lmse_table(judge, GAINS[1:], "table_2", "With artificial perturbation")],
        ),
        Section(
            "In how many draws",
            "“swing-up” are the conditions of the tables, “shipped” the controller's own, faster swing-up, “tilt” the "
            "balance alone from 0.1 rad, “onset” the disturbance from the first moment. The printed damping of the set "
            "“listed” makes the LC unstable, and with it and “swapped” 10 V do not swing the pendulum up: the picture has "
            "no line for them.",
            ["shares.png"],
            [tables.shares_table(found)],
            ["shares"],
        ),
        Section("What LMSE may mean", "", tables=[tables.readings_table(readings(plain))]),
        Section("When the disturbance begins", "", tables=[tables.onset_table(found, judge)]),
        Section(
            "The swing-up decides the margin",
            "",
            ["swing_ups.png"],
            [tables.swing_ups_table(found)],
        ),
        Section(
            "The printed k and P",
            f"The scale of P is open too. At |kx| ≤ 10 V the unit ball reaches |δ| ≤ {paper_scale[1]:.3g} rad, so that the "
            "norm stays below a_min = 0.88 almost always: the paper's IHC is then a linear controller with the gains of "
            "r = 0.88.",
            tables=[k_table, p_table],
        ),
        Section(
            "Chattering",
            "The paper lowers a_min while that improves the control. With the velocity filter the voltage soon chatters; a "
            "better estimator moves that limit.",
            ["chattering.png"],
            [tables.chattering_table(found, study)],
            ["chattering"],
        ),
        Section("Beyond the paper", "", tables=[tables.beyond_table(judge)]),
    ]


def _page(
    study: Study,
    sections: Sequence[Section],
    claims: Sequence[Claim],
    pictures: Mapping[tuple[float, str], Result],
    images: Mapping[str, str],
    runs: int,
) -> str:
    sources = dict.fromkeys(key for claim in claims for key in claim.runs)
    scenarios = {scenario_name(key): study.scenario(key).to_toml() for key in sources}
    about = study.designs["paper.json"]
    return render(
        "report.html.j2",
        ANIMATION,
        ("animation.css",),
        HERE,
        sections=sections,
        images=images,
        shown=FIGURES,
        claims=claims,
        counts=Counter(claim.verdict for claim in claims),
        independent=Counter(claim.verdict for claim in claims if claim.basis == "independent"),
        **{basis: sum(claim.basis == basis for claim in claims) for basis in ("fitted", "repeats")},
        runs_of={(claim.section, claim.text): [scenario_name(key) for key in claim.runs] for claim in claims},
        scenarios=scenarios,
        variants=study.variants.values(),
        size=study.size,
        steps=[f"{step * 1e3:g}" for step in study.size.sample_times],
        runs=runs,
        versions=versions(),
        design=json.dumps({"P": np.round(about.P, 6).tolist(), "k": np.round(about.K_h[0], 6).tolist()}),
        fmus=shlex.quote(os.path.relpath(study.fmus, study.folder)),
        animation=data(pendulum_in_motion({law: pictures[0, law] for law in ("LC", "IHC")}, figures.PALETTE)),
    )
