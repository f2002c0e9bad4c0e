"""Paths may be texts wherever a library takes one."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cosim import parameter_files, ssp
from cosim.linearize import linear_model
from cosim.master import simulate
from cosim.overlay import lay
from cosim.results import Result
from cosim.scenario import load_scenario
from cosim.scenario_run import run_scenario
from cosim.scenario_system import build_system
from cosim.structure import Component, SystemStructure
from cosim.system_export import export_system, exported_files
from cosim.system_file import write
from ihc_fmu.design import Design
from ihc_fmu.inverse import inverse_design
from ihc_fmu.synthesis import chosen_options
from ihc_fmu.system import System as Model
from plant_fmu.parameters import PARAMETER_SETS


def test_paths_may_be_texts(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    A, B, K = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]]), np.array([[-2.0, -3.0]])
    Model(A=A, B=B, K=K, name="cart").save("cart.toml")
    system = Model.load("cart.toml")
    design = inverse_design(system, chosen_options(system).options)
    design.save("cart.json")
    paths = export_system(Design.load("cart.json"), "fz")
    assert paths == [Path("fz") / name for name in exported_files(system)]
    assert all(path.is_file() for path in paths)
    model = linear_model("fz/cart_linear_plant.fmu", ["u1"])
    assert write("found.toml", model).n == 2
    scenario = load_scenario("fz/cart.ssp")[0].changed({"run.duration": 0.1})
    result = run_scenario(scenario, "fz", "fz", target="results")
    result.save("results/cart.csv")
    assert Result.load("results/cart.csv").time.tolist() == result.time.tolist()
    assert lay("results/cart.csv", scenario, "fz").left_out == ()
    ssp.write("again.ssp", "cart", build_system(scenario, "fz"), 1.0, 1e-3)
    alone = SystemStructure([Component("plant", "fz/cart_linear_plant.fmu")])
    assert len(simulate(alone, 0.1, 1.0, folder="results").time) == 11
    parameter_files.save("set.toml", PARAMETER_SETS["ident"])
    assert parameter_files.load("set.toml").parameters == PARAMETER_SETS["ident"].parameters
