/* The implicit homogeneous law of any linear model in block coordinates, one sample at a time: the norm, the gains,
 * both discretizations. Included by the units built on it, and compiled for each anew.
 *
 *     z = T x,  z_i' = N_i z_{i+1} (i < k),  z_k' = B_k (u - K_0 x);  coordinate j has the exponent e_j, the number of
 *     blocks behind its own;  r = ||x||_d, eq. (12);  s = r^-mu
 *     u = K_0 x + g z,  g_ij = Kz_ij s^(e_j + 1),  Kz = (K - K_0) T^-1          eq. (8), Remark 5
 *
 * Matrices are packed by rows for the sizes that a design has. A unit defines before it includes this header
 *     HOMOGENEOUS_ORDER         the order n, for a chain; the most states that a design has
 *     HOMOGENEOUS_INPUTS        the number m of inputs, 1 for a chain; the most inputs that a design has
 *     HOMOGENEOUS_CHAIN         1: n blocks of one coordinate, one input; 0: any blocks, the sizes are in the design
 * and includes its generated constants, of which those of `native_core.py` are used here.
 *
 * Pure functions of their arguments: no allocation, no globals, no input or output, every loop bounded. The order of
 * operations is that of the Python twin, `homogeneity.py` and `laws.py`.
 */
#ifndef HOMOGENEOUS_H
#define HOMOGENEOUS_H

#include <float.h>
#include <math.h>
#include <stdlib.h>

enum {
    BLOCK_ORDER = HOMOGENEOUS_ORDER,
    BLOCK_INPUTS = HOMOGENEOUS_INPUTS,
    BLOCK_SQUARE = BLOCK_ORDER * BLOCK_ORDER,
    BLOCK_GAINS = BLOCK_INPUTS * BLOCK_ORDER,
    COEFFICIENTS = 2 * BLOCK_ORDER - 1
};

/* A design, prepared for the laws; filled by its user up to Pz, for which P is given, and by prepare_block_design from
 * there. */
typedef struct {
    int n, m;                   /* states, inputs; not used for a chain */
    int exponents[BLOCK_ORDER]; /* e_j, falling from block to block by 1 to 0; not used for a chain */
    double T[BLOCK_SQUARE];     /* (n, n) */
    double N[BLOCK_SQUARE];     /* (n, n), the superdiagonal blocks N_i */
    double B[BLOCK_GAINS];      /* (n, m), B_k in the last rows */
    double K[BLOCK_GAINS];      /* (m, n), the linear gain u = K x */
    double K_0[BLOCK_GAINS];    /* (m, n) */
    double mu;                  /* minus the degree of homogeneity [1] */
    double Pz[BLOCK_SQUARE];    /* (n, n), T^-T P T^-1 of the unit ball x' P x <= 1; P until prepared */
    double Kz[BLOCK_GAINS];     /* (m, n), (K - K_0) T^-1 */
    double K_0z[BLOCK_GAINS];   /* (m, n), K_0 T^-1 */
} block_design;

/* c_0 ... c_{2e} of Remark 5's polynomial for the state d(-exponent ln 2) z, e = e_1. */
typedef struct {
    double c[COEFFICIENTS];
    int exponent; /* 0 unless a block coordinate is far from 1: squares leave the range of numbers before states do */
} norm_polynomial;

/* A state as the norm and the law take it: x = 2^-shift times the state, z = T x. */
typedef struct {
    int shift;
    double x[BLOCK_ORDER], z[BLOCK_ORDER];
    norm_polynomial polynomial;
} block_state;

/* How the norm in the law is found: the exact norm limited to [a_min, b_max], or Algorithm 1. */
typedef struct {
    int exact;
    double a_min, b_max;
    int j_max;
} norm_search;

static inline int states_of(const block_design *d)
{
    return HOMOGENEOUS_CHAIN ? BLOCK_ORDER : d->n;
}

static inline int inputs_of(const block_design *d)
{
    return HOMOGENEOUS_CHAIN ? 1 : d->m;
}

static inline int exponent_of(const block_design *d, int j)
{
    return HOMOGENEOUS_CHAIN ? BLOCK_ORDER - 1 - j : d->exponents[j];
}

static inline int coefficients_of(const block_design *d)
{
    return 2 * exponent_of(d, 0) + 1;
}

