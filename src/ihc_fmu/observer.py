"""The homogeneous observer of a system, from a linear one that works: the dual of the design of a homogeneous law.

    z' = A z + B u + S (C z - y),   S = L_0 + (q/q_linear)^(nu (I + G_0)) (L - L_0),   q = |C z - y|,   nu <= 0.

The block form of (A', C') gives L_0 = K_0', for which A + L_0 C is nilpotent, and G_0 = (T^-1 diag(e) T)'. Without limits
of q the error z - x is homogeneous of degree nu, and at q = q_linear the observer is the linear one with the gain L, A + L C
Hurwitz: smaller errors meet larger gains. q is limited to [q_min, q_max], which bounds them.

What is checked is that A + L C is Hurwitz, and nu_min <= nu <= 0: down to nu_min the dilation I + nu G_0 is monotone with a
margin for the Lyapunov function of A + L C, and S (C z - y) is bounded near q = 0. That is no proof. `observer_proof` looks
for one: that without noise every error of a stated ellipsoid vanishes. It says nothing of the law that takes the estimate.

Source: A. Polyakov, Generalized Homogeneity in Systems and Control, Springer 2020, and the authors' toolbox.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.linalg import solve_continuous_lyapunov
from scipy.signal import place_poles

from fmu_export.errors import UserError, shown

from .block_form import BlockForm, block_form, scaling
from .design import Design
from .estimation import estimator, noise
from .observer_proof import prove
from .observer_wish import ObserverWish
from .regulator.start_values import Observer
from .system import System

Array = np.ndarray

SHARES_OF_DEGREE = (0.5, 0.25, 0.125, 0.0)
"""nu, where none is given, relative to nu_min: the first one that is proven; without a proof the first."""
SHARE_OF_ERROR, DEVIATIONS = 0.01, 3.0
"""q_min, where none is given: this share of q_max, but not below so many standard deviations of the sensors' noise."""


def homogeneous_observer(design: Design) -> Observer:
    """Return the observer that the system of a design asks for; what its wish leaves open is chosen.

    L: of a steady-state Kalman filter without disturbances, for the sensors' noise. nu: half of nu_min, or a quarter or an
    eighth of it, or 0, the first one with a proof that errors vanish. q_max: the largest
    |C x| on the unit ball; q_min: a hundredth of it or 3 standard deviations of the noise; q_linear: q_max. Raises UserError
    for a model that is not observable, an L for which A + L C is not Hurwitz, and a nu below nu_min.
    """
    system, wish = design.system, design.system.observer
    assert wish is not None
    A, C = system.A, np.asarray(system.C)
    form = _dual_form(system)
    L = _gain(design, wish)
    _check_hurwitz(A, C, L)
    lowest = least_degree(A, C, L, form, design.extent)
    if wish.nu is not None and wish.nu < lowest:
        raise UserError(f"observer.nu must lie in [{lowest:.4g}, 0] for this gain, found {wish.nu:g}")
    limits = _limits(design, wish)
    if wish.nu is not None:
        return _observer(design, wish, form, L, wish.nu, limits)
    tried = [_observer(design, wish, form, L, share * lowest, limits) for share in SHARES_OF_DEGREE]
    return next((observer for observer in tried if prove(observer, design.extent) is not None), tried[0])


def _observer(
    design: Design, wish: ObserverWish, form: BlockForm, L: Array, nu: float, limits: tuple[float, float]
) -> Observer:
    q_min, q_max = limits
    L_0 = form.K_0.T
    powers = (q_max if wish.q_linear is None else wish.q_linear) ** (-nu * (1.0 + np.array(form.exponents)))
    return Observer(
        A=design.A,
        B=design.B,
        C=np.asarray(design.system.C),
        T=form.T,
        exponents=form.exponents,
        L_0=L_0,
        L=L_0 + form.T.T @ (powers[:, None] * (form.T_inverse.T @ (L - L_0))),
        nu=nu or 0.0,  # never -0
        q_min=q_min,
        q_max=q_max,
    )


def remark(design: Design) -> str:
    """Return what is proven of the observer that the system of a design asks for, a sentence."""
    observer = homogeneous_observer(design)
    proof = prove(observer, design.extent)
    linear = "" if observer.nu else ", the linear observer,"
    what = f"the homogeneous observer of degree nu = {observer.nu:.3g}{linear}"
    if proof is None:
        nearer = "; a nu nearer to 0 may have one" if observer.nu else ""
        return f"{what} is not proven: no proof was found that its errors vanish{nearer}"
    sizes = zip(design.system.states, proof.reach, strict=True)
    reach = ", ".join(f"{q.name} {size:.3g}{q.suffix}" for q, size in sizes)
    return f"{what} is proven, by eigenvalues: without noise errors vanish within an ellipsoid that reaches to {reach}"


