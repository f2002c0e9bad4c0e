#include "ihc_controller.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>

enum { N = IHC_ORDER };

enum {
    FAR = 100,   /* binary orders of magnitude between r and a norm beyond which N(r) is taken for 0 or infinite */
    REFINEMENTS = 3,
    SHIFT = 600  /* states beyond 2^-SHIFT or 2^SHIFT as a whole are computed with as 2^SHIFT or 2^-SHIFT times them */
};

static const double PI = 3.14159265358979323846;
static const double TURN = 2.0 * 3.14159265358979323846;
static const double LEAST_GUESS = 1e-12;   /* a guess of the norm is used between these two [1] */
static const double LARGEST_GUESS = 1e12;
static const double LEAST_ORDINARY = 0x1p-200; /* chain coordinates between these two need no scaling ... */
static const double MOST_ORDINARY = 0x1p200;
static const double NEGLIGIBLE = 0x1p-500; /* ... and this small they are nothing beside others near 1 */
static const double UNBOUNDED = 1e9;       /* stands for the logarithm of a norm that is not known yet */
static const double LEAST = 0x1p-1000;          /* smaller measurements and filtered values count as 0 ... */
static const double LEAST_ESTIMATE = 0x1p-300;  /* ... and smaller estimates of an observer */
static const double SMALL = 0x1p-600, LARGE = 0x1p600; /* 2^-SHIFT, 2^SHIFT */
static const double MOST = 0x1p400;        /* beyond any voltage limit */
static const double CONVERGED = 1e-9;      /* a Newton step so small leaves an error of its square */
static const double BIAS_DECAY = 1e-3;     /* rate at which the Kalman filter forgets the bias [1/s] */
static const double REST_VELOCITY = 0.05;  /* the pendulum counts as at rest below this [rad/s] ... */
static const double REST_COSINE = -0.999;  /* ... within this of hanging */

static double clamp(double value, double low, double high)
{
    const double above = value > low ? value : low;
    return above < high ? above : high;
}

/* The value, 0 where it is smaller than `least`: on subnormal numbers processors are many times slower. */
static double flushed(double value, double least)
{
    return fabs(value) > 0.0 && fabs(value) < least ? 0.0 : value;
}

/* The value, of which the compiler knows nothing: it then computes no function or quotient before the argument has been
 * found admissible, which it else does, to discard the result. A host may have unmasked floating-point exceptions. */
static double opaque(double value)
{
    volatile const double same = value;
    return same;
}

static double dot(const double a[N], const double b[N])
{
    double sum = 0.0;
    for (int i = 0; i < N; i++) {
        sum += a[i] * b[i];
    }
    return sum;
}

#define CANCELLED 1e-3      /* of its terms' sizes: a smaller sum is added anew in twice the precision */
#define MOST_EXACT 0x1p900  /* sum of the sizes of products up to which their factors are split */
#define SPLIT 134217729.0   /* 2^27 + 1: halves a double's digits (Dekker 1971) */

static double high_digits(double a)
{
    const double t = SPLIT * a;
    return t - (t - a);
}

/* The error of the rounded product a b, exactly. */
static double product_error(double a, double b, double product)
{
    const double a_high = high_digits(a), b_high = high_digits(b);
    const double a_low = a - a_high, b_low = b - b_high;
    return a_low * b_low - (((product - a_high * b_high) - a_low * b_high) - a_high * b_low);
}

/* a' b to full precision although its terms cancel: near an axis of the dilation chain coordinates are far smaller than
 * their terms, and the norm magnifies them. Dot2 of Ogita, Rump and Oishi (2005); rounding as written, without fused
 * operations. */
static double exact_dot(const double a[N], const double b[N])
{
    double total = 0.0, size = 0.0, rest = 0.0;
    for (int i = 0; i < N; i++) {
        const double term = a[i] * b[i];
        total += term;
        size += fabs(term);
    }
    if (!(CANCELLED * size > fabs(total)) || size > MOST_EXACT) {
        return total;
    }
    total = 0.0;
    for (int i = 0; i < N; i++) {
        const double term = a[i] * b[i];
        const double error = product_error(a[i], b[i], term);
        const double after = total + term, part = after - total;
        rest += ((total - (after - part)) + (term - part)) + error;
        total = after;
    }
    return total + rest;
}

/* ---- Canonical homogeneous norm ---------------------------------------------------------------------------------- */

/* floor(x/4 + 1/2) as a whole number, for an x of moderate size. */
static int nearest_fourth(double x)
{
    return (int)floor(clamp(x, -1e6, 1e6) / 4.0 + 0.5);
}