/* ---- Numbers ----------------------------------------------------------------------------------------------------- */

static inline double clamp(double value, double low, double high)
{
    const double above = value > low ? value : low;
    return above < high ? above : high;
}

/* The value, 0 where it is smaller than `least`: on subnormal numbers processors are many times slower. */
static inline double flushed(double value, double least)
{
    return fabs(value) > 0.0 && fabs(value) < least ? 0.0 : value;
}

/* The innovation e of a Kalman filter, of which what is within half a count has a weight of its own. */
static inline double weighed(double e, double count, double weight)
{
    const double half = 0.5 * count;
    const double within = e > half ? half : e < -half ? -half : e;
    return e - (1.0 - weight) * within;
}

/* The value, of which the compiler knows nothing: it then computes no function or quotient before the argument has been
 * found admissible, which it else does, to discard the result. A host may have unmasked floating-point exceptions. */
static inline double opaque(double value)
{
    volatile const double same = value;
    return same;
}

static inline double dot(const double *a, const double *b, int n)
{
    double sum = 0.0;
    for (int i = 0; i < n; i++) {
        sum += a[i] * b[i];
    }
    return sum;
}

/* a' b for the column b that begins at `b`, of a matrix with rows of `stride` entries. */
static inline double dot_column(const double *a, const double *b, int n, int stride)
{
    double sum = 0.0;
    for (int i = 0; i < n; i++) {
        sum += a[i] * b[i * stride];
    }
    return sum;
}

static inline int all_finite(const double *values, int count)
{
    int finite = 1;
    for (int i = 0; i < count; i++) {
        finite = finite && isfinite(values[i]);
    }
    return finite;
}

static inline double high_digits(double a)
{
    const double t = SPLIT * a;
    return t - (t - a);
}

/* The error of the rounded product a b, exactly. */
static inline double product_error(double a, double b, double product)
{
    const double a_high = high_digits(a), b_high = high_digits(b);
    const double a_low = a - a_high, b_low = b - b_high;
    return a_low * b_low - (((product - a_high * b_high) - a_low * b_high) - a_high * b_low);
}

/* a' b to full precision although its terms cancel: near an axis of the dilation block coordinates are far smaller than
 * their terms, and the norm magnifies them. Dot2 of Ogita, Rump and Oishi (2005); rounding as written, without fused
 * operations. */
static inline double exact_dot(const double *a, const double *b, int n)
{
    double total = 0.0, size = 0.0, rest = 0.0;
    for (int i = 0; i < n; i++) {
        const double term = a[i] * b[i];
        total += term;
        size += fabs(term);
    }
    if (!(CANCELLED * size > fabs(total)) || size > MOST_EXACT) {
        return total;
    }
    total = 0.0;
    for (int i = 0; i < n; i++) {
        const double term = a[i] * b[i];
        const double error = product_error(a[i], b[i], term);
        const double after = total + term, part = after - total;
        rest += ((total - (after - part)) + (term - part)) + error;
        total = after;
    }
    return total + rest;
}

/* Solve M X = B in place of B (n, columns) by Gaussian elimination with partial pivoting; 0: M (n, n) is singular. */
static inline int solve(double *M, double *B, int n, int columns)
{
    for (int k = 0; k < n; k++) {
        int pivot = k;
        for (int i = k + 1; i < n; i++) {
            if (fabs(M[i * n + k]) > fabs(M[pivot * n + k])) {
                pivot = i;
            }
        }
        for (int j = 0; j < n; j++) {
            const double entry = M[k * n + j];
            M[k * n + j] = M[pivot * n + j];
            M[pivot * n + j] = entry;
        }
        for (int j = 0; j < columns; j++) {
            const double entry = B[k * columns + j];
            B[k * columns + j] = B[pivot * columns + j];
            B[pivot * columns + j] = entry;
        }
        const double head = M[k * n + k];
        if (head == 0.0 || !isfinite(head)) {
            return 0;
        }
        for (int i = k + 1; i < n; i++) {
            const double factor = M[i * n + k] / head;
            for (int j = k; j < n; j++) {
                M[i * n + j] -= factor * M[k * n + j];
            }
            for (int j = 0; j < columns; j++) {
                B[i * columns + j] -= factor * B[k * columns + j];
            }
        }
    }
    for (int k = n - 1; k >= 0; k--) {
        for (int j = 0; j < columns; j++) {
            double rest = 0.0;
            for (int i = k + 1; i < n; i++) {
                rest += M[k * n + i] * B[i * columns + j];
            }
            B[k * columns + j] = (B[k * columns + j] - rest) / M[k * n + k];
        }
    }
    return 1;
}

