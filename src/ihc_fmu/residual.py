"""What counted sensors leave of a sampled loop: how far from the equilibrium it moves in the end, and why.

Where the norm is below a_min the law is linear, with the gains of r = a_min. With its estimator and the exact model of a
held input it is the sampled linear loop z+ = A z + B e, e the error of the measured outputs. A counter of resolution q,
zeroed anywhere inside a count, has e = c + s: the constant c, uniform in +-q/2, and s, within +-q/2, that moves with what is
counted. Three answers follow from the loop's impulse response g:

- white: s is taken for white noise of variance q^2/12, as usual. Too small, since s only changes as the output moves.
- rms: s has the spectrum that the motion which it causes gives it. Over a Gaussian motion whose displacement within k
  samples has the variance v(k) the correlation of s is (q^2/2 pi^2) sum over i of exp(-2 pi^2 i^2 v(k)/q^2)/i^2 (W. R.
  Bennett, Bell System Technical Journal 27, 1948, 446-472; B. Widrow and I. Kollar, Quantization Noise, Cambridge 2008).
  The motion is what the loop makes of s: a fixed point. The root mean square over the zero offsets, c included.
- bound: sum over k of |g(k)| q/2, and |sum of g| q/2 for c: no error within these limits moves the loop farther. It is
  proven for the law where the same bound of its estimate lies in the ball ||x||_d <= a_min and that of its inputs within
  their limits, in the end and from states near enough.

What is left out: friction and other nonlinearities, a plant that is not the model, and what happens beyond the ball.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from fmu_export.errors import UserError

from .arrays import QUIET, Array
from .controller import regulator_of
from .design import Design
from .regulator.start_values import LinearFilter

LEFT_OUT = 1e-3
"""Of the sum of an impulse response's sizes: where it ends. What follows is bounded."""
LONGEST, LARGEST = 2**17, 2**23
"""Most samples, and entries, of an impulse response."""
CLOSE = 0.2
"""Displacement in counts below which the correlation of counting errors is a parabola, to 1e-6 of it."""
HARMONICS = 6
"""Of the sawtooth beyond, to the same precision."""
ROUNDS, CONVERGED = 200, 1e-5
"""Of the fixed point at most, and the relative change that ends it."""


class SampledController(NamedTuple):
    """A linear controller: s+ = E s + L y, u = U s + V y, and the law's state x^ = X s + Y y, of the measured outputs y."""

    E: Array
    L: Array
    U: Array
    V: Array
    X: Array
    Y: Array


class Sensors(NamedTuple):
    """Resolutions and deviations of the measured outputs, (p,) each; 0 for none."""

    resolutions: Array
    deviations: Array


@dataclass(frozen=True, slots=True, eq=False)
class Residual:
    """Where a sampled loop with counted sensors ends: root mean squares, and bounds of the magnitude.

    Parameters
    ----------
    white
        Of the states, with the counting errors as white noise of variance q^2/12, shape (n,).
    rms
        Of the states, with the spectrum that the motion gives the counting errors, over the zero offsets, shape (n,).
    bound
        Of the states' magnitudes, whatever the counting errors, shape (n,); infinite where a sensor has noise.
    input_rms, input_bound
        The same of the inputs, shape (m,).
    norm_rms, norm_bound
        The same of the estimated state's norm in the ball where the law is this linear one, ||d(-ln a_min) x||_P: up to 1 it
        is.
    limited
        Whether `input_bound` exceeds what the limits leave.
    radius
        Largest magnitude of the loop's poles, below 1.

    Examples
    --------
    >>> from ihc_fmu import System, residual_set, synthesize
    >>> cart = System(A=[[0, 1], [0, 0]], B=[0, 1], C=[[1, 0]], K=[-4, -4], resolutions=[1e-3])
    >>> found = residual_set(synthesize(cart), a_min=0.5)
    >>> found.proven, bool((found.white < found.rms).all() and (found.rms < found.bound).all())
    (True, True)
    """

    white: Array
    rms: Array
    bound: Array
    input_rms: Array
    input_bound: Array
    norm_rms: float
    norm_bound: float
    limited: bool
    radius: float

    @property
    def proven(self) -> bool:
        """Whether `bound` is one of the law, and not only of the linear one."""
        return self.norm_bound <= 1.0 and not self.limited


