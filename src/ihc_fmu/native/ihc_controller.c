#include "ihc_controller.h"

enum { N = IHC_ORDER };

static const double PI = 3.14159265358979323846;
static const double TURN = 2.0 * 3.14159265358979323846;
static const double BIAS_DECAY = 1e-3;    /* rate at which the Kalman filter forgets the bias [1/s] */
static const double REST_VELOCITY = 0.05; /* the pendulum counts as at rest below this [rad/s] ... */
static const double REST_COSINE = -0.999; /* ... within this of hanging */

/* First-order SMC, u = k x - rho sign(c x). */
static double sliding_mode(const ihc_params *p, const double x[N])
{
    const double surface = dot(p->smc_c, x, N);
    const double switching = surface > 0.0 ? p->smc_rho : surface < 0.0 ? -p->smc_rho : 0.0;
    return dot(p->smc_k, x, N) - switching;
}

/* Super-twisting, u = k x + w; v stands still where the command is beyond the limit. */
static double super_twisting_voltage(const ihc_params *p, const ihc_prepared *q, ihc_state *s, const double x[N])
{
    double moved;
    const double w =
        super_twisting(dot(p->sta_c, x, N), s->integral, p->sta_rate, p->sample_time, q->ahead > 0.0, &moved);
    const double command = dot(p->sta_k, x, N) + w;
    const double wanted = p->compensate_disturbance ? command - s->disturbance : command;
    if (!winds_up(wanted, moved - s->integral, -p->voltage_limit, p->voltage_limit)) {
        s->integral = flushed(moved, LEAST);
    }
    return command;
}

/* ---- Nominal model, eq. (5) in lumped numbers -------------------------------------------------------------------- */

static pendulum_coefficients nominal_pendulum(const ihc_params *m)
{
    pendulum_coefficients c;
    c.J_11 = m->nominal_arm_inertia;
    c.J_22 = m->nominal_pendulum_inertia;
    c.zeta_4 = m->nominal_swing_inertia;
    c.varpi_2 = m->nominal_coupling;
    c.gravity = m->nominal_gravity_torque;
    c.D_r = m->nominal_arm_damping + m->nominal_motor_damping;
    c.T_r = 0.0;
    c.D_p = m->nominal_pendulum_damping;
    return c;
}

/* The voltage under which the arm accelerates by theta_ddot: inverse dynamics. */
static double voltage_for(const ihc_params *m, const pendulum_coefficients *c, double delta, double theta_dot,
                          double delta_dot, double theta_ddot)
{
    return pendulum_arm_torque(c, c->D_r, delta, theta_dot, delta_dot, theta_ddot) / m->nominal_torque_per_volt;
}

/* The nominal pendulum under a held torque of its motor. */
typedef struct {
    const pendulum_coefficients *c;
    double torque;
} held_pendulum;

static void held_rate(const void *model, const double x[PENDULUM_MOST_STATES], double dx[PENDULUM_MOST_STATES])
{
    const held_pendulum *pendulum = model;
    dx[0] = x[2];
    dx[1] = x[3];
    pendulum_accelerations(pendulum->c, pendulum->c->D_r, x[1], x[2], x[3], pendulum->torque, 0.0, &dx[2], &dx[3]);
    dx[4] = 0.0; /* no motor's state */
}

/* The state after a sample under a held voltage: one classical Runge-Kutta step. */
static void predict(const ihc_params *m, const ihc_prepared *q, const double x[4], double voltage, double y[4])
{
    const held_pendulum pendulum = {&q->pendulum, m->nominal_torque_per_volt * voltage};
    double state[PENDULUM_MOST_STATES] = {x[0], x[1], x[2], x[3], 0.0};
    pendulum_rk4_step(held_rate, &pendulum, state, m->sample_time);
    for (int i = 0; i < 4; i++) {
        y[i] = state[i];
    }
}

/* ---- Estimators -------------------------------------------------------------------------------------------------- */

enum { BISECTIONS = 100 };