/* ---- Preparation ------------------------------------------------------------------------------------------------- */

/* The size of the first leading block of P (n, n), given by the rows of its upper triangle, that is not positive
 * definite; 0 where none is. */
static inline int indefinite_block(const double *upper, int n)
{
    double P[BLOCK_SQUARE];
    int entry = 0;
    for (int i = 0; i < n; i++) {
        for (int j = i; j < n; j++) {
            P[i * n + j] = P[j * n + i] = upper[entry++];
        }
    }
    for (int k = 0; k < n; k++) {
        if (!(P[k * n + k] > 0.0)) {
            return k + 1;
        }
        for (int i = k + 1; i < n; i++) {
            const double factor = P[i * n + k] / P[k * n + k];
            for (int j = k; j < n; j++) {
                P[i * n + j] -= factor * P[k * n + j];
            }
        }
    }
    return 0;
}

/* B <- T^-T B. */
static inline int solve_transposed(const double *T, double *B, int n, int columns)
{
    double T_t[BLOCK_SQUARE];
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < n; j++) {
            T_t[i * n + j] = T[j * n + i];
        }
    }
    return solve(T_t, B, n, columns);
}

/* found <- K_0 T^-1 by iterative refinement, for one row: entries that should be 0 would otherwise outweigh fading
 * gains. */
static inline void refine(const double *T, const double *row, double *found, int n)
{
    for (int k = 0; k < REFINEMENTS; k++) {
        double residual[BLOCK_ORDER];
        for (int i = 0; i < n; i++) {
            residual[i] = row[i] - dot_column(found, &T[i], n, n);
        }
        solve_transposed(T, residual, n, 1);
        for (int i = 0; i < n; i++) {
            found[i] += residual[i];
        }
    }
}

/* Kz and K_0z; 0 where T is singular. */
static inline int prepare_gains(block_design *d)
{
    const int n = states_of(d), m = inputs_of(d);
    double columns[BLOCK_ORDER * 2 * BLOCK_INPUTS];
    for (int j = 0; j < n; j++) {
        for (int i = 0; i < m; i++) {
            columns[j * 2 * m + i] = d->K[i * n + j] - d->K_0[i * n + j];
            columns[j * 2 * m + m + i] = d->K_0[i * n + j];
        }
    }
    if (!solve_transposed(d->T, columns, n, 2 * m)) {
        return 0;
    }
    for (int i = 0; i < m; i++) {
        for (int j = 0; j < n; j++) {
            d->Kz[i * n + j] = columns[j * 2 * m + i];
            d->K_0z[i * n + j] = columns[j * 2 * m + m + i];
        }
        refine(d->T, &d->K_0[i * n], &d->K_0z[i * n], n);
    }
    return 1;
}

/* What follows from the rest of the design; 0 where T is singular. */
static inline int prepare_block_design(block_design *d)
{
    const int n = states_of(d);
    if (!prepare_gains(d) || !solve_transposed(d->T, d->Pz, n, n)) {
        return 0;
    }
    for (int i = 0; i < n; i++) {
        for (int j = i + 1; j < n; j++) {
            const double entry = d->Pz[i * n + j];
            d->Pz[i * n + j] = d->Pz[j * n + i];
            d->Pz[j * n + i] = entry;
        }
    }
    return solve_transposed(d->T, d->Pz, n, n);
}

static inline int block_design_is_finite(const block_design *d)
{
    const int n = states_of(d), m = inputs_of(d);
    return all_finite(d->Kz, m * n) && all_finite(d->K_0z, m * n) && all_finite(d->Pz, n * n);
}

/* ---- Canonical homogeneous norm ---------------------------------------------------------------------------------- */

/* floor(x/4 + 1/2) as a whole number, for an x of moderate size. */
static inline int nearest_fourth(double x)
{
    return (int)floor(clamp(x, -1e6, 1e6) / 4.0 + 0.5);
}

