#include "homogeneous_controller.h"

#include <string.h>

enum { STATES = REGULATOR_STATES, INPUTS = REGULATOR_INPUTS, OUTPUTS = REGULATOR_OUTPUTS };

/* ---- Preparation ------------------------------------------------------------------------------------------------- */

/* Whether the exponents fall by 0 or 1 from coordinate to coordinate, to 0. */
static int are_exponents(const int *e, int n)
{
    int falling = e[n - 1] == 0;
    for (int i = 0; i + 1 < n; i++) {
        falling = falling && (e[i] == e[i + 1] || e[i] == e[i + 1] + 1);
    }
    return falling;
}

static void take_design(const regulator_params *p, block_design *d)
{
    const int n = p->state_count, m = p->input_count;
    int entry = 0;
    memset(d, 0, sizeof *d);
    d->n = n;
    d->m = m;
    d->mu = p->mu;
    memcpy(d->exponents, p->exponent, sizeof d->exponents);
    memcpy(d->T, p->T, sizeof d->T);
    memcpy(d->N, p->N, sizeof d->N);
    memcpy(d->B, p->B, sizeof d->B);
    memcpy(d->K, p->K, sizeof d->K);
    memcpy(d->K_0, p->K0, sizeof d->K_0);
    for (int i = 0; i < n; i++) {
        for (int j = i; j < n; j++) {
            d->Pz[i * n + j] = d->Pz[j * n + i] = p->P[entry++];
        }
    }
}

/* Kiz = K_i T^-1; 0 where T is singular. */
static int take_integral(const regulator_params *p, regulator_prepared *q)
{
    const int n = p->state_count, m = p->input_count;
    double columns[BLOCK_GAINS];
    q->integrates = 0;
    memset(q->Kiz, 0, sizeof q->Kiz);
    for (int i = 0; i < m; i++) {
        for (int j = 0; j < n; j++) {
            columns[j * m + i] = p->Ki[i * n + j];
            q->integrates = q->integrates || p->Ki[i * n + j] != 0.0;
        }
    }
    if (!solve_transposed(p->T, columns, n, m)) {
        return 0;
    }
    for (int i = 0; i < m; i++) {
        for (int j = 0; j < n; j++) {
            q->Kiz[i * n + j] = columns[j * m + i];
        }
    }
    return 1;
}

int regulator_contradicting_limit(const regulator_params *p)
{
    for (int i = 0; i < p->input_count; i++) {
        if (p->lower[i] > p->upper[i]) {
            return i;
        }
    }
    return -1;
}

regulator_status regulator_prepare(const regulator_params *p, regulator_prepared *q)
{
    const int n = p->state_count, m = p->input_count;
    if (!are_exponents(p->exponent, n)) {
        return REGULATOR_EXPONENTS;
    }
    if (indefinite_block(p->P, n)) {
        return REGULATOR_INDEFINITE_P;
    }
    take_design(p, &q->design);
    if (!prepare_block_design(&q->design) || !take_integral(p, q)) {
        return REGULATOR_SINGULAR_T;
    }
    if (!block_design_is_finite(&q->design) || !all_finite(q->Kiz, m * n)) {
        return REGULATOR_BLOCKS_NOT_FINITE;
    }
    if (p->a_min > p->b_max) {
        return REGULATOR_BOUNDS;
    }
    if (regulator_contradicting_limit(p) >= 0) {
        return REGULATOR_LIMITS;
    }
    if (p->estimator == REGULATOR_ESTIMATOR_MEASURED_STATE && p->output_count != n) {
        return REGULATOR_MEASURED_STATES;
    }
    if (p->estimator == REGULATOR_ESTIMATOR_HOMOGENEOUS_OBSERVER && !are_exponents(p->observer_exponent, n)) {
        return REGULATOR_EXPONENTS;
    }
    if (p->estimator == REGULATOR_ESTIMATOR_HOMOGENEOUS_OBSERVER && p->q_min > p->q_max) {
        return REGULATOR_ERROR_BOUNDS;
    }
    if (p->estimator == REGULATOR_ESTIMATOR_KALMAN
        && fabs(p->filter_sample_time - p->sample_time) > 1e-9 * p->sample_time) {
        return REGULATOR_FILTER_TIME;
    }
    q->search = (norm_search){p->norm_solver == REGULATOR_NORM_SOLVER_EXACT, p->a_min, p->b_max, p->j_max};
    q->ahead = p->discretization == REGULATOR_DISCRETIZATION_SEMI_IMPLICIT ? p->sample_time : 0.0;
    for (int i = 0; i < INPUTS; i++) {
        q->idle[i] = i < m ? clamp(0.0, p->lower[i], p->upper[i]) : 0.0;
    }
    return REGULATOR_OK;
}

/* ---- The sample -------------------------------------------------------------------------------------------------- */