def residual_set(design: Design, a_min: float = 0.5, *, semi_implicit: bool = True) -> Residual:
    """Return what the controller of a design leaves of its linear plant with the counters and noise of its system.

    Parameters
    ----------
    design
        Any but one with a homogeneous observer or integral action. The pendulum's controller has an estimator of its own:
        `ihc_fmu.pendulum.residual`.
    a_min
        Smallest norm in the law; 1, and `semi_implicit` false, is the LC.
    semi_implicit
        The law's discretization, that of the FMU by default.

    Returns
    -------
    Residual
        With the design's Kalman filter, whose disturbances are compensated, or with measured states.

    Raises
    ------
    UserError
        For an observer, integral action, an a_min that is not positive, and a loop that is not stable.

    Examples
    --------
    >>> from ihc_fmu import System, residual_set, synthesize
    >>> cart = System(A=[[0, 1], [0, 0]], B=[0, 1], C=[[1, 0]], K=[-4, -4], resolutions=[1e-3])
    >>> design = synthesize(cart)
    >>> bool(residual_set(design, 0.3).bound[0] > residual_set(design, 1.0).bound[0])
    True
    """
    system, h = design.system, design.system.sample_time
    if system.observer is not None or system.integral is not None:
        raise UserError("the residual set is that of a Kalman filter or measured states without integral action")
    K = gain_at(design, a_min, h if semi_implicit else 0.0)
    estimator = regulator_of(design).filter
    controller = filtered(estimator, K) if isinstance(estimator, LinearFilter) else direct(K)
    F, G = held(system.A, system.B, h)
    sensors = Sensors(np.asarray(system.resolutions), np.asarray(system.deviations))
    if not (sensors.resolutions.any() or sensors.deviations.any()):
        raise UserError(
            "the residual set is what counting and noise leave, and no output has a resolution or a deviation"
        )
    return residual_of(F, G, np.asarray(system.C), controller, sensors, ball(design, a_min), system.room)


def gain_at(design: Design, r: float, h: float) -> Array:
    """Return the gain (m, n) of the law at the norm `r`, semi-implicit for samples of `h` [s], explicit for 0.

    K_r = K_0 + r^(1-mu) (K - K_0) d(-ln r), and K_r (I - h (A + B K_r))^-1.
    """
    if not r > 0.0:
        raise UserError(f"a_min must be positive, found {r:g}")
    form = design.form
    K = form.K_0 + r ** (1.0 - design.mu) * (design.K - form.K_0) @ dilation(design, r)
    return K @ np.linalg.inv(np.eye(design.n) - h * (design.A + design.B @ K)) if h else K


def dilation(design: Design, r: float) -> Array:
    """Return d(-ln r), (n, n)."""
    form = design.form
    return form.T_inverse @ (r ** -form.weights(design.mu)[:, None] * form.T)


def ball(design: Design, r: float) -> Array:
    """Return R (n, n) with |R x| = ||d(-ln r) x||_P."""
    return np.linalg.cholesky(design.P).T @ dilation(design, r)


def held(A: Array, B: Array, h: float) -> tuple[Array, Array]:
    """Return F (n, n), G (n, m): x+ = F x + G u for an input held for `h` [s]."""
    n, m = B.shape
    step = expm(h * np.block([[A, B], [np.zeros((m, n + m))]]))
    return step[:n, :n], step[:n, n:]


def direct(K: Array) -> SampledController:
    """Return u = K y: the states are measured."""
    m, n = K.shape
    none = np.zeros((0, n))
    return SampledController(np.zeros((0, 0)), none, np.zeros((m, 0)), K, np.zeros((n, 0)), np.eye(n))


def filtered(f: LinearFilter, K: Array, *, compensated: bool = True) -> SampledController:
    """Return u = K x^ - d^ for the Kalman filter's estimates, u = K x^ where the disturbances are not `compensated`."""
    (n, m), p = f.G.shape, len(f.C)
    kept = [i for i in range(n + m + p) if i < n or np.any(f.M[i])]  # what is not estimated stays 0
    command = np.hstack([K, -float(compensated) * np.eye(m), np.zeros((m, p))])
    predicted = np.eye(n + m + p)
    predicted[:n, :n], predicted[:n, n : n + m] = f.F, f.G
    predicted[:n] += f.G @ command
    predicted[n + m :, n + m :] *= f.decay
    seen = np.hstack([f.C, np.zeros((p, m)), np.eye(p)])
    E = ((np.eye(n + m + p) - f.M @ seen) @ predicted)[np.ix_(kept, kept)]
    L, U = f.M[kept], command[:, kept]
    return SampledController(E, L, U @ E, U @ L, E[:n], L[:n])