/* d(-e ln 2) 2^shift z and e, a multiple of 4 near the binary logarithm of the norm; a state not finite stays. */
static inline int scale(const block_design *d, const double *z, int shift, double *scaled)
{
    const int n = states_of(d);
    double largest = -INFINITY;
    int finite = 1, e = 0;
    for (int i = 0; i < n; i++) {
        int of_z = 0, of_P = 0;
        scaled[i] = z[i];
        finite = finite && isfinite(z[i]);
        if (finite && z[i] != 0.0) {
            frexp(z[i], &of_z);
            frexp(d->Pz[i * n + i], &of_P);
            largest = fmax(largest, (of_z + shift + 0.5 * of_P) / (1.0 + d->mu * exponent_of(d, i)));
        }
    }
    if (!finite || largest == -INFINITY) {
        return 0;
    }
    e = 4 * nearest_fourth(largest);
    for (int i = 0; i < n; i++) {
        const double power = shift - e * (1.0 + d->mu * exponent_of(d, i));
        const double whole = floor(power);
        const double entry = ldexp(z[i] * pow(2.0, power - whole), (int)clamp(whole, -1e6, 1e6));
        scaled[i] = fabs(entry) >= NEGLIGIBLE ? entry : 0.0;
    }
    return e;
}

static inline int is_ordinary(const double *z, int n)
{
    for (int i = 0; i < n; i++) {
        if (z[i] != 0.0 && !(fabs(z[i]) >= LEAST_ORDINARY && fabs(z[i]) <= MOST_ORDINARY)) {
            return 0;
        }
    }
    return 1;
}

/* The polynomial of the state 2^shift z. */
static inline void make_polynomial(const block_design *d, const double *z, int shift, norm_polynomial *p)
{
    const int n = states_of(d);
    double scaled[BLOCK_ORDER];
    p->exponent = 0;
    if (shift != 0 || !is_ordinary(z, n)) {
        p->exponent = scale(d, z, shift, scaled);
        z = scaled;
    }
    for (int m = 0; m < coefficients_of(d); m++) {
        p->c[m] = 0.0;
    }
    for (int i = 0; i < n; i++) {
        const double *row = &d->Pz[i * n];
        const int e_i = exponent_of(d, i);
        p->c[2 * e_i] += row[i] * z[i] * z[i];
        for (int j = i + 1; j < n; j++) {
            p->c[e_i + exponent_of(d, j)] += 2.0 * row[j] * z[i] * z[j];
        }
    }
}

/* s = r^-mu; the division where it is one is faster and exact. */
static inline double inverse_power(double r, double mu)
{
    return mu == 1.0 ? 1.0 / r : pow(r, -mu);
}

/* Binary order of magnitude of a positive number: value = m 2^order, 0.5 <= m < 1. */
static inline int order_of(double value)
{
    int order = 0;
    frexp(value, &order);
    return order;
}

/* N^2(r) = r^-2 sum c_m s^m; 0 or infinite far from the norm of a scaled state. */
static inline double squared_norm(const block_design *d, const norm_polynomial *p, double r)
{
    if (p->exponent != 0) {
        const int distance = order_of(r) - p->exponent;
        if (distance > FAR_APART || distance < -FAR_APART) {
            return distance > 0 ? 0.0 : INFINITY;
        }
        r = ldexp(r, -p->exponent);
    }
    const double s = inverse_power(r, d->mu);
    double total = 0.0;
    for (int m = coefficients_of(d) - 1; m >= 0; m--) {
        total = total * s + p->c[m];
    }
    return total / (r * r);
}

/* y' P y / (y' P G_d y), y = d(-ln r) x: sum c_m s^m / sum (1 + mu m/2) c_m s^m; 1 where r is far from the norm. */
static inline double radial_quotient(const block_design *d, const norm_polynomial *p, double r)
{
    if (p->exponent != 0) {
        const int distance = order_of(r) - p->exponent;
        if (distance > FAR_APART || distance < -FAR_APART) {
            return 1.0;
        }
        r = ldexp(r, -p->exponent);
    }
    const double s = inverse_power(r, d->mu);
    double total = 0.0, weighted = 0.0;
    for (int m = coefficients_of(d) - 1; m >= 0; m--) {
        total = total * s + p->c[m];
        weighted = weighted * s + (1.0 + 0.5 * d->mu * m) * p->c[m];
    }
    return weighted > 0.0 && weighted < INFINITY ? total / weighted : 1.0;
}

