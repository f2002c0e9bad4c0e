"""The largest unit ball of a homogeneous controller: log det X, X = P^-1, maximized under its matrix inequalities.

With X free, and where a gain is designed Y = (K - K_0) X too:

    A_cl X + X A_cl' + alpha (G_d X + X G_d') + disturbance terms + slack X <= 0,   G_d X + X G_d' >= 2 beta X,

A_cl X = A_0 X + B Y for a designed gain, and |(K - K_0)_i x| <= u_max_i, |x_index| <= delta_max where x' P x <= 1. It is
written in the coordinates of a `Problem` in which X is about the unit matrix, so that neither the units of the system nor
how flat its ball is in them enters. What is found is the analytic center GAP below the largest ball, a point that does not
depend on coordinates. The slack is for what rounding takes from P in the coordinates of x.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import LinAlgError

from fmu_export.errors import UserError

from .barrier import Affine, center, inside
from .certificate import CertificateError
from .design import Design
from .lmi import InfeasibleError, Problem, flatness
from .options import Options
from .system import System

Array = np.ndarray

GAP, FIRST_GAPS = 1e-6, (1e2, 1.0, 1e-2, 1e-4)
"""Of log det X to the largest one; and of the centers on the way, each in the coordinates of the one before."""
SLACK, ROUNDING = 1e-6, 1e-15
"""Of the inequalities, relative to X; and what is added to (11)'s: times the norm of the closed loop over P's flatness."""
ROUNDS, SETTLED = 12, 1e-2
"""Most centers after those, and ln X that counts as no change."""
FEWER_DIGITS = "a smaller mu, an alpha nearer to the system's own rates and more inputs need fewer digits"
MULTIPLIERS = tuple(np.geomspace(1e-2, 1e2, 25).tolist())
"""Values of tau d_max^2, a rate, relative to omega, that are tried for a matched disturbance."""


def largest_ball(system: System, problem: Problem, omega: float, rate: float, options: Options, what: str) -> Design:
    """Return the design with the largest unit ball for the decrease `rate` [1/s], which may exceed the options' alpha.

    `problem` is in coordinates in which P = I serves, its time in 1/omega [1/s]; without a gain in `system` it is the
    nilpotent system with a Y = -c B'. For a matched disturbance the best of a grid of its multiplier tau is taken.
    """
    if options.delta_max is not None and not 0 <= options.index < system.n:
        raise UserError(f"the bounded state must be one of 0..{system.n - 1}, found {options.index}")
    program = _Program(system, problem, omega, rate, options, what)
    if not options.d_max:
        return program.design(1.0)
    best: Design | None = None
    for share in MULTIPLIERS:
        try:
            design = program.design(share * omega / options.d_max**2)
        except (InfeasibleError, CertificateError):
            continue
        if best is None or np.linalg.slogdet(design.P)[1] < np.linalg.slogdet(best.P)[1]:
            best = design
    if best is None:
        raise InfeasibleError(f"{what}: no P proves the rejection of |d| <= {options.d_max:g}")
    return best


def rejecting(
    system: System, problem: Problem, omega: float, rate: float, options: Options, shares: Sequence[float] = MULTIPLIERS
) -> list[float]:
    """Return those `shares` of MULTIPLIERS with which some ball satisfies all that `largest_ball` asks for at `rate`."""
    program = _Program(system, problem, omega, rate, options, "")
    return [share for share in shares if program.has_ball(share * omega / options.d_max**2)]


class _Program:
    """The program in the coordinates of any problem; v is the upper triangle of X, then Y in units of the bounds."""

    def __init__(
        self, system: System, problem: Problem, omega: float, rate: float, options: Options, what: str
    ) -> None:
        self.system, self.omega, self.rate, self.options, self.what = system, omega, rate, options, what
        self.bounds = options.bounds(system.m)
        self.designed = system.K is None
        self.first = problem if self.designed else problem.to(np.eye(system.n) * self._size(problem) ** 2)
        n, free = system.n, system.m * system.n * self.designed
        upper = np.triu_indices(n)
        self.X = np.zeros((len(upper[0]) + free, n, n))
        self.X[range(len(upper[0])), upper[0], upper[1]] = self.X[range(len(upper[0])), upper[1], upper[0]] = 1.0
        self.Y = np.zeros((len(self.X), system.m, n))
        self.Y[len(upper[0]) :] = np.eye(free).reshape(free, system.m, n) if free else 0.0

    def _rows(self, problem: Problem) -> list[Array]:
        """Return rows f of the bounds f X f' <= 1 in the coordinates of a problem."""
        rows = []
        if not self.designed and self.bounds is not None:
            rows += list((self.system.K - self.system.form.K_0) @ problem.S / self.bounds[:, None])
        if self.options.delta_max is not None:
            rows.append(problem.S[self.options.index] / self.options.delta_max)
        return rows

    def _size(self, problem: Problem) -> float:
        """Return the largest of what the bounds limit on the unit ball, relative to its bound."""
        return max((float(np.linalg.norm(row)) for row in self._rows(problem)), default=0.0) or 1.0

    def has_ball(self, tau: float) -> bool:
        """Return whether any X satisfies all inequalities strictly, with the multiplier tau."""
        return inside(*self._sides(self.first, tau), self._start(self._first_Y())) is not None

    def design(self, tau: float) -> Design:
        """Return the design with the multiplier tau; where rounding ends the way, the largest ball until then, or the first.

        Each center is found in the coordinates of the one before, until that does not change: from there on the slack does
        not either.
        """
        problem, Y, design = self.first, self._first_Y(), None
        failed: Exception = InfeasibleError(f"{self.what}: no largest unit ball was found", numerical=True)
        for gap in [*FIRST_GAPS, *ROUNDS * [GAP]]:
            values = self._center(problem, Y, tau, gap)
            if values is None:
                break
            X, Y = values
            try:
                inverse = np.linalg.inv(X)
                following, L = problem.to(inverse), np.linalg.cholesky((inverse + inverse.T) / 2)
            except LinAlgError as error:
                failed = error
                break
            if gap == GAP:
                try:
                    design = self._made(problem, following, X, Y, tau)
                except CertificateError as error:  # flatter than where it was begun: its slack comes with the next
                    failed = error
                else:
                    if float(np.abs(np.log(np.linalg.eigvalsh(X))).max()) < SETTLED:
                        return design
            problem, Y = following, Y @ L  # (K - K_0) S, and so Y, where X is I
        if design is None:
            design = self._first(tau, failed)
        return replace(design, method=f"{design.method}, ball not maximized")

    def _first_Y(self) -> Array:
        """Return Y of the closed form, whose X is I in the first coordinates; nothing where there is a gain."""
        if not self.designed or self.bounds is None:
            return np.zeros((self.system.m, self.system.n))
        Y = -self.first.B.T * self.bounds[:, None]
        return Y / max(float(np.linalg.norm(row)) for row in Y)

    def _first(self, tau: float, failed: Exception) -> Design:
        """Return the design whose unit ball is y' y <= 1 in the first coordinates."""
        if self.options.psi or self.options.d_max:
            raise failed
        try:
            return self._made(self.first, self.first, np.eye(self.system.n), self._first_Y(), tau)
        except CertificateError as error:
            message = f"{self.what}: what was found does not prove itself in double precision: {error}; {FEWER_DIGITS}"
            raise InfeasibleError(message, numerical=True) from failed

    def _center(self, problem: Problem, Y: Array, tau: float, gap: float) -> tuple[Array, Array] | None:
        """Return X and Y of the center in the coordinates of `problem`, from X = I and Y; None where rounding hides it."""
        volume, sides = self._sides(problem, tau)
        start = self._start(Y)
        v = inside(volume, sides, start)
        if v is not None:
            v = center(volume, sides, v, gap, near=v is start and gap < FIRST_GAPS[0])
        return None if v is None else (volume.at(v), np.tensordot(v, self.Y, 1))

    def _start(self, Y: Array) -> Array:
        """Return the v of X = I and Y."""
        triangle = np.eye(self.system.n)[np.triu_indices(self.system.n)]
        return np.append(triangle, Y.ravel() if self.designed else [])

    def _sides(self, problem: Problem, tau: float) -> tuple[Affine, list[Affine]]:
        """Return X, and what must be positive definite, X the first of it."""
        o, X, Y, n = self.options, self.X, self.Y, self.system.n
        slack = SLACK + ROUNDING * float(np.linalg.norm(problem.closed, 2)) / flatness(problem)
        nothing, reach = np.zeros((n, n)), problem.B / self.omega
        G = np.eye(n) + o.mu * problem.E
        M = (problem.closed + (self.rate / self.omega) * G + 0.5 * slack * np.eye(n)) @ X
        if self.designed and self.bounds is not None:
            M = M + (reach * self.bounds) @ Y
        given = nothing
        if o.d_max:
            given = problem.B @ reach.T / tau
            M = M + 0.5 * (tau * o.d_max**2 / self.omega) * X
        decrease = Affine(-given, -M - M.transpose(0, 2, 1))
        if o.psi:  # psi I in the coordinates of x, by a Schur complement
            SX = problem.S @ X
            slopes = np.block([[decrease.slopes, SX.transpose(0, 2, 1)], [SX, np.zeros_like(X)]])
            decrease = Affine(np.block([[-given, nothing], [nothing, (self.omega / o.psi) * np.eye(n)]]), slopes)
        monotone = (G - o.beta * (1 + SLACK) * np.eye(n)) @ X
        sides = [Affine(nothing, X), Affine(nothing, monotone + monotone.transpose(0, 2, 1)), decrease]
        sides += [Affine(np.eye(1), -(row @ X @ row)[:, None, None]) for row in self._rows(problem)]
        if self.designed:  # |Y_i X^-1 Y_i'| <= 1
            one = np.diag([1.0, *n * [0.0]])
            for row in self.Y.transpose(1, 0, 2)[:, :, None]:
                empty = np.zeros((len(X), 1, 1))
                sides.append(Affine(one, np.block([[empty, row], [row.transpose(0, 2, 1), X]])))
        return sides[0], sides

    def _made(self, problem: Problem, ball: Problem, X: Array, Y: Array, tau: float) -> Design:
        """Return the design whose unit ball is y' y <= 1 in the coordinates of `ball`; X and Y are in those of `problem`."""
        o, system = self.options, self.system
        if self.designed and self.bounds is not None:
            K_h = self.bounds[:, None] * np.linalg.solve(X, Y.T).T @ problem.R
            system = system.changed(K=system.form.K_0 + K_h)
        P = ball.R.T @ ball.R
        method = "direct (9)" if self.designed else "inverse (10)-(11)"
        return Design(system, (P + P.T) / 2, o.mu, o.alpha, o.psi, o.d_max, tau, method)
