#include "linear_exponential.h"

#include <math.h>

typedef double square[LINEAR_STATES][LINEAR_STATES];

/* The sum of magnitudes of n numbers `stride` apart, without the entry of index `without`. */
static double sum_of(const double *first, int stride, int n, int without)
{
    double total = 0.0;
    for (int j = 0; j < n; j++) {
        if (j != without) {
            total += fabs(first[j * stride]);
        }
    }
    return total;
}

static int rows_are_finite(const double *first, int columns, int n, int m)
{
    int finite = 1;
    for (int i = 0; i < n; i++) {
        finite = finite && isfinite(sum_of(first + i * columns, 1, m, -1));
    }
    return finite;
}

/* Binary exponent of a positive number. */
static int exponent_of(double value)
{
    int exponent;
    frexp(value, &exponent);
    return exponent;
}

/* Scale X to D^-1 X D, D = diag(2^exponents), so that rows and columns are of like size, or below 1. */
static void balance(square X, int n, int exponents[LINEAR_STATES])
{
    int moved = 1;
    for (int i = 0; i < n; i++) {
        exponents[i] = 0;
    }
    for (int sweep = 0; sweep < LINEAR_BALANCING_SWEEPS && moved; sweep++) {
        moved = 0;
        for (int i = 0; i < n; i++) {
            const double row = fmax(1.0, sum_of(X[i], 1, n, i));
            const double column = fmax(1.0, sum_of(&X[0][i], LINEAR_STATES, n, i));
            const int shift = (exponent_of(row) - exponent_of(column)) / 2;
            if (shift != 0) {
                moved = 1;
                exponents[i] += shift;
                for (int j = 0; j < n; j++) {
                    if (j != i) {
                        X[i][j] = ldexp(X[i][j], -shift);
                        X[j][i] = ldexp(X[j][i], shift);
                    }
                }
            }
        }
    }
}

/* M becomes D M D^-1, D = diag(2^exponents). */
static void rescale(square M, int n, const int exponents[LINEAR_STATES])
{
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < n; j++) {
            M[i][j] = ldexp(M[i][j], exponents[i] - exponents[j]);
        }
    }
}

/* made = M N, each entry added from the first to the last term. */
static void multiply(square M, square N, int n, square made)
{
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < n; j++) {
            made[i][j] = 0.0;
        }
        for (int k = 0; k < n; k++) {
            for (int j = 0; j < n; j++) {
                made[i][j] += M[i][k] * N[k][j];
            }
        }
    }
}

/* The Taylor polynomial I + X/2 (I + X/3 (...)) of phi(X), for |X| <= 1/2. */
static void polynomial(square X, int n, square phi)
{
    square term;
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < n; j++) {
            phi[i][j] = i == j ? 1.0 : 0.0;
        }
    }
    for (int k = LINEAR_DEGREE + 1; k > 1; k--) {
        multiply(X, phi, n, term);
        for (int i = 0; i < n; i++) {
            for (int j = 0; j < n; j++) {
                phi[i][j] = (i == j ? 1.0 : 0.0) + term[i][j] / k;
            }
        }
    }
}

/* E = e^X - I and phi(X) from those of X 2^-doublings; X is overwritten. */
static void exponential(square X, int n, int doublings, square E, square phi)
{
    square product;
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < n; j++) {
            X[i][j] = ldexp(X[i][j], -doublings);
        }
    }
    polynomial(X, n, phi);
    multiply(X, phi, n, E);
    for (int count = 0; count < doublings; count++) {
        multiply(E, phi, n, product);
        for (int i = 0; i < n; i++) {
            for (int j = 0; j < n; j++) {
                phi[i][j] = phi[i][j] + 0.5 * product[i][j];
            }
        }
        multiply(E, E, n, product);
        for (int i = 0; i < n; i++) {
            for (int j = 0; j < n; j++) {
                E[i][j] = 2.0 * E[i][j] + product[i][j];
            }
        }
    }
}

/* G = h phi B */
static void integrate(square phi, const double B[LINEAR_STATES][LINEAR_INPUTS], int n, int m, double h,
                      double G[LINEAR_STATES][LINEAR_INPUTS])
{
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < m; j++) {
            double total = 0.0;
            for (int k = 0; k < n; k++) {
                total += phi[i][k] * B[k][j];
            }
            G[i][j] = h * total;
        }
    }
}

int linear_hold_inputs(const double A[LINEAR_STATES][LINEAR_STATES], const double B[LINEAR_STATES][LINEAR_INPUTS],
                       int n, int m, double h, linear_held *held)
{
    square X = {{0.0}}, phi = {{0.0}};
    int exponents[LINEAR_STATES];
    double largest = 0.0;
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < n; j++) {
            X[i][j] = A[i][j] * h;
        }
    }
    if (!rows_are_finite(X[0], LINEAR_STATES, n, n)) {
        return 0;
    }
    balance(X, n, exponents);
    for (int i = 0; i < n; i++) {
        largest = fmax(largest, sum_of(X[i], 1, n, -1));
    }
    const int needed = exponent_of(largest) + 1, doublings = needed > 0 ? needed : 0;
    if (doublings > LINEAR_MOST_DOUBLINGS) {
        return 0;
    }
    exponential(X, n, doublings, held->E, phi);
    rescale(held->E, n, exponents);
    rescale(phi, n, exponents);
    integrate(phi, B, n, m, h, held->G);
    return rows_are_finite(held->E[0], LINEAR_STATES, n, n) && rows_are_finite(held->G[0], LINEAR_INPUTS, n, m);
}