/* The start of the search in the coordinates of the polynomial; 1 where the guess is of no use. */
static inline double scaled_guess(double guess, int exponent)
{
    if (exponent != 0) {
        const int near = guess > 0.0 && guess < INFINITY && abs(order_of(guess) - exponent) < FAR_APART;
        guess = near ? ldexp(guess, -exponent) : 1.0;
    }
    return guess > LEAST_GUESS && guess < LARGEST_GUESS ? guess : 1.0;
}

/* The root sigma of ln N(e^sigma) = 0, as e^sigma. */
static inline double root_of(const block_design *d, const double *c, double guess)
{
    const double mu = d->mu;
    double low = -UNBOUNDED, high = UNBOUNDED, last = UNBOUNDED;
    double sigma = log(opaque(guess));
    for (int k = 0; k < NEWTON_LIMIT; k++) {
        const double s = exp(-mu * sigma);
        double value = c[coefficients_of(d) - 1], weighted = 0.0;
        for (int m = coefficients_of(d) - 2; m >= 0; m--) {
            weighted = weighted * s + value;
            value = value * s + c[m];
        }
        if (!(value > 0.0 && value < INFINITY)) {
            return NAN;
        }
        const double error = log(opaque(value)) - 2.0 * sigma;
        if (error > 0.0) {
            low = sigma;
        } else {
            high = sigma;
        }
        const double slope = 2.0 + mu * s * weighted / value;
        const double step = slope > 0.0 ? error / opaque(slope > 0.0 ? slope : 1.0) : UNBOUNDED;
        if (fabs(step) <= CONVERGED) {
            return exp(sigma + step);
        }
        double following = sigma + clamp(step, -4.0, 4.0);
        if (low > -UNBOUNDED && high < UNBOUNDED
            && !(low < following && following < high && fabs(following - sigma) <= 0.5 * last)) {
            following = 0.5 * (low + high);
        }
        last = fabs(following - sigma);
        if (last <= 1e-15 * fmax(1.0, fabs(sigma))) {
            return exp(following);
        }
        sigma = following;
    }
    return exp(sigma);
}

/* The root of N(r) = 1 by a bracketed Newton method of at most NEWTON_LIMIT iterations. */
static inline double homogeneous_norm(const block_design *d, const norm_polynomial *p, double guess)
{
    double size = 0.0;
    for (int m = 0; m < coefficients_of(d); m++) {
        if (!isfinite(p->c[m])) {
            return NAN;
        }
        size = fabs(p->c[m]) > size ? fabs(p->c[m]) : size;
    }
    if (size == 0.0) {
        return 0.0;
    }
    const double root = root_of(d, p->c, scaled_guess(guess, p->exponent));
    if (p->exponent == 0 || isnan(root)) {
        return root;
    }
    return order_of(root) + p->exponent > DBL_MAX_EXP ? DBL_MAX : ldexp(root, p->exponent);
}

/* One run of Algorithm 1 (corrected) on the interval [a, b]; j_max + 2 evaluations of the polynomial at most. */
static inline void bisection_update(const block_design *d, const norm_polynomial *p, double interval[2], double a_min,
                                    double b_max, int j_max)
{
    double a = interval[0], b = interval[1];
    if (squared_norm(d, p, b) > 1.0) {
        a = b;
        b = fmin(2.0 * b, b_max);
    } else if (squared_norm(d, p, a) < 1.0) {
        b = a;
        a = fmax(a / 2.0, a_min);
    } else {
        for (int j = 0; j < j_max && j < MOST_BISECTIONS; j++) {
            const double middle = (a + b) / 2.0;
            if (squared_norm(d, p, middle) < 1.0) {
                b = middle;
            } else {
                a = middle;
            }
        }
    }
    interval[0] = a;
    interval[1] = b;
}

