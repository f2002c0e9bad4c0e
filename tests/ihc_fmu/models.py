"""Linear models that the designs are tested with."""

import numpy as np

from ihc_fmu.companion import chain_form
from ihc_fmu.system import System


def system(A, b, k_lin=None):
    return System(A=np.array(A, float), B=np.array(b, float), K=None if k_lin is None else np.array(k_lin, float))


def butterworth(n):
    """Return kz that places the poles of a chain of n integrators on the left half circle of 3 1/s."""
    return -np.poly(3 * np.exp(1j * np.pi * (2 * np.arange(1, n + 1) + n - 1) / (2 * n))).real[:0:-1]


def integrator_chain(n):
    return np.eye(n, k=1), np.eye(n)[-1], butterworth(n)


def random_system(n):
    rng = np.random.default_rng(n)
    A, b = rng.normal(size=(n, n)), rng.normal(size=n)
    form = chain_form(A, b)
    return A, b, butterworth(n) @ form.Phi - form.row