/* Steady-state Kalman gains of one angle with white acceleration, see velocity.alpha_beta_gains. */
static void alpha_beta_gains(double acceleration_noise, double resolution, double h, double gains[2])
{
    const double variance = resolution * resolution / 12.0 * (1e-3 / h);
    const double index = acceleration_noise * (h * h * h) / variance;
    double low = 0.0, high = fmin(sqrt(index), 3.0 - sqrt(3.0)); /* where alpha is 1 */
    for (int k = 0; k < BISECTIONS; k++) {
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
    predict(p, q, s->observed, s->voltage, y);
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
    predict(p, q, s->observed, s->voltage + s->disturbance, y);
    const double bias = s->bias * q->bias_decay;
    const double count = p->observer_resolution, weight = p->kalman_count_weight;
    const double e_1 = weighed(theta - y[0], count, weight), e_2 = weighed(delta - (y[1] + bias), count, weight);
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

/* The design in chain coordinates: z_i' = z_{i+1}, z_n' = u + row x. */
static int to_chain(const ihc_params *p, block_design *d)
{
    int entry = 0;
    d->mu = p->mu;
    for (int i = 0; i < N; i++) {
        d->K[i] = p->k_lin[i];
        d->K_0[i] = -p->row[i];
        d->B[i] = i == N - 1 ? 1.0 : 0.0;
        for (int j = 0; j < N; j++) {
            d->T[i * N + j] = p->Phi[i][j];
            d->N[i * N + j] = j == i + 1 ? 1.0 : 0.0;
        }
        for (int j = i; j < N; j++) {
            d->Pz[i * N + j] = d->Pz[j * N + i] = p->P[entry++];
        }
    }
    return prepare_block_design(d);
}

ihc_status ihc_prepare(const ihc_params *p, ihc_prepared *q)
{
    if (indefinite_block(p->P, N)) {
        return IHC_INDEFINITE_P;
    }
    if (!to_chain(p, &q->design)) {
        return IHC_SINGULAR_PHI;
    }
    if (!block_design_is_finite(&q->design)) {
        return IHC_CHAIN_NOT_FINITE;
    }
    if (p->a_min > p->b_max) {
        return IHC_LIMITS;
    }
    q->pendulum = nominal_pendulum(p);
    if (!pendulum_is_regular(&q->pendulum)) {
        return IHC_SINGULAR_MODEL;
    }
    if (p->capture_angle > p->fall_back_angle) {
        return IHC_ANGLES;
    }
    if (p->velocity_source == IHC_VELOCITY_SOURCE_KALMAN
        && fabs(p->kalman_sample_time - p->sample_time) > 1e-9 * p->sample_time) {
        return IHC_KALMAN_TIME;
    }
    q->decay = flushed(exp(-p->velocity_filter_cutoff * p->sample_time), LEAST);
    q->bias_decay = exp(-BIAS_DECAY * p->sample_time);
    alpha_beta_gains(p->observer_acceleration_noise, p->observer_resolution, p->sample_time, q->observer_gain);
    q->search = (norm_search){p->norm_solver == IHC_NORM_SOLVER_EXACT, p->a_min, p->b_max, p->j_max};
    q->ahead = p->discretization == IHC_DISCRETIZATION_SEMI_IMPLICIT ? p->sample_time : 0.0;
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
    const int measured = p->velocity_source == IHC_VELOCITY_SOURCE_INPUTS;
    x[0] = u->theta;
    x[1] = wrap(u->delta);
    x[2] = measured ? u->theta_dot : 0.0;
    x[3] = measured ? u->delta_dot : 0.0;
}

/* The arm's angle less its set-point; x itself to the last bit where that is 0. */
static void make_deviation(const ihc_inputs *u, double x[N])
{
    if (u->theta_setpoint != 0.0) {
        x[0] -= u->theta_setpoint;
    }
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
    if (p->velocity_source == IHC_VELOCITY_SOURCE_INPUTS) {
        x[2] = u->theta_dot;
        x[3] = u->delta_dot;
    } else if (p->velocity_source == IHC_VELOCITY_SOURCE_KALMAN) {
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
        if (s->mode == IHC_MODE_STABILIZING && fabs(x[1]) <= p->fall_back_angle) {
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
        return IHC_MODE_IDLE;
    }
    if (mode == IHC_MODE_STABILIZING && fabs(delta) <= p->fall_back_angle) {
        return IHC_MODE_STABILIZING;
    }
    if (level < p->capture_level && fabs(delta) < p->capture_angle && fabs(delta_dot) < p->capture_velocity) {
        return IHC_MODE_STABILIZING;
    }
    return p->swing_up_enabled ? IHC_MODE_SWING_UP : IHC_MODE_IDLE;
}

static double swing_up_voltage(const ihc_params *p, const ihc_prepared *q, const double x[N])
{
    const double c = cos(x[1]);
    const double energy = 0.5 * p->nominal_pendulum_inertia * x[3] * x[3]
        + p->nominal_gravity_torque * (c - 1.0 - p->swing_up_energy_offset);
    const int at_rest = c < REST_COSINE && fabs(x[3]) < REST_VELOCITY;
    const double direction = at_rest ? 1.0 : clamp(x[3] * c / p->swing_up_velocity_scale, -1.0, 1.0);
    const double limit = p->swing_up_acceleration_limit;
    double wanted = clamp(-p->swing_up_energy_gain * energy * direction, -limit, limit);
    wanted -= p->swing_up_arm_stiffness * x[0] + p->swing_up_arm_damping * x[2];
    return voltage_for(p, &q->pendulum, x[1], x[2], x[3], wanted);
}

static double stabilizing_voltage(const ihc_params *p, const ihc_prepared *q, ihc_state *s, const double x[N],
                                  const block_state *chain)
{
    double voltage[1];
    if (p->law == IHC_LAW_LC) {
        return dot(p->k_lin, x, N);
    }
    if (p->law == IHC_LAW_SMC) {
        return sliding_mode(p, x);
    }
    if (p->law == IHC_LAW_STA) {
        return super_twisting_voltage(p, q, s, x);
    }
    s->norm_used = norm_in_law(&q->design, &q->search, &chain->polynomial, s->norm, s->interval);
    homogeneous_law(&q->design, s->norm_used, q->ahead, chain, voltage);
    return voltage[0];
}

static ihc_status fail(ihc_state *s, int32_t fault)
{
    const int known = s->mode == IHC_MODE_FAULT;
    s->voltage = 0.0;
    s->norm_used = 1.0;
    if (known) {
        return IHC_OK;
    }
    s->mode = IHC_MODE_FAULT;
    s->fault = fault;
    return IHC_NEW_FAULT;
}

static int32_t bad_inputs(const ihc_inputs *u)
{
    return (isfinite(u->theta) ? 0 : 1) | (isfinite(u->delta) ? 0 : 2) | (isfinite(u->theta_dot) ? 0 : 4)
        | (isfinite(u->delta_dot) ? 0 : 8) | (isfinite(u->theta_setpoint) ? 0 : 16);
}

static ihc_status sample(const ihc_params *p, const ihc_prepared *q, ihc_state *s, const ihc_inputs *u)
{
    double x[N], command = 0.0;
    block_state chain;
    const int32_t bad = bad_inputs(u);
    if (bad) {
        s->bad_inputs = s->mode == IHC_MODE_FAULT ? s->bad_inputs : bad;
        return fail(s, IHC_FAULT_NON_FINITE_INPUT);
    }
    if (s->mode == IHC_MODE_FAULT) {
        return IHC_OK;
    }
    const ihc_inputs measured = {flushed(u->theta, LEAST), flushed(u->delta, LEAST), flushed(u->theta_dot, LEAST),
                                 flushed(u->delta_dot, LEAST), flushed(u->theta_setpoint, LEAST)};
    if (s->primed) {
        estimate(p, q, s, &measured, x);
    } else {
        prime(p, s, &measured, x);
    }
    make_deviation(&measured, x);
    if (!isfinite(x[0] + x[1] + x[2] + x[3])) {
        return fail(s, IHC_FAULT_NON_FINITE_CONTROL);
    }
    make_block_state(&q->design, x, &chain);
    s->norm = homogeneous_norm(&q->design, &chain.polynomial, s->norm);
    const int32_t earlier = s->mode;
    s->mode = next_mode(p, earlier, squared_norm(&q->design, &chain.polynomial, 1.0), x[1], x[3]);
    if (s->mode == IHC_MODE_STABILIZING && earlier != IHC_MODE_STABILIZING) {
        s->interval[0] = p->a_min;
        s->interval[1] = p->b_max;
        if (p->velocity_source == IHC_VELOCITY_SOURCE_FILTER) {
            x[0] = measured.theta;
            x[1] = wrap(measured.delta);
            x[2] = s->theta_dot;
            x[3] = s->delta_dot;
            make_deviation(&measured, x);
        }
        make_block_state(&q->design, x, &chain);
        s->norm = homogeneous_norm(&q->design, &chain.polynomial, s->norm);
    }
    s->theta_dot = x[2];
    s->delta_dot = x[3];
    s->norm_used = 1.0;
    if (p->law != IHC_LAW_STA || s->mode != IHC_MODE_STABILIZING || earlier != IHC_MODE_STABILIZING) {
        s->integral = 0.0;
    }
    if (s->mode == IHC_MODE_SWING_UP) {
        command = swing_up_voltage(p, q, x);
    } else if (s->mode == IHC_MODE_STABILIZING) {
        command = stabilizing_voltage(p, q, s, x, &chain);
        if (p->compensate_disturbance) {
            command -= s->disturbance;
        }
    }
    if (!isfinite(command)) {
        return fail(s, IHC_FAULT_NON_FINITE_CONTROL);
    }
    s->voltage = clamp(command, -p->voltage_limit, p->voltage_limit);
    return IHC_OK;
}

void ihc_initialize(const ihc_params *p, const ihc_prepared *q, ihc_state *s, double time, const ihc_inputs *u)
{
    static const ihc_state zero;
    *s = zero;
    s->clock.start_time = time;
    s->mode = IHC_MODE_IDLE;
    s->fault = IHC_FAULT_NONE;
    s->norm_used = 1.0;
    s->interval[0] = p->a_min;
    s->interval[1] = p->b_max;
    if (!bad_inputs(u)) {
        double x[N];
        block_state chain;
        first_estimate(p, u, x);
        make_deviation(u, x);
        make_block_state(&q->design, x, &chain);
        s->norm = homogeneous_norm(&q->design, &chain.polynomial, 1.0);
    }
}

int ihc_step(const ihc_params *p, const ihc_prepared *q, ihc_state *s, double time, double step, const ihc_inputs *u)
{
    double last;
    int status = samples_until(&s->clock, p->sample_time, time, step, &last);
    if (status != CLOCK_OK) {
        return status;
    }
    while ((double)s->clock.next_sample <= last) { /* as often as the step has samples, at most */
        s->clock.next_sample++;
        if (sample(p, q, s, u) != IHC_OK) {
            status = IHC_NEW_FAULT;
        }
    }
    return status == CLOCK_OK ? note_held_inputs(&s->clock, p->sample_time, step) : status;
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