static void copy(const double *values, int count, double *copied)
{
    for (int i = 0; i < count; i++) {
        copied[i] = values[i];
    }
}

static uint32_t bad_inputs(const regulator_params *p, const regulator_inputs *u)
{
    uint32_t bad = 0;
    for (int i = 0; i < p->output_count; i++) {
        bad |= isfinite(u->measurement[i]) ? 0u : 1u << i;
        bad |= isfinite(u->setpoint[i]) ? 0u : 1u << (OUTPUTS + i);
    }
    return bad;
}

/* Measured outputs, or set-points, less the outputs at the equilibrium; returns whether one is not 0. */
static int deviations(const regulator_params *p, const double *values, double *found)
{
    int any = 0;
    for (int i = 0; i < p->output_count; i++) {
        found[i] = flushed(values[i] - p->output_equilibrium[i], LEAST);
        any = any || found[i] != 0.0;
    }
    return any;
}

static void first_estimate(const regulator_params *p, const double *y, double *x)
{
    for (int i = 0; i < p->state_count; i++) {
        x[i] = p->estimator == REGULATOR_ESTIMATOR_MEASURED_STATE
            ? y[i]
            : dot(&p->first[i * p->output_count], y, p->output_count);
    }
}

/* x+ = F x + G (u + d), d+ = d, b+ = decay b, corrected by M times the innovation y - (C x + b); 0 where not finite. */
static int kalman_step(const regulator_params *p, regulator_state *s, const double *y)
{
    const int n = p->state_count, m = p->input_count, outputs = p->output_count, all = n + m + outputs;
    double driven[INPUTS], found[STATES + INPUTS + OUTPUTS], innovation[OUTPUTS], corrected[STATES + INPUTS + OUTPUTS];
    for (int i = 0; i < m; i++) {
        driven[i] = s->command[i] - p->input_equilibrium[i] + s->d[i];
        found[n + i] = s->d[i];
    }
    for (int i = 0; i < n; i++) {
        found[i] = dot(&p->F[i * n], s->x, n) + dot(&p->G[i * m], driven, m);
    }
    for (int i = 0; i < outputs; i++) {
        found[n + m + i] = p->bias_decay * s->b[i];
        innovation[i] =
            weighed(y[i] - (dot(&p->C[i * n], found, n) + found[n + m + i]), p->count[i], p->kalman_count_weight);
    }
    for (int i = 0; i < all; i++) {
        corrected[i] = flushed(found[i] + dot(&p->M[i * outputs], innovation, outputs), LEAST_ESTIMATE);
    }
    if (!all_finite(corrected, all)) {
        return 0;
    }
    copy(corrected, n, s->x);
    copy(corrected + n, m, s->d);
    copy(corrected + n + m, outputs, s->b);
    return 1;
}

/* S = L_0 + To' diag(q^(nu (1 + e_j))) Lz (n, p), q = |C x - y| limited. */
static void observer_gain(const regulator_params *p, const double *x, const double *y, double *S)
{
    const int n = p->state_count, outputs = p->output_count;
    double errors[OUTPUTS], scaled[STATES * OUTPUTS];
    for (int i = 0; i < outputs; i++) {
        errors[i] = dot(&p->C[i * n], x, n) - y[i];
    }
    const double q = clamp(sqrt(dot(errors, errors, outputs)), p->q_min, p->q_max);
    for (int j = 0; j < n; j++) {
        const double power = pow(q, p->observer_degree * (1 + p->observer_exponent[j]));
        for (int i = 0; i < outputs; i++) {
            scaled[j * outputs + i] = power * p->Lz[j * outputs + i];
        }
    }
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < outputs; j++) {
            double sum = 0.0;
            for (int k = 0; k < n; k++) {
                sum += p->To[k * n + i] * scaled[k * outputs + j];
            }
            S[i * outputs + j] = p->L0[i * outputs + j] + sum;
        }
    }
}

/* x <- (I - h (A + S C))^-1 (x + h B u - h S y); 0 where not finite. */
static int observer_step(const regulator_params *p, regulator_state *s, const double *y)
{
    const int n = p->state_count, m = p->input_count, outputs = p->output_count;
    const double h = p->sample_time;
    double S[STATES * OUTPUTS], M[STATES * STATES], x[STATES], held[INPUTS];
    for (int i = 0; i < m; i++) {
        held[i] = s->command[i] - p->input_equilibrium[i];
    }
    observer_gain(p, s->x, y, S);
    for (int i = 0; i < n; i++) {
        const double *row = &S[i * outputs];
        x[i] = s->x[i] + h * (dot(&p->G[i * m], held, m) - dot(row, y, outputs));
        for (int j = 0; j < n; j++) {
            M[i * n + j] = (i == j ? 1.0 : 0.0) - h * (p->F[i * n + j] + dot_column(row, &p->C[j], outputs, n));
        }
    }
    if (!solve(M, x, n, 1) || !all_finite(x, n)) {
        return 0;
    }
    for (int i = 0; i < n; i++) {
        s->x[i] = flushed(x[i], LEAST_ESTIMATE);
    }
    return 1;
}