/* r in the law, given the exact norm; the interval is brought within bounds that may have been tuned since. */
static inline double norm_in_law(const block_design *d, const norm_search *search, const norm_polynomial *p,
                                 double norm, double interval[2])
{
    if (search->exact) {
        return isnan(norm) ? norm : clamp(norm, search->a_min, search->b_max);
    }
    interval[0] = clamp(interval[0], search->a_min, search->b_max);
    interval[1] = clamp(interval[1], search->a_min, search->b_max);
    bisection_update(d, p, interval, search->a_min, search->b_max, search->j_max);
    return interval[1];
}

/* ---- Laws -------------------------------------------------------------------------------------------------------- */

static inline int shift_of(const double *x, int n)
{
    double size = 0.0;
    for (int i = 0; i < n; i++) {
        size = fmax(size, fabs(x[i]));
    }
    return size > LARGE ? SHIFT : size > 0.0 && size < SMALL ? -SHIFT : 0;
}

/* z = T x and the polynomial for the state x. */
static inline void make_block_state(const block_design *d, const double *x, block_state *state)
{
    const int n = states_of(d);
    state->shift = shift_of(x, n);
    const double factor = state->shift == 0 ? 1.0 : state->shift > 0 ? SMALL : LARGE;
    for (int i = 0; i < n; i++) {
        state->x[i] = x[i] * factor;
    }
    for (int i = 0; i < n; i++) {
        state->z[i] = exact_dot(&d->T[i * n], state->x, n);
    }
    make_polynomial(d, state->z, state->shift, &state->polynomial);
}

/* g = Kz_ij s^(e_j + 1), s = r^-mu. */
static inline void make_gains(const block_design *d, const double *Kz, double r, double *g)
{
    const int n = states_of(d), m = inputs_of(d);
    const double s = inverse_power(r, d->mu);
    double power = s;
    for (int j = n - 1; j >= 0; j--) {
        if (j < n - 1 && exponent_of(d, j) != exponent_of(d, j + 1)) {
            power *= s;
        }
        for (int i = 0; i < m; i++) {
            g[i * n + j] = Kz[i * n + j] * power;
        }
    }
}

/* u = K_0 x + g z, for r <= 1 as K x + (g - Kz) z: beyond, the gains fade, and K x would cancel. */
static inline void explicit_law(const block_design *d, double r, const block_state *state, double *u)
{
    const int n = states_of(d), m = inputs_of(d);
    double g[BLOCK_GAINS];
    make_gains(d, d->Kz, r, g);
    for (int i = 0; i < m; i++) {
        if (r > 1.0) {
            u[i] = dot(&g[i * n], state->z, n) + dot(&d->K_0[i * n], state->x, n);
        } else {
            double change = 0.0;
            for (int j = 0; j < n; j++) {
                change += (g[i * n + j] - d->Kz[i * n + j]) * state->z[j];
            }
            u[i] = dot(&d->K[i * n], state->x, n) + change;
        }
    }
}

/* f (n) and H (n, m): z at the next sample is f + H v under v = u - K_0 x; f_i = z_i + h N_i f_{i+1}, H_i = h N_i
 * H_{i+1}. */
static inline void look_ahead(const block_design *d, double h, const double *z, double *f, double *H)
{
    const int n = states_of(d), m = inputs_of(d);
    int begin = n, end = n; /* of the block behind that of coordinate i */
    for (int i = n - 1; i >= 0; i--) {
        if (exponent_of(d, i) == 0) {
            f[i] = z[i];
            for (int j = 0; j < m; j++) {
                H[i * m + j] = h * d->B[i * m + j];
            }
            continue;
        }
        if (HOMOGENEOUS_CHAIN || exponent_of(d, i) != exponent_of(d, i + 1)) {
            end = HOMOGENEOUS_CHAIN ? i + 2 : begin; /* which a compiler sees through */
            begin = i + 1;
        }
        const double *links = &d->N[i * n + begin];
        f[i] = z[i] + h * dot(links, &f[begin], end - begin);
        for (int j = 0; j < m; j++) {
            H[i * m + j] = h * dot_column(links, &H[begin * m + j], end - begin, m);
        }
    }
}