/* d(-e ln 2) 2^shift z and e, a multiple of 4 near the binary logarithm of the norm; a state that is not finite stays. */
static int scale(const double Pz[N][N], const double z[N], double mu, int shift, double scaled[N])
{
    double largest = -INFINITY;
    int finite = 1, e = 0;
    for (int i = 0; i < N; i++) {
        int of_z = 0, of_P = 0;
        scaled[i] = z[i];
        finite = finite && isfinite(z[i]);
        if (finite && z[i] != 0.0) {
            frexp(z[i], &of_z);
            frexp(Pz[i][i], &of_P);
            largest = fmax(largest, (of_z + shift + 0.5 * of_P) / (1.0 + mu * (N - 1 - i)));
        }
    }
    if (!finite || largest == -INFINITY) {
        return 0;
    }
    e = 4 * nearest_fourth(largest);
    for (int i = 0; i < N; i++) {
        const double power = shift - e * (1.0 + mu * (N - 1 - i));
        const double whole = floor(power);
        const double entry = ldexp(z[i] * pow(2.0, power - whole), (int)clamp(whole, -1e6, 1e6));
        scaled[i] = fabs(entry) >= NEGLIGIBLE ? entry : 0.0;
    }
    return e;
}

static int is_ordinary(const double z[N])
{
    for (int i = 0; i < N; i++) {
        if (z[i] != 0.0 && !(fabs(z[i]) >= LEAST_ORDINARY && fabs(z[i]) <= MOST_ORDINARY)) {
            return 0;
        }
    }
    return 1;
}

void ihc_norm_polynomial(const double Pz[N][N], const double z[N], double mu, int shift, ihc_polynomial *p)
{
    double scaled[N];
    p->exponent = 0;
    if (shift != 0 || !is_ordinary(z)) {
        p->exponent = scale(Pz, z, mu, shift, scaled);
        z = scaled;
    }
    for (int m = 0; m < IHC_COEFFICIENTS; m++) {
        p->c[m] = 0.0;
    }
    for (int i = 0; i < N; i++) {
        p->c[2 * (N - 1 - i)] += Pz[i][i] * z[i] * z[i];
        for (int j = i + 1; j < N; j++) {
            p->c[2 * N - 2 - i - j] += 2.0 * Pz[i][j] * z[i] * z[j];
        }
    }
}

/* s = r^-mu; the division where it is one is faster and exact. */
static double inverse_power(double r, double mu)
{
    return mu == 1.0 ? 1.0 / r : pow(r, -mu);
}

/* Binary order of magnitude of a positive number: value = m 2^order, 0.5 <= m < 1. */
static int order_of(double value)
{
    int order = 0;
    frexp(value, &order);
    return order;
}

double ihc_squared_norm(const ihc_polynomial *p, double mu, double r)
{
    if (p->exponent != 0) {
        const int distance = order_of(r) - p->exponent;
        if (distance > FAR || distance < -FAR) {
            return distance > 0 ? 0.0 : INFINITY;
        }
        r = ldexp(r, -p->exponent);
    }
    const double s = inverse_power(r, mu);
    double total = 0.0;
    for (int m = IHC_COEFFICIENTS - 1; m >= 0; m--) {
        total = total * s + p->c[m];
    }
    return total / (r * r);
}

/* The start of the search in the coordinates of the polynomial; 1 where the guess is of no use. */
static double scaled_guess(double guess, int exponent)
{
    if (exponent != 0) {
        const int near = guess > 0.0 && guess < INFINITY && abs(order_of(guess) - exponent) < FAR;
        guess = near ? ldexp(guess, -exponent) : 1.0;
    }
    return guess > LEAST_GUESS && guess < LARGEST_GUESS ? guess : 1.0;
}

