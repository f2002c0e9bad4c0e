"""The command `design`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from filing.ownership import check_replaceable

from ..errors import UserError
from .display import console, escaped, interruptible, print_design, print_residual, problems, say_notes


class Method(StrEnum):
    """How P and k are found."""

    inverse = "inverse"
    direct = "direct"


def design(
    system: Annotated[
        Path | None,
        typer.Option(
            help="TOML file of a system: A, B and, for the inverse method, K or lqr; none: the paper's pendulum."
        ),
    ] = None,
    method: Annotated[
        Method, typer.Option(help="inverse: from K, eqs. (10)-(11); direct: K free, eq. (9).")
    ] = Method.inverse,
    mu: Annotated[
        float | None, typer.Option(help="Minus the degree of homogeneity, in (0, 1]; none: 1, or the largest found.")
    ] = None,
    alpha: Annotated[
        float | None,
        typer.Option(help="Decrease to prove: d||x||/dt <= -alpha ||x||^(1-mu) [1/s]; none: half of the largest one."),
    ] = None,
    u_max: Annotated[
        str | None,
        typer.Option(
            help="Scale of P: largest homogeneous part |(K - K_0) x| of the control on the unit ball, a number or one per "
            "input, separated by commas; none: half of what the limits leave."
        ),
    ] = None,
    delta_max: Annotated[float | None, typer.Option(help="Scale of P: largest state --state on the unit ball.")] = None,
    state: Annotated[
        str | None, typer.Option(help="Name of the state that --delta-max bounds; none: the second.")
    ] = None,
    beta: Annotated[float, typer.Option(help="Monotonicity of the dilation, G X + X G' >= 2 beta X.")] = 0.1,
    psi: Annotated[float, typer.Option(help="Remark 3: bound of the remainder, adds psi I to the inequality.")] = 0.0,
    d_max: Annotated[
        float, typer.Option(help="Matched disturbance that the proof must reject, in units of the input; mu = 1 only.")
    ] = 0.0,
    residual: Annotated[
        float | None,
        typer.Option(
            metavar="A_MIN",
            help="Also print what counted sensors leave in the steady state with this a_min, with the controller's Kalman "
            "filter.",
        ),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Where to write the design; none: `design.json`.")
    ] = None,
) -> None:
    """Turn a linear controller into an implicit homogeneous one and prove it by matrix inequalities.

    Without options this is the paper's example. The numbers, why they were chosen, their certificate and the largest
    feasible alpha, or the control of a direct design, are printed; the file goes into `export --design`.
    """
    path = output or Path("design.json")
    if path.suffix != ".json":
        raise UserError(f"--output must name a .json file, found {path}")
    check_replaceable(path, kind="design")
    with interruptible(path):
        from .. import designing

        wish = designing.Wish(method is Method.direct, mu, alpha, u_max, delta_max, state, beta, psi, d_max)
        of, wish = designing.system_and_wish(system, wish)
        with problems.status("solving the matrix inequalities") as shown:
            solved, choice = designing.find(of, wish, shown.update)
            found = None if residual is None else designing.residual_of(solved, residual)
            solved.save(path)
            print_design(solved, choice.reasons)
            say_notes([*designing.beyond_limits(solved), *designing.unexportable(solved)])
            console.print(escaped(designing.prospect(solved, choice.options, wish.direct, shown.update)))
            if found is not None and residual is not None:
                print_residual(solved, residual, found)
    console.print(f"wrote {escaped(path)}")