def least_degree(A: Array, C: Array, L: Array, form: BlockForm, sizes: Array) -> float:
    """Return nu_min = -min(1/k, 1/lambda), k the number of blocks of the dual's `form`.

    lambda is the largest eigenvalue of G_0' P + P G_0 in the coordinates in which P is the unit matrix, and P solves
    (A + L C) P + P (A + L C)' = -2 I, with states divided by their `sizes` (n,): with sizes of 1 the authors' toolbox. Down
    to nu_min the sum of I + nu G_0 and its transpose is there at least I.
    """
    M = (A + L @ C).T * sizes[:, None] / sizes
    E = (form.T_inverse @ (np.array(form.exponents)[:, None] * form.T)) * sizes[:, None] / sizes
    R = np.linalg.cholesky(solve_continuous_lyapunov(M.T, -2.0 * np.eye(len(A)))).T
    W = R @ E @ np.linalg.inv(R)
    largest = float(np.linalg.eigvalsh(W + W.T)[-1])
    return -min(1.0 / len(form.sizes), 1.0 / largest if largest > 0.0 else np.inf)


def _dual_form(system: System) -> BlockForm:
    try:
        return block_form(system.A.T, np.asarray(system.C).T, [q.name for q in system.states])
    except UserError:
        raise UserError(
            "a homogeneous observer needs outputs that tell all states, (A, C) observable; a Kalman filter needs less"
        ) from None


def _gain(design: Design, wish: ObserverWish) -> Array:
    """Return the gain L (n, p) of the linear observer."""
    s = design.system
    if wish.L is not None:
        return wish.L
    if wish.poles is not None:
        return _placed(s.A, np.asarray(s.C), wish.poles)
    if wish.Q is not None and wish.R is not None:
        dual = System(A=s.A.T, B=np.asarray(s.C).T)
        try:
            K = dual.with_lqr(wish.Q, wish.R).K
        except UserError as error:
            raise UserError(str(error).replace("lqr", "observer").replace("(A, B)", "(A', C')")) from None
        assert K is not None
        return K.T
    kalman = estimator(replace(design, system=s.changed(observer=None, bandwidth=0.0)))
    return -kalman.M[: s.n] / s.sample_time


def _placed(A: Array, C: Array, poles: Array) -> Array:
    """Return L with the eigenvalues `poles` of A + L C, by SciPy's robust placement in scaled units."""
    n = len(A)
    if poles.shape != (n,):
        raise UserError(f"observer.poles must be {n} numbers, one for each state, found {poles.size}")
    by = scaling(A.T, C.T)
    A_s = A.T * by.states / by.states[:, None] / by.omega
    B_s = C.T * by.inputs / by.states[:, None] / by.omega
    values, counts = np.unique(poles, return_counts=True)
    rank = int(np.linalg.matrix_rank(B_s))
    if counts.max() > rank:
        raise UserError(
            f"observer.poles must not hold a number more often than there are independent outputs, {rank}, found "
            f"{values[counts.argmax()]:g} {counts.max()} times; set them slightly apart"
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # how robust it is does not matter; that A + L C is Hurwitz is checked
            placed: Any = place_poles(A_s, B_s, poles / by.omega)
    except ValueError:
        raise UserError(f"observer.poles cannot be placed for this model, found {shown(poles)}") from None
    return -(by.inputs[:, None] * placed.gain_matrix / by.states).T


def _check_hurwitz(A: Array, C: Array, L: Array) -> None:
    slowest, opposite = (float(np.linalg.eigvals(A + sign * L @ C).real.max()) for sign in (1.0, -1.0))
    if slowest >= 0.0:
        hint = "; -L would, if the observer is meant as z' = A z + L (y - C z)" if opposite < 0.0 else ""
        raise UserError(
            f"observer: L must make A + L C stable, the largest real part of its eigenvalues is {slowest:.4g} 1/s{hint}"
        )


def _limits(design: Design, wish: ObserverWish) -> tuple[float, float]:
    C = np.asarray(design.system.C)
    q_max = wish.q_max
    if q_max is None:
        q_max = float(np.sqrt(np.linalg.eigvalsh(C @ np.linalg.solve(design.P, C.T))[-1]))
    q_min = wish.q_min
    if q_min is None:
        floor = DEVIATIONS * float(np.sqrt(sum(noise(design).outputs)))
        q_min = min(q_max, max(SHARE_OF_ERROR * q_max, floor))
    if q_min > q_max:
        raise UserError(f"observer.q_min must not exceed observer.q_max, found {q_min:g} and {q_max:g}")
    return q_min, q_max