/* The root sigma of ln N(e^sigma) = 0, as e^sigma. */
static double root_of(const double c[IHC_COEFFICIENTS], double mu, double guess)
{
    double low = -UNBOUNDED, high = UNBOUNDED, last = UNBOUNDED;
    double sigma = log(opaque(guess));
    for (int k = 0; k < IHC_NEWTON_LIMIT; k++) {
        const double s = exp(-mu * sigma);
        double value = 0.0, weighted = 0.0;
        for (int m = IHC_COEFFICIENTS - 1; m >= 0; m--) {
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

double ihc_homogeneous_norm(const ihc_polynomial *p, double mu, double guess)
{
    double size = 0.0;
    for (int m = 0; m < IHC_COEFFICIENTS; m++) {
        if (!isfinite(p->c[m])) {
            return NAN;
        }
        size = fabs(p->c[m]) > size ? fabs(p->c[m]) : size;
    }
    if (size == 0.0) {
        return 0.0;
    }
    const double root = root_of(p->c, mu, scaled_guess(guess, p->exponent));
    if (p->exponent == 0 || isnan(root)) {
        return root;
    }
    return order_of(root) + p->exponent > DBL_MAX_EXP ? DBL_MAX : ldexp(root, p->exponent);
}

void ihc_bisection_update(const ihc_polynomial *p, double mu, double interval[2], double a_min, double b_max,
                          int j_max)
{
    double a = interval[0], b = interval[1];
    if (ihc_squared_norm(p, mu, b) > 1.0) {
        a = b;
        b = fmin(2.0 * b, b_max);
    } else if (ihc_squared_norm(p, mu, a) < 1.0) {
        b = a;
        a = fmax(a / 2.0, a_min);
    } else {
        for (int j = 0; j < j_max && j < IHC_MAX_J; j++) {
            const double middle = (a + b) / 2.0;
            if (ihc_squared_norm(p, mu, middle) < 1.0) {
                b = middle;
            } else {
                a = middle;
            }
        }
    }
    interval[0] = a;
    interval[1] = b;
}

/* ---- Laws -------------------------------------------------------------------------------------------------------- */

double ihc_law_linear(const double k_lin[N], const double x[N])
{
    return dot(k_lin, x);
}

double ihc_law_sliding_mode(const double c[N], const double k[N], double rho, const double x[N])
{
    const double surface = dot(c, x);
    const double switching = surface > 0.0 ? rho : surface < 0.0 ? -rho : 0.0;
    return dot(k, x) - switching;
}

/* kz_i s^(n-i+1), s = r^-mu. */
static void chain_gains(const double kz[N], double mu, double r, double gains[N])
{
    const double s = inverse_power(r, mu);
    double power = s;
    for (int i = N - 1; i >= 0; i--) {
        gains[i] = kz[i] * power;
        power *= s;
    }
}

double ihc_law_homogeneous(const double k_lin[N], const double row[N], const double kz[N], double mu, double r,
                           const double x[N], const double z[N])
{
    double gains[N], change = 0.0;
    chain_gains(kz, mu, r, gains);
    if (r > 1.0) { /* as below the gains fade, and k_lin x would cancel */
        return dot(gains, z) - dot(row, x);
    }
    for (int i = 0; i < N; i++) {
        change += (gains[i] - kz[i]) * z[i];
    }
    return dot(k_lin, x) + change;
}

double ihc_law_semi_implicit(const double kz[N], const double row_z[N], double mu, double r, double h, const double z[N])
{
    double g[N], f[N], powers[N], y[N];
    chain_gains(kz, mu, r, g);
    f[N - 1] = z[N - 1];
    powers[N - 1] = h;
    for (int i = N - 2; i >= 0; i--) {
        f[i] = z[i] + h * f[i + 1];
        powers[i] = h * powers[i + 1];
    }
    const double v = dot(g, f) / (1.0 - dot(g, powers));
    for (int i = 0; i < N; i++) {
        y[i] = f[i] + powers[i] * v;
    }
    return v - dot(row_z, y);
}

/* ---- Nominal model, eq. (5) in lumped numbers -------------------------------------------------------------------- */

static void accelerations(const ihc_params *m, double delta, double theta_dot, double delta_dot, double voltage,
                          double *theta_ddot, double *delta_ddot)
{
    const double s = sin(delta), c = cos(delta);
    const double pull = m->nominal_swing_inertia * s * c;
    double arm = m->nominal_torque_per_volt * voltage
        - (m->nominal_arm_damping + m->nominal_motor_damping + 2.0 * pull * delta_dot) * theta_dot;
    arm -= m->nominal_coupling * s * delta_dot * delta_dot;
    const double pendulum = (m->nominal_gravity_torque * s - m->nominal_pendulum_damping * delta_dot)
        + pull * theta_dot * theta_dot;
    const double inertia = m->nominal_arm_inertia + m->nominal_swing_inertia * s * s;
    const double mixed = m->nominal_coupling * c;
    const double determinant = inertia * m->nominal_pendulum_inertia - mixed * mixed;
    *theta_ddot = (m->nominal_pendulum_inertia * arm + mixed * pendulum) / determinant;
    *delta_ddot = (inertia * pendulum + mixed * arm) / determinant;
}

/* The voltage under which the arm accelerates by theta_ddot: inverse dynamics. */
static double voltage_for(const ihc_params *m, double delta, double theta_dot, double delta_dot, double theta_ddot)
{
    const double s = sin(delta), c = cos(delta);
    const double pull = m->nominal_swing_inertia * s * c;
    const double pendulum = m->nominal_gravity_torque * s - m->nominal_pendulum_damping * delta_dot
        + pull * theta_dot * theta_dot;
    const double delta_ddot = (pendulum + m->nominal_coupling * c * theta_ddot) / m->nominal_pendulum_inertia;
    double torque = (m->nominal_arm_inertia + m->nominal_swing_inertia * s * s) * theta_ddot
        - m->nominal_coupling * c * delta_ddot;
    torque += (m->nominal_arm_damping + m->nominal_motor_damping + 2.0 * pull * delta_dot) * theta_dot;
    torque += m->nominal_coupling * s * delta_dot * delta_dot;
    return torque / m->nominal_torque_per_volt;
}

/* The state after h under a held voltage: one classical Runge-Kutta step. */
static void predict(const ihc_params *m, const double x[4], double voltage, double h, double y[4])
{
    const double half = 0.5 * h, sixth = h / 6.0;
    double a1, b1, a2, b2, a3, b3, a4, b4;
    accelerations(m, x[1], x[2], x[3], voltage, &a1, &b1);
    const double v2 = x[2] + half * a1, w2 = x[3] + half * b1;
    accelerations(m, x[1] + half * x[3], v2, w2, voltage, &a2, &b2);
    const double v3 = x[2] + half * a2, w3 = x[3] + half * b2;
    accelerations(m, x[1] + half * w2, v3, w3, voltage, &a3, &b3);
    const double v4 = x[2] + h * a3, w4 = x[3] + h * b3;
    accelerations(m, x[1] + h * w3, v4, w4, voltage, &a4, &b4);
    y[0] = x[0] + sixth * (x[2] + 2.0 * (v2 + v3) + v4);
    y[1] = x[1] + sixth * (x[3] + 2.0 * (w2 + w3) + w4);
    y[2] = x[2] + sixth * (a1 + 2.0 * (a2 + a3) + a4);
    y[3] = x[3] + sixth * (b1 + 2.0 * (b2 + b3) + b4);
}

/* ---- Estimators -------------------------------------------------------------------------------------------------- */

/* Steady-state Kalman gains of one angle with white acceleration, see velocity.alpha_beta_gains. */
static void alpha_beta_gains(double acceleration_noise, double resolution, double h, double gains[2])
{
    const double variance = resolution * resolution / 12.0 * (1e-3 / h);
    const double index = acceleration_noise * (h * h * h) / variance;
    double low = 0.0, high = fmin(sqrt(index), 3.0 - sqrt(3.0)); /* where alpha is 1 */
    for (int k = 0; k < IHC_BISECTIONS; k++) {
        const double beta = 0.5 * (low + high);
        const double alpha = 0.5 * (sqrt(8.0 * beta + beta * beta / 3.0) - beta);
        if (beta * beta < (1.0 - alpha) * index) {
            low = beta;
        } else {
            high = beta;
        }
    }
    const double beta = 0.5 * (low + high);
    gains[0] = 0.5 * (sqrt(8.0 * beta + beta * beta / 3.0) - beta);
    gains[1] = beta / h;
}

/* w s/(s + w), exact for an angle held between samples. */
static double filter_velocity(double cutoff, double decay, double *lag, double angle)
{
    const double velocity = cutoff * (angle - *lag);
    *lag = flushed(decay * *lag + (1.0 - decay) * angle, LEAST);
    return flushed(velocity, LEAST);
}

/* Predict by the nominal model, correct each channel by the constant gains. */
static void observe(const ihc_params *p, const ihc_prepared *q, ihc_state *s, double theta, double delta)
{
    double y[4];
    predict(p, s->observed, s->voltage, p->sample_time, y);
    const double e_theta = theta - y[0], e_delta = delta - y[1];
    s->observed[0] = flushed(y[0] + q->observer_gain[0] * e_theta, LEAST_ESTIMATE);
    s->observed[1] = flushed(y[1] + q->observer_gain[0] * e_delta, LEAST_ESTIMATE);
    s->observed[2] = flushed(y[2] + q->observer_gain[1] * e_theta, LEAST_ESTIMATE);
    s->observed[3] = flushed(y[3] + q->observer_gain[1] * e_delta, LEAST_ESTIMATE);
}

/* The same with disturbance and bias as states and the gain M. */
static void kalman_step(const ihc_params *p, const ihc_prepared *q, ihc_state *s, double theta, double delta)
{
    double y[4], corrections[6];
    predict(p, s->observed, s->voltage + s->disturbance, p->sample_time, y);
    const double bias = s->bias * q->bias_decay;
    const double e_1 = theta - y[0], e_2 = delta - (y[1] + bias);
    for (int i = 0; i < 6; i++) {
        corrections[i] = p->kalman_M[i][0] * e_1 + p->kalman_M[i][1] * e_2;
    }
    if (!isfinite(s->disturbance + corrections[4] + bias + corrections[5])) {
        s->observed[0] = NAN; /* a fault; the outputs stay finite */
        return;
    }
    for (int i = 0; i < 4; i++) {
        s->observed[i] = flushed(y[i] + corrections[i], LEAST_ESTIMATE);
    }
    s->disturbance = flushed(s->disturbance + corrections[4], LEAST_ESTIMATE);
    s->bias = flushed(bias + corrections[5], LEAST_ESTIMATE);
}

/* ---- Preparation ------------------------------------------------------------------------------------------------- */

/* Solve M X = B in place of B by Gaussian elimination with partial pivoting; 0 where M is singular. */
static int solve(double M[N][N], double B[N][N], int columns)
{
    for (int k = 0; k < N; k++) {
        int pivot = k;
        for (int i = k + 1; i < N; i++) {
            if (fabs(M[i][k]) > fabs(M[pivot][k])) {
                pivot = i;
            }
        }
        for (int j = 0; j < N; j++) {
            const double m = M[k][j], b = B[k][j];
            M[k][j] = M[pivot][j];
            M[pivot][j] = m;
            B[k][j] = B[pivot][j];
            B[pivot][j] = b;
        }
        const double head = M[k][k];
        if (head == 0.0 || !isfinite(head)) {
            return 0;
        }
        for (int i = k + 1; i < N; i++) {
            const double factor = M[i][k] / head;
            for (int j = k; j < N; j++) {
                M[i][j] -= factor * M[k][j];
            }
            for (int j = 0; j < columns; j++) {
                B[i][j] -= factor * B[k][j];
            }
        }
    }
    for (int k = N - 1; k >= 0; k--) {
        for (int j = 0; j < columns; j++) {
            double rest = 0.0;
            for (int i = k + 1; i < N; i++) {
                rest += M[k][i] * B[i][j];
            }
            B[k][j] = (B[k][j] - rest) / M[k][k];
        }
    }
    return 1;
}

/* B <- Phi^-T B. */
static int solve_transposed(const ihc_params *p, double B[N][N], int columns)
{
    double Phi_t[N][N];
    for (int i = 0; i < N; i++) {
        for (int j = 0; j < N; j++) {
            Phi_t[i][j] = p->Phi[j][i];
        }
    }
    return solve(Phi_t, B, columns);
}

static void transpose(double M[N][N])
{
    for (int i = 0; i < N; i++) {
        for (int j = i + 1; j < N; j++) {
            const double m = M[i][j];
            M[i][j] = M[j][i];
            M[j][i] = m;
        }
    }
}

/* row_z <- row Phi^-1 by iterative refinement: entries that should be 0 would otherwise outweigh fading gains. */
static void refine(const ihc_params *p, double row_z[N])
{
    for (int k = 0; k < REFINEMENTS; k++) {
        double residual[N][N] = {{0.0}};
        for (int i = 0; i < N; i++) {
            double sum = 0.0;
            for (int j = 0; j < N; j++) {
                sum += p->Phi[j][i] * row_z[j];
            }
            residual[i][0] = p->row[i] - sum;
        }
        solve_transposed(p, residual, 1);
        for (int i = 0; i < N; i++) {
            row_z[i] += residual[i][0];
        }
    }
}

/* kz, row_z and Pz = Phi^-T P Phi^-1. */
static int to_chain(const ihc_params *p, ihc_prepared *q)
{
    double gains[N][N] = {{0.0}};
    int entry = 0;
    for (int i = 0; i < N; i++) {
        gains[i][0] = p->k_lin[i] + p->row[i];
        gains[i][1] = p->row[i];
        for (int j = i; j < N; j++) {
            q->Pz[i][j] = q->Pz[j][i] = p->P[entry++];
        }
    }
    if (!solve_transposed(p, gains, 2) || !solve_transposed(p, q->Pz, N)) {
        return 0;
    }
    transpose(q->Pz);
    if (!solve_transposed(p, q->Pz, N)) {
        return 0;
    }
    for (int i = 0; i < N; i++) {
        q->kz[i] = gains[i][0];
        q->row_z[i] = gains[i][1];
    }
    refine(p, q->row_z);
    return 1;
}

static int is_finite(const ihc_prepared *q)
{
    int finite = 1;
    for (int i = 0; i < N; i++) {
        finite = finite && isfinite(q->kz[i]) && isfinite(q->row_z[i]);
        for (int j = 0; j < N; j++) {
            finite = finite && isfinite(q->Pz[i][j]);
        }
    }
    return finite;
}

/* Whether the determinant of the nominal inertia matrix upright, where it is smallest, is more than rounding. */
static int is_regular(const ihc_params *p)
{
    const double diagonal = p->nominal_arm_inertia * p->nominal_pendulum_inertia;
    return diagonal - p->nominal_coupling * p->nominal_coupling > 1e-9 * diagonal;
}

ihc_status ihc_prepare(const ihc_params *p, ihc_prepared *q)
{
    if (!to_chain(p, q)) {
        return IHC_SINGULAR_PHI;
    }
    if (!is_finite(q)) {
        return IHC_CHAIN_NOT_FINITE;
    }
    if (p->a_min > p->b_max) {
        return IHC_LIMITS;
    }
    if (!is_regular(p)) {
        return IHC_SINGULAR_MODEL;
    }
    if (p->capture_angle > p->fall_back_angle) {
        return IHC_ANGLES;
    }
    if (p->velocity_source == IHC_VELOCITY_KALMAN
        && fabs(p->kalman_sample_time - p->sample_time) > 1e-9 * p->sample_time) {
        return IHC_KALMAN_TIME;
    }
    q->decay = flushed(exp(-p->velocity_filter_cutoff * p->sample_time), LEAST);
    q->bias_decay = exp(-BIAS_DECAY * p->sample_time);
    alpha_beta_gains(p->observer_acceleration_noise, p->observer_resolution, p->sample_time, q->observer_gain);
    return IHC_OK;
}

/* ---- The sample -------------------------------------------------------------------------------------------------- */

static double wrap(double angle)
{
    return fabs(angle) <= PI ? angle : remainder(angle, TURN); /* the remainder of a small one is itself */
}

static void observed_state(const ihc_state *s, double x[N])
{
    x[0] = s->observed[0];
    x[1] = wrap(s->observed[1]);
    x[2] = s->observed[2];
    x[3] = s->observed[3];
}

static void first_estimate(const ihc_params *p, const ihc_inputs *u, double x[N])
{
    const int measured = p->velocity_source == IHC_VELOCITY_INPUTS;
    x[0] = u->theta;
    x[1] = wrap(u->delta);
    x[2] = measured ? u->theta_dot : 0.0;
    x[3] = measured ? u->delta_dot : 0.0;
}

static void prime(const ihc_params *p, ihc_state *s, const ihc_inputs *u, double x[N])
{
    first_estimate(p, u, x);
    s->primed = 1;
    s->theta_lag = u->theta;
    s->delta_lag = u->delta;
    s->measured_delta = u->delta;
    s->observed[0] = u->theta;
    s->observed[1] = u->delta;
    s->observed[2] = s->theta_dot = x[2];
    s->observed[3] = s->delta_dot = x[3];
}

/* The pendulum angle without the jumps by a turn of a sensor that wraps. */
static double unwrap(ihc_state *s, double measured)
{
    const double jump = measured - s->measured_delta;
    if (fabs(jump) > PI) {
        s->turns -= nearbyint(jump / TURN);
    }
    s->measured_delta = measured;
    return measured + TURN * s->turns;
}

/* x for the law in force; advances the filter, and the observer where it is used. */
static void estimate(const ihc_params *p, const ihc_prepared *q, ihc_state *s, const ihc_inputs *u, double x[N])
{
    const double delta = unwrap(s, u->delta); /* for those who differentiate; whole turns cost it small digits */
    x[0] = u->theta;
    x[1] = wrap(u->delta);
    if (p->velocity_source == IHC_VELOCITY_INPUTS) {
        x[2] = u->theta_dot;
        x[3] = u->delta_dot;
    } else if (p->velocity_source == IHC_VELOCITY_KALMAN) {
        if (fabs(x[1]) > p->kalman_angle) {
            s->disturbance = s->bias = 0.0;
            observe(p, q, s, u->theta, delta);
        } else {
            kalman_step(p, q, s, u->theta, delta);
        }
        observed_state(s, x);
    } else {
        s->theta_dot = x[2] = filter_velocity(p->velocity_filter_cutoff, q->decay, &s->theta_lag, u->theta);
        s->delta_dot = x[3] = filter_velocity(p->velocity_filter_cutoff, q->decay, &s->delta_lag, delta);
        if (s->mode == IHC_STABILIZING && fabs(x[1]) <= p->fall_back_angle) {
            s->observed[0] = u->theta;
            s->observed[1] = delta;
            s->observed[2] = x[2];
            s->observed[3] = x[3];
        } else {
            observe(p, q, s, u->theta, delta);
            observed_state(s, x);
        }
    }
}

static int32_t next_mode(const ihc_params *p, int32_t mode, double level, double delta, double delta_dot)
{
    if (!p->enabled) {
        return IHC_IDLE;
    }
    if (mode == IHC_STABILIZING && fabs(delta) <= p->fall_back_angle) {
        return IHC_STABILIZING;
    }
    if (level < p->capture_level && fabs(delta) < p->capture_angle && fabs(delta_dot) < p->capture_velocity) {
        return IHC_STABILIZING;
    }
    return p->swing_up_enabled ? IHC_SWING_UP : IHC_IDLE;
}

static double swing_up_voltage(const ihc_params *p, const double x[N])
{
    const double c = cos(x[1]);
    const double energy = 0.5 * p->nominal_pendulum_inertia * x[3] * x[3]
        + p->nominal_gravity_torque * (c - 1.0 - p->swing_up_energy_offset);
    const int at_rest = c < REST_COSINE && fabs(x[3]) < REST_VELOCITY;
    const double direction = at_rest ? 1.0 : clamp(x[3] * c / p->swing_up_velocity_scale, -1.0, 1.0);
    const double limit = p->swing_up_acceleration_limit;
    double wanted = clamp(-p->swing_up_energy_gain * energy * direction, -limit, limit);
    wanted -= p->swing_up_arm_stiffness * x[0] + p->swing_up_arm_damping * x[2];
    return voltage_for(p, x[1], x[2], x[3], wanted);
}

/* A state as the norm and the homogeneous law take it: x = 2^-shift times the state, z = Phi x. */
typedef struct {
    int shift;
    double x[N], z[N];
    ihc_polynomial polynomial;
} chain_state;

static int shift_of(const double x[N])
{
    double size = 0.0;
    for (int i = 0; i < N; i++) {
        size = fmax(size, fabs(x[i]));
    }
    return size > LARGE ? SHIFT : size > 0.0 && size < SMALL ? -SHIFT : 0;
}

static void to_chain_state(const ihc_params *p, const ihc_prepared *q, const double x[N], chain_state *chain)
{
    chain->shift = shift_of(x);
    const double factor = chain->shift == 0 ? 1.0 : chain->shift > 0 ? SMALL : LARGE;
    for (int i = 0; i < N; i++) {
        chain->x[i] = x[i] * factor;
    }
    for (int i = 0; i < N; i++) {
        chain->z[i] = exact_dot(p->Phi[i], chain->x);
    }
    ihc_norm_polynomial(q->Pz, chain->z, p->mu, chain->shift, &chain->polynomial);
}

static double norm_in_law(const ihc_params *p, ihc_state *s, const ihc_polynomial *polynomial)
{
    if (p->norm_solver == IHC_NORM_EXACT) {
        return isnan(s->norm) ? s->norm : clamp(s->norm, p->a_min, p->b_max);
    }
    s->interval[0] = clamp(s->interval[0], p->a_min, p->b_max);
    s->interval[1] = clamp(s->interval[1], p->a_min, p->b_max);
    ihc_bisection_update(polynomial, p->mu, s->interval, p->a_min, p->b_max, p->j_max);
    return s->interval[1];
}

static double stabilizing_voltage(const ihc_params *p, const ihc_prepared *q, ihc_state *s, const double x[N],
                                  const chain_state *chain)
{
    if (p->law == IHC_LAW_LC) {
        return ihc_law_linear(p->k_lin, x);
    }
    if (p->law == IHC_LAW_SMC) {
        return ihc_law_sliding_mode(p->smc_c, p->smc_k, p->smc_rho, x);
    }
    const double r = s->norm_used = norm_in_law(p, s, &chain->polynomial);
    const double u = p->discretization == IHC_SEMI_IMPLICIT
        ? ihc_law_semi_implicit(q->kz, q->row_z, p->mu, r, p->sample_time, chain->z)
        : ihc_law_homogeneous(p->k_lin, p->row, q->kz, p->mu, r, chain->x, chain->z);
    return chain->shift == 0 ? u : clamp(u, -MOST, MOST) * (chain->shift > 0 ? LARGE : SMALL);
}

static ihc_status fail(ihc_state *s, int32_t fault)
{
    const int known = s->mode == IHC_FAULT;
    s->voltage = 0.0;
    s->norm_used = 1.0;
    if (known) {
        return IHC_OK;
    }
    s->mode = IHC_FAULT;
    s->fault = fault;
    return IHC_NEW_FAULT;
}

static int32_t bad_inputs(const ihc_inputs *u)
{
    return (isfinite(u->theta) ? 0 : 1) | (isfinite(u->delta) ? 0 : 2) | (isfinite(u->theta_dot) ? 0 : 4)
        | (isfinite(u->delta_dot) ? 0 : 8);
}

static ihc_status sample(const ihc_params *p, const ihc_prepared *q, ihc_state *s, const ihc_inputs *u)
{
    double x[N], command = 0.0;
    chain_state chain;
    const int32_t bad = bad_inputs(u);
    if (bad) {
        s->bad_inputs = s->mode == IHC_FAULT ? s->bad_inputs : bad;
        return fail(s, IHC_FAULT_INPUT);
    }
    if (s->mode == IHC_FAULT) {
        return IHC_OK;
    }
    const ihc_inputs measured = {flushed(u->theta, LEAST), flushed(u->delta, LEAST), flushed(u->theta_dot, LEAST),
                                 flushed(u->delta_dot, LEAST)};
    if (s->primed) {
        estimate(p, q, s, &measured, x);
    } else {
        prime(p, s, &measured, x);
    }
    if (!isfinite(x[0] + x[1] + x[2] + x[3])) {
        return fail(s, IHC_FAULT_CONTROL);
    }
    to_chain_state(p, q, x, &chain);
    s->norm = ihc_homogeneous_norm(&chain.polynomial, p->mu, s->norm);
    const int32_t earlier = s->mode;
    s->mode = next_mode(p, earlier, ihc_squared_norm(&chain.polynomial, p->mu, 1.0), x[1], x[3]);
    if (s->mode == IHC_STABILIZING && earlier != IHC_STABILIZING) {
        s->interval[0] = p->a_min;
        s->interval[1] = p->b_max;
        if (p->velocity_source == IHC_VELOCITY_FILTER) {
            x[0] = measured.theta;
            x[1] = wrap(measured.delta);
            x[2] = s->theta_dot;
            x[3] = s->delta_dot;
        }
        to_chain_state(p, q, x, &chain);
        s->norm = ihc_homogeneous_norm(&chain.polynomial, p->mu, s->norm);
    }
    s->theta_dot = x[2];
    s->delta_dot = x[3];
    s->norm_used = 1.0;
    if (s->mode == IHC_SWING_UP) {
        command = swing_up_voltage(p, x);
    } else if (s->mode == IHC_STABILIZING) {
        command = stabilizing_voltage(p, q, s, x, &chain);
        if (p->compensate_disturbance) {
            command -= s->disturbance;
        }
    }
    if (!isfinite(command)) {
        return fail(s, IHC_FAULT_CONTROL);
    }
    s->voltage = clamp(command, -p->voltage_limit, p->voltage_limit);
    return IHC_OK;
}

void ihc_initialize(const ihc_params *p, const ihc_prepared *q, ihc_state *s, double time, const ihc_inputs *u)
{
    static const ihc_state zero;
    *s = zero;
    s->start_time = time;
    s->mode = IHC_IDLE;
    s->fault = IHC_FAULT_NONE;
    s->norm_used = 1.0;
    s->interval[0] = p->a_min;
    s->interval[1] = p->b_max;
    if (!bad_inputs(u)) {
        double x[N];
        chain_state chain;
        first_estimate(p, u, x);
        to_chain_state(p, q, x, &chain);
        s->norm = ihc_homogeneous_norm(&chain.polynomial, p->mu, 1.0);
    }
}

/* Whether one of the two times is a multiple of the other. */
static ihc_status check_step(double sample_time, double step)
{
    const double ratio = step > sample_time ? step / sample_time : sample_time / step;
    if (step > sample_time && ratio > (double)IHC_MAX_SAMPLES + 0.5) {
        return IHC_TOO_MANY_SAMPLES;
    }
    return fabs(ratio - nearbyint(ratio)) <= 1e-6 * ratio ? IHC_OK : IHC_STEP_NOT_MULTIPLE; /* also for NaN */
}

ihc_status ihc_step(const ihc_params *p, const ihc_prepared *q, ihc_state *s, double time, double step,
                    const ihc_inputs *u)
{
    const double samples = step / p->sample_time;
    ihc_status status = check_step(p->sample_time, step);
    if (status != IHC_OK) {
        return status;
    }
    const double beyond = samples > 1.0 ? samples - 0.5 : 0.5 * samples;
    const double last = floor((time - s->start_time) / p->sample_time + beyond);
    if (last - (double)s->next_sample >= fmax(1.0, nearbyint(samples))) {
        return IHC_SAMPLE_MISSED;
    }
    while ((double)s->next_sample <= last) { /* as often as the step has samples, at most */
        s->next_sample++;
        if (sample(p, q, s, u) != IHC_OK) {
            status = IHC_NEW_FAULT;
        }
    }
    if (status == IHC_OK && samples > 1.5 && !s->held) {
        s->held = 1;
        return IHC_INPUTS_HELD;
    }
    return status;
}

void ihc_get_outputs(const ihc_state *s, ihc_outputs *y)
{
    y->voltage = s->voltage;
    y->homogeneous_norm = s->norm;
    y->homogeneous_norm_used = s->norm_used;
    y->mode = s->mode;
    y->theta_dot_estimate = s->theta_dot;
    y->delta_dot_estimate = s->delta_dot;
    y->disturbance_estimate = s->disturbance;
    y->bias_estimate = s->bias;
    y->fault = s->fault;
}