@QUIET
def residual_of(
    F: Array, G: Array, C: Array, controller: SampledController, sensors: Sensors, ball: Array, room: Array
) -> Residual:
    """Return what a loop leaves: the plant x+ = F x + G u, y = C x, its sensors and its controller.

    `ball` (k, n): |ball x^| <= 1 is where the law is this linear one. `room` (m,): the inputs' limits. Raises UserError for
    a loop that is not stable.
    """
    E, L, U, V, X, Y = controller
    (n, m), p = G.shape, len(C)
    A = np.block([[F + G @ V @ C, G @ U], [L @ C, E]])
    B = np.vstack([G @ V, L])
    radius = float(np.abs(np.linalg.eigvals(A)).max())
    if radius >= 1.0:
        raise UserError(f"the sampled loop with these gains is not stable: a pole has the magnitude {radius:.6g}")
    states = np.eye(n, len(A))
    rows = np.vstack([states, np.hstack([V @ C, U]), ball @ np.hstack([Y @ C, X])])
    at_once = np.vstack([np.zeros((n, p)), V, ball @ Y])
    g, total = _impulse_response(A, B, rows, at_once)
    constant = rows @ np.linalg.solve(np.eye(len(A)) - A, B) + at_once
    q, variances = sensors.resolutions, sensors.deviations**2
    power = np.abs(np.fft.rfft(g, axis=0)) ** 2
    white = np.sqrt((g**2).sum(axis=0)[:n] @ (q**2 / 12.0 + variances))
    spectrum = _spectrum(power, np.fft.rfft(np.einsum("pn,knj->kpj", C, g[:, :n]), axis=0), q, variances)
    means = np.einsum("wij,wj->i", power * _weights(len(g))[:, None, None], spectrum) + constant**2 @ (q**2 / 12.0)
    bounds = (total + np.abs(constant)) @ (q / 2.0)  # of counting; noise has no bound
    bounds = np.where(total @ sensors.deviations > 0.0, np.inf, bounds)
    return Residual(
        white=white,
        rms=np.sqrt(means[:n]),
        bound=bounds[:n],
        input_rms=np.sqrt(means[n : n + m]),
        input_bound=bounds[n : n + m],
        norm_rms=float(np.sqrt(means[n + m :].sum())),
        norm_bound=float(np.linalg.norm(bounds[n + m :])),
        limited=bool((bounds[n : n + m] > room).any()),
        radius=radius,
    )


def _impulse_response(A: Array, B: Array, rows: Array, at_once: Array) -> tuple[Array, Array]:
    """Return g (N, k, p), g(0) = `at_once`, g(i) = rows A^(i-1) B, and the sums of |g| with a bound of what follows.

    N is a power of 2 beyond which the rest is below LEFT_OUT of the sum, or the largest allowed. The rest is bounded by the
    sums of its modes' sizes.
    """
    values, vectors = np.linalg.eig(A)
    left, right = np.abs(rows @ vectors), np.abs(np.linalg.solve(vectors, B))
    sizes, most = np.abs(values), min(LONGEST, LARGEST // at_once.size)
    states, power = B[None], A  # A^0 B, ..., A^(N-1) B and A^N
    while True:
        g = np.concatenate([at_once[None], np.einsum("ij,kjp->kip", rows, states[:-1])])
        rest = (left * (sizes ** (len(g) - 1) / (1.0 - sizes))) @ right
        total = np.abs(g).sum(axis=0)
        if 2 * len(g) > most or (rest <= LEFT_OUT * np.maximum(total, total.max(axis=1, keepdims=True))).all():
            return g, total + rest
        states = np.concatenate([states, np.einsum("ij,kjp->kip", power, states)])
        power = power @ power


def _weights(N: int) -> Array:
    """Return what each frequency of `rfft` counts in a mean square: by Parseval's theorem 1/N, those between twice."""
    weights = np.full(N // 2 + 1, 2.0 / N)
    weights[0] = 1.0 / N
    weights[-1] = 1.0 / N if N % 2 == 0 and N > 1 else weights[-1]
    return weights


def _spectrum(power: Array, outputs: Array, q: Array, variances: Array) -> Array:
    """Return the spectrum (N/2 + 1, p) of the sensors' errors, noise and moving part s, that fits the motion they cause.

    `power` gives N; `outputs` (N/2 + 1, p, p) is the response of the measured outputs to the errors.
    """
    N = max(2 * (len(power) - 1), 1)
    gains = np.abs(outputs) ** 2
    counted = np.where(q > 0.0, q, 1.0)
    errors = np.zeros((N, len(q)))
    errors[0] = q**2 / 12.0
    apart = np.ones((N, 1))  # noise is new in each sample
    apart[0] = 0.0
    spectrum, last = np.zeros((N // 2 + 1, len(q))), 0.0
    for _ in range(ROUNDS):
        spectrum = np.maximum(np.fft.rfft(errors, axis=0).real, 0.0) + variances
        motion = np.fft.irfft(np.einsum("wij,wj->wi", gains, spectrum), n=N, axis=0)
        moved = np.sqrt(np.maximum(2.0 * (motion[0] - motion), 0.0) + 2.0 * variances * apart)
        errors = 0.5 * (errors + q**2 * counting_correlation(moved / counted))
        size = float(motion[0].sum())
        if abs(size - last) <= CONVERGED * size:
            break
        last = size
    return spectrum


def counting_correlation(moved: Array) -> Array:
    """Return the correlation, in squared counts, of a counter's errors between two instants; 1/12 is their variance.

    The displacement between them is Gaussian with the deviation `moved` in counts, the place inside a count uniform. It is
    half the mean of B_2({x}) = x^2 - x + 1/6, Bernoulli's polynomial, and for larger displacements its Fourier series.
    """
    near = 0.5 * (moved**2 - np.sqrt(2.0 / np.pi) * moved + 1.0 / 6.0)
    far = sum(np.exp(-2.0 * (np.pi * i * moved) ** 2) / (2.0 * (np.pi * i) ** 2) for i in range(1, HARMONICS + 1))
    return np.where(moved < CLOSE, near, far)
