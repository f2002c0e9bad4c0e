"""Multiple shooting: the Jacobian is that of the residuals with the initial states eliminated."""

import numpy as np

from cosim.hil.segments import cut
from cosim.hil.shooting import Shooting
from cosim.scenario import load_scenario
from cosim.scenario_run import run_scenario
from plant_fmu.parameters import PARAMETER_SETS


def test_the_projected_jacobian_gives_the_gradient_of_what_is_left(fmus):
    """Of the sum of squares with the best initial states, by central differences."""
    scenario, folder = load_scenario("swing_up")
    log = run_scenario(scenario.changed({"run.duration": 4.0}), fmus, folder)
    problem = Shooting(cut(log, 0.1), PARAMETER_SETS["ident"], ("D_r", "D_p", "T_r"))
    z = np.array([1.2, 0.8, 3.0, 0.4])
    gradient = problem.jacobian(z).T @ problem.residuals(z)

    def cost(z):
        r = problem.residuals(z)
        return r @ r / 2

    h = 0.02
    differences = [(cost(z + h * e) - cost(z - h * e)) / (2 * h) for e in np.eye(4)]
    np.testing.assert_allclose(gradient, differences, rtol=0.02)