/* Advance the estimator; 0, and estimates as they were, where they would not be finite. */
static int estimate(const regulator_params *p, regulator_state *s, const double *y)
{
    double x[STATES];
    const int primed = s->primed;
    s->primed = 1;
    if (p->estimator != REGULATOR_ESTIMATOR_MEASURED_STATE && primed) {
        return p->estimator == REGULATOR_ESTIMATOR_KALMAN ? kalman_step(p, s, y) : observer_step(p, s, y);
    }
    first_estimate(p, y, x);
    if (!all_finite(x, p->state_count)) {
        return 0;
    }
    copy(x, p->state_count, s->x);
    return 1;
}

/* e = x - Nx r. */
static void error_of(const regulator_params *p, const double *x, const double *r, int any, double *error)
{
    for (int i = 0; i < p->state_count; i++) {
        error[i] = any ? x[i] - dot(&p->Nx[i * p->output_count], r, p->output_count) : x[i];
    }
}

static int fail(const regulator_prepared *q, regulator_state *s, int32_t fault)
{
    const int known = s->mode == REGULATOR_MODE_FAULT;
    memcpy(s->command, q->idle, sizeof s->command);
    s->norm_used = 1.0;
    if (known) {
        return REGULATOR_OK;
    }
    s->mode = REGULATOR_MODE_FAULT;
    s->fault = fault;
    return REGULATOR_NEW_FAULT;
}

static void next_mode(const regulator_params *p, const regulator_prepared *q, regulator_state *s)
{
    if (p->enabled && s->mode != REGULATOR_MODE_STABILIZING) {
        s->interval[0] = p->a_min;
        s->interval[1] = p->b_max;
        memset(s->v, 0, sizeof s->v);
    }
    if (!q->integrates && p->law != REGULATOR_LAW_STA) {
        memset(s->v, 0, sizeof s->v);
    }
    s->mode = p->enabled ? REGULATOR_MODE_STABILIZING : REGULATOR_MODE_IDLE;
}

/* Take the next v, but for entries that would push a command farther beyond its limit; 0: not finite. */
static int integrated(const regulator_params *p, regulator_state *s, const double *moved, const double *wanted)
{
    const int m = p->input_count;
    double v[INPUTS];
    for (int i = 0; i < m; i++) {
        v[i] = winds_up(wanted[i], moved[i] - s->v[i], p->lower[i], p->upper[i]) ? s->v[i] : flushed(moved[i], LEAST);
    }
    if (!all_finite(v, m)) {
        return 0;
    }
    copy(v, m, s->v);
    return 1;
}

/* Advance the integral action. */
static int integrate(const regulator_params *p, const regulator_prepared *q, regulator_state *s,
                     const block_state *state, const double *wanted)
{
    const int m = p->input_count;
    double rates[INPUTS], moved[INPUTS];
    const double r = s->norm_used;
    const int is_free = p->law != REGULATOR_LAW_LC && q->search.a_min < r && r < q->search.b_max;
    integrand(&q->design, q->Kiz, r, state, is_free, rates);
    for (int i = 0; i < m; i++) {
        moved[i] = s->v[i] + p->sample_time * rates[i];
    }
    return integrated(p, s, moved, wanted);
}

/* The inputs under the super-twisting law, v included, and the next v. */
static void super_twisting_law(const regulator_params *p, const regulator_prepared *q, const regulator_state *s,
                               const double *error, double *u, double *moved)
{
    const int n = p->state_count;
    for (int i = 0; i < p->input_count; i++) {
        const double w = super_twisting(dot(&p->S[i * n], error, n), s->v[i], p->sta_rate[i], p->sample_time,
                                        q->ahead > 0.0, &moved[i]);
        u[i] = dot(&p->Ks[i * n], error, n) + w;
    }
}

