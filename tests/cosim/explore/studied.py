"""Files as `region` and `tune --pareto` leave them, of few points, and spoilt ones."""

import itertools
import json

HALF = 0.5
"""|delta| [rad] within which a start is attracted, on a lattice of 4 cells from -1 to 1."""


ENDS = {"plant.delta_0": (1.0, "rad"), "plant.delta_dot_0": (8.0, "rad/s")}


def write_region(folder, over=("plant.delta_0", "plant.delta_dot_0"), **changes):
    """Write region.json and region.csv of the law LC over delta, or delta and its velocity."""
    entries = {name: name.replace(".", ".start.") for name in over}
    named = [
        {"name": name, "entry": entries[name], "low": -end, "high": end, "unit": unit}
        for name, (end, unit) in ENDS.items()
        if name in over
    ]
    n = len(over)
    data = {
        "format": "qube-ihc region 1",
        "scenario": {},
        "axes": named,
        "cells": {"coarse": 4, "finest": 4},
        "supervisor_opened": True,
        "laws": {"LC": {}},
        "certified": {"Q": [[30.0 * (i == j) for j in range(n)] for i in range(n)], "centre": [0.0] * n},
    }
    rows = [["law", "draw", *over, "outcome", "settled"]]
    for place in itertools.product(range(5), repeat=len(over)):
        values = [(k / 2 - 1.0) * axis["high"] for k, axis in zip(place, named, strict=True)]
        came = ["attracted", repr(1.0 + values[0])] if abs(values[0]) <= HALF else ["lost", ""]
        rows.append(["LC", "", *map(repr, values), *came])
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "region.json").write_text(json.dumps(data | changes), encoding="utf-8")
    (folder / "region.csv").write_text("".join(",".join(row) + "\n" for row in rows), encoding="utf-8")


def write_front(folder):
    """Write front.csv of two objectives: the LC, two points of the front of which one is chosen, one infeasible."""
    objective = ("{} in the search", "{}", "{} interval", "{} over LC", "{} over LC interval")
    heads = [text.format(name) for name in ("settling_time", "energy") for text in objective]
    rows = [["kind", "chosen", "a_min", "b_max", "u_max", *heads, "kept", "draws"]]
    points = [
        ("LC", 0, ("", "", ""), 1.7, 0.43),
        ("front", 1, (0.4, 1.5, 2.0), 1.0, 0.4),
        ("front", 0, (0.6, 1.0, 3.0), 0.5, 0.9),
        ("infeasible", 0, (0.1, 1.0, 3.0), "nan", "inf"),
    ]
    for kind, chosen, values, settling, energy in points:
        judged = [number for value in (settling, energy) for number in (value, value, 0.1, 0.0, 0.0)]
        rows.append([str(cell) for cell in (kind, chosen, *values, *judged, 16, 16)])
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "front.csv").write_text("".join(",".join(row) + "\n" for row in rows), encoding="utf-8")
