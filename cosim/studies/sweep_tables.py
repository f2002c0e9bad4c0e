"""What a sweep says, as tables of text, as sentences and as numbers for JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from ..metric_meanings import WINDOW, kept_words, lost_words
from ..tables import mark
from .described import pair
from .estimates import change_text, estimate_text
from .sensitivity import KEPT, LEAST
from .sweep import QUANTILES, Sweep

FORMAT = "qube-ihc sweep 1"

WIDE = 0.2
"""Half width of the interval of a share of the variance, from which on more draws are asked for."""
NOTHING = (
    "look at one: `qube-ihc run` runs a worst draw (worst_*.toml) alone, and says what an FMU says; is what is varied, or "
    "the scenario itself, beyond what a law can hold, or run.duration too short?"
)
"""What to look at where every draw is lost."""
FEW = 3
"""How many parameters are named that decide a metric."""

Table = tuple[str, list[str], list[list[str]]]
"""Title, headings and rows."""


def tables(sweep: Sweep, metrics: Sequence[str] | None = None) -> list[Table]:
    """Return the means, by how much and how often each law is better than the first, and what decides the metrics.

    `metrics`: those that are told of; None: all. Where no draw counts there is nothing of them to tell.
    """
    plan, names = sweep.plan, sweep.shown if metrics is None else list(metrics)
    if not sweep.counts:
        names = []
    (base, *others), count = plan.laws, plan.count
    low, high = (f"{100 * QUANTILES[k]:g}" for k in (0, -1))
    title = f"{plan.scenario.name}, {title_of(sweep)}"
    found = [
        (f"{title}: mean ± 95 % interval [{low} to {high} % of the draws]", ["", *plan.laws], _means(sweep, names))
    ]
    if others and names:
        compared = [q for q in map(sweep.quantities.__getitem__, names) if q.role != "capture"]
        rows = [[q.symbol, *(_over_first(sweep, law, q.name) for law in others)] for q in compared]
        found.append((f"over {base} on the same {count} draws: change of the mean; better in", ["", *others], rows))
    rows = [
        [_symbol(sweep, name), *(_deciding(sweep, law, name) for law in plan.laws)]
        for name in (*names, KEPT)
        if any(name in sweep.sensitivities[law] for law in plan.laws)
    ]
    if rows:
        found.append(("what decides: share of the variance over the draws", ["", *plan.laws], rows))
    return found


def title_of(sweep: Sweep) -> str:
    """Return in words what was drawn, and how often."""
    plan = sweep.plan
    how = {"sobol": "Sobol", "latin": "Latin hypercube", "grid": "grid"}[plan.sampling]
    chance = len(plan.drawn) > len(plan.variations) or plan.seeded
    what = [variation.name for variation in plan.variations] + (["offsets and noise"] if chance else [])
    return f"{plan.count} draws ({how}) of {', '.join(what)}"


def _symbol(sweep: Sweep, name: str) -> str:
    if name == KEPT:
        return kept_words(sweep.quantities)
    return sweep.quantities[name].symbol


def _means(sweep: Sweep, names: Sequence[str]) -> list[list[str]]:
    rows = []
    for q in (sweep.quantities[name] for name in names):
        cells = []
        for law in sweep.plan.laws:
            value, (low, _, high) = sweep.value(law, q.name), sweep.quantiles(law, q.name)
            between = "" if math.isnan(low) else f" [{low:.4g} to {high:.4g}]"
            cells.append(estimate_text(value, q.text) + mark(q, sweep.steady(law), value.value) + between)
        rows.append([q.heading, *cells])
    kept = [f"{int(sweep.kept(law).sum())} of {sweep.plan.count}" for law in sweep.plan.laws]
    return [*rows, [kept_words(sweep.quantities), *kept]]


def _over_first(sweep: Sweep, law: str, name: str) -> str:
    share, equal = sweep.better(law, name), sweep.equal(law, name)
    if equal == share.draws:
        return "equal in all"
    low, high = share.interval
    often = f"{100 * share.value:.3g} % ({100 * low:.0f} to {100 * high:.0f})"
    both = f", equal in {100 * equal / share.draws:.3g} %" if equal else ""
    q, base = sweep.quantities[name], sweep.plan.laws[0]
    loose = q.of_window and not (sweep.steady(law) and sweep.steady(base))
    if q.role == "rms" and all(sweep.value(one, name).value < q.zero for one in (law, base)):
        return "–"
    return f"{'–' if loose else change_text(sweep.change(law, name))}; {often}{both}"


def _deciding(sweep: Sweep, law: str, name: str) -> str:
    found = sweep.sensitivities[law].get(name)
    if found is None:
        return "–"
    few = found.deciding()[:FEW]
    texts = []
    for what, estimate in few:
        value, half = 100.0 * estimate.value, 100.0 * estimate.half_width
        digits = int(0.05 <= half < 0.95)
        texts.append(f"{what} {value:.{digits}f} ± {half:.{digits}f} %")
    return ", ".join(texts) or "none alone"


def remarks(sweep: Sweep) -> list[str]:
    """Return what has to be known to read the tables, a sentence each."""
    plan, said = sweep.plan, []
    count = plan.count

    def several(numbers: dict[str, int]) -> str:
        return ", ".join(f"{law} {number}" for law, number in numbers.items()) + f" of {count}"

    lost = {law: count - int(sweep.kept(law).sum()) for law in plan.laws}
    failed = {law: int(sweep.failed(law).sum()) for law in plan.laws}
    if any(lost.values()):
        where = "not in the means and changes, and worse in the shares" if sweep.counts else "none is left to compare"
        said.append(f"{lost_words(sweep.quantities)}: {several(lost)}; {where}")
    if any(failed.values()):
        said.append(f"of these ended by an error of an FMU: {several(failed)}")
    if not sweep.counts:
        return [*said, NOTHING]
    for name, q in sweep.quantities.items():
        never = {law: sweep.never(law, name) for law in plan.laws} if q.role == "settling" else {}
        if any(never.values()):
            said.append(f"{q.symbol} never, in the means counted as {_duration(sweep)}: {several(never)}")
    loose = [law for law in plan.laws if not sweep.steady(law)]
    if loose:
        said.append(f"* not steady: {', '.join(loose)} over the last {WINDOW:g} s; make run.duration longer")
    few = [law for law in plan.laws if not sweep.sensitivities[law]]
    if few:
        said.append(f"what decides is not told of {', '.join(few)}: it takes {LEAST} draws that count and differ")
    widest = max((e.half_width for e in _singles(sweep)), default=0.0)
    if widest > WIDE:
        said.append(f"shares of the variance are known to ± {100 * widest:.0f} % only; more draws tell more")
    if len(plan.drawn) == len(plan.variations) and not plan.seeded:
        said.append("nothing besides is left to chance: the plant's offsets and noise are fixed, or it has none")
    return said


def _singles(sweep: Sweep) -> list[Any]:
    return [e for of in sweep.sensitivities.values() for s in of.values() for e in s.single.values()]


def _duration(sweep: Sweep) -> str:
    varied = any(variation.path == "run.duration" for variation in sweep.plan.variations)
    return "the run's duration" if varied else f"{sweep.plan.scenario.run.duration:g} s"


def summary(sweep: Sweep) -> dict[str, Any]:
    """Return all that is told of a sweep, safe for JSON."""
    plan = sweep.plan
    return {
        "format": FORMAT,
        "scenario": plan.scenario.model_dump(mode="json"),
        "varied": {variation.name: variation.spec for variation in plan.variations},
        "drawn": list(plan.names.values()),
        "sampling": plan.sampling,
        "seed": plan.seed,
        "draws": plan.count,
        "quantiles": list(QUANTILES),
        "laws": {law: _law(sweep, law) for law in plan.laws},
        "over_first": {law: {name: _over(sweep, law, name) for name in sweep.shown} for law in plan.laws[1:]},
        "decides": {law: {n: _share(s) for n, s in found.items()} for law, found in sweep.sensitivities.items()},
        "remarks": remarks(sweep),
    }


def _law(sweep: Sweep, law: str) -> dict[str, Any]:
    metrics = {
        name: {
            "mean": pair(sweep.value(law, name)),
            "quantiles": [None if math.isnan(q) else q for q in sweep.quantiles(law, name)],
            "never": sweep.never(law, name),
        }
        for name in sweep.shown
    }
    kept, failed = int(sweep.kept(law).sum()), int(sweep.failed(law).sum())
    return {"kept": kept, "failed": failed, "steady": sweep.steady(law), "metrics": metrics}


def _over(sweep: Sweep, law: str, name: str) -> dict[str, Any]:
    share = sweep.better(law, name)
    better = {"wins": share.wins, "equal": sweep.equal(law, name), "interval": list(share.interval)}
    return {"change": pair(sweep.change(law, name)), **better}


def _share(found: Any) -> dict[str, Any]:
    return {
        "single": {name: pair(estimate) for name, estimate in found.single.items()},
        "pairs": {" with ".join(names): pair(estimate) for names, estimate in found.pairs.items()},
        "rest": found.rest,
        "draws": found.draws,
    }