static int command(const regulator_params *p, const regulator_prepared *q, regulator_state *s, const double *error,
                   const block_state *state, const double *r, int any)
{
    const int n = p->state_count, m = p->input_count;
    const int twists = p->law == REGULATOR_LAW_STA;
    double u[INPUTS], moved[INPUTS];
    if (twists) {
        super_twisting_law(p, q, s, error, u, moved);
    } else if (p->law == REGULATOR_LAW_LC) {
        for (int i = 0; i < m; i++) {
            u[i] = dot(&p->K[i * n], error, n);
        }
    } else {
        s->norm_used = norm_in_law(&q->design, &q->search, &state->polynomial, s->norm, s->interval);
        homogeneous_law(&q->design, s->norm_used, q->ahead, state, u);
    }
    for (int i = 0; i < m; i++) {
        if (any) {
            u[i] += dot(&p->Nu[i * p->output_count], r, p->output_count);
        }
        if (p->compensate_disturbance) {
            u[i] -= s->d[i];
        }
        u[i] = u[i] + (twists ? 0.0 : s->v[i]) + p->input_equilibrium[i];
    }
    if (!all_finite(u, m)) {
        return fail(q, s, REGULATOR_FAULT_NON_FINITE_CONTROL);
    }
    for (int i = 0; i < m; i++) {
        s->command[i] = clamp(u[i], p->lower[i], p->upper[i]);
    }
    const int advanced = twists ? integrated(p, s, moved, u) : q->integrates ? integrate(p, q, s, state, u) : 1;
    return advanced ? REGULATOR_OK : fail(q, s, REGULATOR_FAULT_NON_FINITE_CONTROL);
}

static int sample(const regulator_params *p, const regulator_prepared *q, regulator_state *s, const regulator_inputs *u)
{
    double y[OUTPUTS], r[OUTPUTS], error[STATES];
    block_state state;
    const uint32_t bad = bad_inputs(p, u);
    if (bad) {
        s->bad_inputs = s->mode == REGULATOR_MODE_FAULT ? s->bad_inputs : bad;
        return fail(q, s, REGULATOR_FAULT_NON_FINITE_INPUT);
    }
    if (s->mode == REGULATOR_MODE_FAULT) {
        return REGULATOR_OK;
    }
    deviations(p, u->measurement, y);
    const int any = deviations(p, u->setpoint, r);
    if (!estimate(p, s, y)) {
        return fail(q, s, REGULATOR_FAULT_NON_FINITE_CONTROL);
    }
    error_of(p, s->x, r, any, error);
    if (!all_finite(error, p->state_count)) {
        return fail(q, s, REGULATOR_FAULT_NON_FINITE_CONTROL);
    }
    make_block_state(&q->design, error, &state);
    s->norm = homogeneous_norm(&q->design, &state.polynomial, s->norm);
    next_mode(p, q, s);
    s->norm_used = 1.0;
    if (s->mode == REGULATOR_MODE_IDLE) {
        memcpy(s->command, q->idle, sizeof s->command);
        return REGULATOR_OK;
    }
    return command(p, q, s, error, &state, r, any);
}

void regulator_initialize(const regulator_params *p, const regulator_prepared *q, regulator_state *s, double time,
                          const regulator_inputs *u)
{
    memset(s, 0, sizeof *s);
    s->clock.start_time = time;
    s->mode = REGULATOR_MODE_IDLE;
    s->fault = REGULATOR_FAULT_NONE;
    s->norm_used = 1.0;
    s->interval[0] = p->a_min;
    s->interval[1] = p->b_max;
    memcpy(s->command, q->idle, sizeof s->command);
    if (!bad_inputs(p, u)) {
        double y[OUTPUTS], r[OUTPUTS], x[STATES], error[STATES];
        block_state state;
        deviations(p, u->measurement, y);
        const int any = deviations(p, u->setpoint, r);
        first_estimate(p, y, x);
        error_of(p, x, r, any, error);
        make_block_state(&q->design, error, &state);
        s->norm = homogeneous_norm(&q->design, &state.polynomial, 1.0);
    }
}

int regulator_step(const regulator_params *p, const regulator_prepared *q, regulator_state *s, double time, double step,
                   const regulator_inputs *u)
{
    double last;
    int status = samples_until(&s->clock, p->sample_time, time, step, &last);
    if (status != CLOCK_OK) {
        return status;
    }
    while ((double)s->clock.next_sample <= last) { /* as often as the step has samples, at most */
        s->clock.next_sample++;
        if (sample(p, q, s, u) != REGULATOR_OK) {
            status = REGULATOR_NEW_FAULT;
        }
    }
    return status == CLOCK_OK ? note_held_inputs(&s->clock, p->sample_time, step) : status;
}

void regulator_get_outputs(const regulator_params *p, const regulator_state *s, regulator_outputs *y)
{
    const double *at_rest =
        p->estimator == REGULATOR_ESTIMATOR_MEASURED_STATE ? p->output_equilibrium : p->state_equilibrium;
    memset(y, 0, sizeof *y);
    for (int i = 0; i < p->input_count; i++) {
        y->command[i] = s->command[i];
        y->disturbance_estimate[i] = s->d[i];
    }
    for (int i = 0; i < p->state_count; i++) {
        y->state_estimate[i] = s->x[i] + at_rest[i];
    }
    for (int i = 0; i < p->output_count; i++) {
        y->bias_estimate[i] = s->b[i];
    }
    y->homogeneous_norm = s->norm;
    y->homogeneous_norm_used = s->norm_used;
    y->mode = s->mode;
    y->fault = s->fault;
}