/* v = (I - g H)^-1 g f; NAN where I - g H is singular. */
static inline void solve_ahead(const block_design *d, const double *g, const double *f, const double *H, double *v)
{
    const int n = states_of(d), m = inputs_of(d);
    double M[BLOCK_INPUTS * BLOCK_INPUTS];
    for (int i = 0; i < m; i++) {
        v[i] = dot(&g[i * n], f, n);
        for (int j = 0; j < m; j++) {
            M[i * m + j] = (i == j ? 1.0 : 0.0) - dot_column(&g[i * n], &H[j], n, m);
        }
    }
    if (m == 1) {
        v[0] = v[0] / M[0];
    } else if (!solve(M, v, m, 1)) {
        v[0] = NAN;
    }
}

/* u = K_r (I - h (A + B K_r))^-1 x = v + K_0z (f + H v), K_r the gain of the explicit law. */
static inline void semi_implicit_law(const block_design *d, double r, double h, const block_state *state, double *u)
{
    const int n = states_of(d), m = inputs_of(d);
    double g[BLOCK_GAINS], f[BLOCK_ORDER], H[BLOCK_GAINS], v[BLOCK_INPUTS];
    make_gains(d, d->Kz, r, g);
    look_ahead(d, h, state->z, f, H);
    solve_ahead(d, g, f, H, v);
    for (int i = 0; i < n; i++) {
        f[i] += dot(&H[i * m], v, m);
    }
    for (int i = 0; i < m; i++) {
        u[i] = v[i] + dot(&d->K_0z[i * n], f, n);
    }
}

/* 2^shift times a value computed of a state taken 2^-shift times, bounded so that none overflows; NaN for NaN. */
static inline double unshifted(double value, int shift)
{
    return shift == 0 || isnan(value) ? value : clamp(value, -MOST, MOST) * (shift > 0 ? LARGE : SMALL);
}

/*
 * v' = q r^(1-2 mu) K_i d(-ln r) x of the integral action, Kiz = K_i T^-1: q s sum of Kiz_ij s^(e_j + 1) z_j. q is the
 * radial quotient where r is the norm of x (`is_free`); 1 where r is a limit in its place or the law is linear.
 */
static inline void integrand(const block_design *d, const double *Kiz, double r, const block_state *state, int is_free,
                             double *rates)
{
    const int n = states_of(d);
    double s = inverse_power(r, d->mu);
    if (is_free) {
        s *= radial_quotient(d, &state->polynomial, r);
    }
    double g[BLOCK_GAINS];
    make_gains(d, Kiz, r, g);
    for (int i = 0; i < inputs_of(d); i++) {
        rates[i] = unshifted(s * dot(&g[i * n], state->z, n), state->shift);
    }
}

/* The IHC's inputs for the norm r in the law, semi-implicit for the sample time h [s], explicit for 0. */
static inline void homogeneous_law(const block_design *d, double r, double h, const block_state *state, double *u)
{
    if (h > 0.0) {
        semi_implicit_law(d, r, h, state, u);
    } else {
        explicit_law(d, r, state, u);
    }
    for (int i = 0; i < inputs_of(d); i++) {
        u[i] = unshifted(u[i], state->shift);
    }
}

/* ---- Super-twisting ---------------------------------------------------------------------------------------------- */

/* w = -k_1 |s|^(1/2) sign(s) + v, v' = -k_2 sign(s), k_1 = 1.5 sqrt(rate), k_2 = 1.1 rate, by Euler's method for
 * samples of h, explicit, or implicit with a linear sign where |s| < 4 h^2 k_2; returns w, and the next v in `moved`.
 */
static inline double super_twisting(double s, double v, double rate, double h, int implicit, double *moved)
{
    const double k_1 = STA_PROPORTIONAL * sqrt(rate), turn = h * (STA_INTEGRAL * rate);
    const double size = fabs(s);
    double root = sqrt(size), change = turn;
    if (implicit) {
        const double half = 0.5 * (h * k_1);
        root = size > 0.0 ? size / opaque(half + sqrt(half * half + size)) : 0.0;
        change = size >= 4.0 * (h * turn) ? turn : size / (4.0 * h);
    }
    *moved = s > 0.0 ? v - change : s < 0.0 ? v + change : v;
    return s > 0.0 ? v - k_1 * root : v + k_1 * root;
}

/* Whether a change of an input's integral would push the wanted input farther beyond its limits. */
static inline int winds_up(double wanted, double change, double low, double high)
{
    return (wanted > high && change > 0.0) || (wanted < low && change < 0.0);
}

#endif
