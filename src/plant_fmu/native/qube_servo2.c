#include "qube_servo2.h"

#include <math.h>

static const double PI = 3.14159265358979323846;

static int has_inductance(const qube_params *p)
{
    return p->motor_model == QUBE_MOTOR_MODEL_INDUCTANCE;
}

qube_status qube_prepare(const qube_params *p, qube_prepared *q)
{
    volatile const int divisor = p->encoder_counts > 0 ? p->encoder_counts : 1; /* compilers divide before they know */
    const double zeta = p->m_p * (p->L_p * p->L_p);
    pendulum_coefficients *c = &q->pendulum;
    c->J_11 = p->J_r + p->m_p * (p->L_r * p->L_r);
    c->J_22 = p->J_p + zeta / 4.0;
    c->zeta_4 = zeta / 4.0;
    c->varpi_2 = p->m_p * p->L_p * p->L_r / 2.0;
    c->gravity = p->m_p * p->g_p * p->L_p / 2.0;
    c->D_r = p->D_r;
    c->T_r = p->T_r;
    c->D_p = p->D_p;
    q->k_e = p->back_emf ? p->k_m : 0.0;
    q->longest_substep = p->solver_step;
    if (has_inductance(p)) {
        q->longest_substep = fmin(q->longest_substep, p->L_m / p->R_m / (double)QUBE_STEPS_PER_TIME_CONSTANT);
    }
    q->resolution = 2.0 * PI / divisor;
    return pendulum_is_regular(c) ? QUBE_OK : QUBE_SINGULAR;
}

/* The plant under held inputs. */
typedef struct {
    const qube_params *p;
    const qube_prepared *q;
    double voltage, tau_p;
} held_plant;

/* x' = f(x, V, tau_p) for the static motor (eq. (5), section III). */
PENDULUM_INLINE void static_rate(const void *model, const double x[QUBE_STATES], double dx[QUBE_STATES])
{
    const held_plant *h = model;
    const pendulum_coefficients *c = &h->q->pendulum;
    const double tau = h->p->k_m * (h->voltage - h->q->k_e * x[2]) / h->p->R_m;
    dx[0] = x[2];
    dx[1] = x[3];
    pendulum_accelerations(c, pendulum_damping(c, x[2]), x[1], x[2], x[3], tau, h->tau_p, &dx[2], &dx[3]);
    dx[4] = 0.0;
}

/* The same with inductance. */
static void inductance_rate(const void *model, const double x[QUBE_STATES], double dx[QUBE_STATES])
{
    const held_plant *h = model;
    const pendulum_coefficients *c = &h->q->pendulum;
    dx[0] = x[2];
    dx[1] = x[3];
    pendulum_accelerations(c, pendulum_damping(c, x[2]), x[1], x[2], x[3], h->p->k_m * x[4], h->tau_p, &dx[2], &dx[3]);
    dx[4] = (h->voltage - h->p->R_m * x[4] - h->q->k_e * x[2]) / h->p->L_m;
}

/* x' under the inputs that were held last. */
static void rate_of(const qube_params *p, const qube_prepared *q, const qube_state *s, double dx[QUBE_STATES])
{
    const held_plant plant = {p, q, s->applied_voltage, s->applied_torque};
    if (has_inductance(p)) {
        inductance_rate(&plant, s->x, dx);
    } else {
        static_rate(&plant, s->x, dx);
    }
}

/* Derivative of x' in the direction of dx, dvoltage and dtorque; x' itself is given as `rate`. */
static void rate_tangent(const qube_params *p, const qube_prepared *q, const double x[QUBE_STATES],
                         double pendulum_torque, const double rate[QUBE_STATES], const double dx[QUBE_STATES],
                         double dvoltage, double dtorque, double out[QUBE_STATES])
{
    const int inductance = has_inductance(p);
    const pendulum_coefficients *e = &q->pendulum;
    const double s = sin(x[1]), k = cos(x[1]), ds = k * dx[1], dk = -s * dx[1];
    const double v = x[2], w = x[3], dv = dx[2], dw = dx[3];
    const double j_11 = e->J_11 + e->zeta_4 * s * s, dj_11 = 2.0 * e->zeta_4 * s * ds;
    const double j_12 = -e->varpi_2 * k, dj_12 = -e->varpi_2 * dk;
    const double sk = e->zeta_4 * s * k, dsk = e->zeta_4 * (ds * k + s * dk);
    const double determinant = j_11 * e->J_22 - j_12 * j_12, ddeterminant = dj_11 * e->J_22 - 2.0 * j_12 * dj_12;
    /* M(q) q'' = r, so r follows from the accelerations */
    const double r_1 = j_11 * rate[2] + j_12 * rate[3];
    const double r_2 = pendulum_torque + sk * v * v - e->D_p * w + e->gravity * s;
    const double dtau = inductance ? p->k_m * dx[4] : p->k_m * (dvoltage - q->k_e * dv) / p->R_m;
    const double slow = fabs(v) + PENDULUM_FRICTION_SPEED,
                 slope = e->D_r + e->T_r * PENDULUM_FRICTION_SPEED / (slow * slow);
    const double dr_1 = dtau - 2.0 * (dsk * w + sk * dw) * v - (2.0 * sk * w + slope) * dv
        - e->varpi_2 * (ds * w * w + 2.0 * s * w * dw);
    const double dr_2 = dtorque + dsk * v * v + 2.0 * sk * v * dv - e->D_p * dw + e->gravity * ds;
    out[0] = dv;
    out[1] = dw;
    out[2] = (e->J_22 * dr_1 - j_12 * dr_2 - dj_12 * r_2 - rate[2] * ddeterminant) / determinant;
    out[3] = (j_11 * dr_2 + dj_11 * r_2 - j_12 * dr_1 - dj_12 * r_1 - rate[3] * ddeterminant) / determinant;
    out[4] = inductance ? (dvoltage - p->R_m * dx[4] - q->k_e * dv) / p->L_m : 0.0;
}

/* SplitMix64 (Steele, Lea and Flood, OOPSLA 2014). */
static uint64_t next_random(uint64_t *state)
{
    uint64_t z = (*state += UINT64_C(0x9E3779B97F4A7C15));
    z = (z ^ (z >> 30)) * UINT64_C(0xBF58476D1CE4E5B9);
    z = (z ^ (z >> 27)) * UINT64_C(0x94D049BB133111EB);
    return z ^ (z >> 31);
}

/* A standard normal number by the Box-Muller transformation of two draws. */
static double next_gaussian(uint64_t *state)
{
    const uint64_t first = next_random(state);
    const uint64_t second = next_random(state);
    const double radius = sqrt(-2.0 * log((double)((first >> 11) + 1) * 0x1p-53));
    return radius * cos(2.0 * PI * ((double)(second >> 11) * 0x1p-53));
}

/* What an encoder reports: r floor(angle/r + offset), r = 2 pi/counts. */
static double quantize(const qube_params *p, const qube_prepared *q, double angle, double offset)
{
    return p->encoder_counts > 0 ? q->resolution * floor(angle / q->resolution + offset) : angle;
}

static double measure(const qube_params *p, const qube_prepared *q, uint64_t *random_state, double angle, double offset)
{
    if (p->noise_std != 0.0) {
        angle += p->noise_std * next_gaussian(random_state);
    }
    return quantize(p, q, angle, offset);
}

static void append_measurement(const qube_params *p, const qube_prepared *q, qube_state *s)
{
    const int32_t capacity = QUBE_MAX_DELAY + 1;
    while (s->count > s->delay_steps) {
        s->oldest = (s->oldest + 1) % capacity;
        s->count--;
    }
    double *entry = s->delay_line[(s->oldest + s->count) % capacity];
    entry[0] = measure(p, q, &s->random_state, s->x[0], p->theta_encoder_offset);
    entry[1] = measure(p, q, &s->random_state, s->x[1], p->delta_encoder_offset);
    s->count++;
}

qube_status qube_initialize(const qube_params *p, const qube_prepared *q, qube_state *s)
{
    static const qube_state zero;
    qube_outputs y;
    *s = zero;
    s->x[0] = p->theta_0;
    s->x[1] = p->delta_0;
    s->x[2] = p->theta_dot_0;
    s->x[3] = p->delta_dot_0;
    s->random_state = (uint64_t)p->noise_seed;
    append_measurement(p, q, s);
    qube_get_outputs(s, &y);
    qube_derive_outputs(p, q, s, &y);
    return isfinite(y.theta + y.delta + y.theta_dot + y.delta_dot + y.theta_encoder + y.delta_encoder + y.current
                    + y.motor_torque + y.energy + y.theta_ddot + y.delta_ddot + y.current_dot)
        ? QUBE_OK
        : QUBE_OUTPUT_NOT_FINITE;
}

/* Take the delay as a number of communication steps, which may then not change any more. */
static qube_status count_delay(const qube_params *p, double step, int32_t *delay_steps)
{
    const double ratio = p->measurement_delay / step;
    if (ratio > (double)QUBE_MAX_DELAY + 0.5) {
        return QUBE_DELAY_TOO_LONG;
    }
    *delay_steps = (int32_t)nearbyint(fmin(ratio, (double)QUBE_MAX_DELAY + 1.0));
    return fabs(ratio - *delay_steps) > 1e-6 ? QUBE_DELAY_NOT_MULTIPLE : QUBE_OK;
}

static double clamp(double value, double limit)
{
    const double low = value > -limit ? value : -limit;
    return low < limit ? low : limit;
}

static double flushed(double value)
{
    return fabs(value) > 0.0 && fabs(value) < QUBE_LEAST ? 0.0 : value;
}

/* The smallest number of equal substeps of `step` that are not longer than `largest`, up to rounding. */
static double substeps(double step, double largest)
{
    const double count = -floor(-(step / largest) * (1.0 - 1e-9));
    return count > 1.0 ? count : 1.0;
}

qube_status qube_step(const qube_params *p, const qube_prepared *q, qube_state *s, const qube_inputs *u, double step)
{
    int32_t delay_steps = 0;
    if (!isfinite(u->voltage + u->disturbance_voltage + u->pendulum_torque)) {
        return QUBE_INPUT_NOT_FINITE;
    }
    const double count = substeps(step, q->longest_substep);
    if (count > (double)QUBE_MAX_SUBSTEPS) {
        return QUBE_TOO_MANY_SUBSTEPS;
    }
    if (p->measurement_delay != 0.0) {
        if (s->delayed_step != 0.0 && fabs(step - s->delayed_step) > 1e-6 * step) {
            return QUBE_STEP_CHANGED;
        }
        const qube_status status = count_delay(p, step, &delay_steps);
        if (status != QUBE_OK) {
            return status;
        }
    }
    const double voltage = flushed(clamp(u->voltage + u->disturbance_voltage, p->voltage_limit));
    const double tau_p = flushed(u->pendulum_torque);
    const double h = step / count;
    const int steps = (int)fmin(count, (double)QUBE_MAX_SUBSTEPS);
    const held_plant plant = {p, q, voltage, tau_p};
    double x[QUBE_STATES], sum = 0.0;
    for (int i = 0; i < QUBE_STATES; i++) {
        x[i] = s->x[i];
    }
    for (int i = 0; i < steps; i++) {
        if (has_inductance(p)) {
            pendulum_rk4_step(inductance_rate, &plant, x, h);
        } else {
            pendulum_rk4_step(static_rate, &plant, x, h);
        }
    }
    for (int i = 0; i < QUBE_STATES; i++) {
        sum += x[i] * x[i]; /* as in the energy */
    }
    if (!isfinite(sum)) {
        return QUBE_DIVERGED;
    }
    for (int i = 0; i < QUBE_STATES; i++) {
        s->x[i] = flushed(x[i]);
    }
    s->applied_voltage = voltage;
    s->applied_torque = tau_p;
    if (p->measurement_delay != 0.0) {
        s->delay_steps = delay_steps;
        s->delayed_step = step;
    }
    append_measurement(p, q, s);
    return QUBE_OK;
}

void qube_get_outputs(const qube_state *s, qube_outputs *y)
{
    y->theta = s->x[0];
    y->delta = s->x[1];
    y->theta_dot = s->x[2];
    y->delta_dot = s->x[3];
    y->theta_encoder = s->delay_line[s->oldest][0];
    y->delta_encoder = s->delay_line[s->oldest][1];
}

void qube_derive_outputs(const qube_params *p, const qube_prepared *q, const qube_state *s, qube_outputs *y)
{
    double rate[QUBE_STATES];
    rate_of(p, q, s, rate);
    y->current = has_inductance(p) ? s->x[4] : (s->applied_voltage - q->k_e * s->x[2]) / p->R_m;
    y->motor_torque = p->k_m * y->current;
    y->energy = pendulum_energy(&q->pendulum, s->x[1], s->x[2], s->x[3]);
    y->theta_ddot = rate[2];
    y->delta_ddot = rate[3];
    y->current_dot = rate[4];
}

int qube_state_count(const qube_params *p)
{
    return has_inductance(p) ? QUBE_STATES : QUBE_STATES - 1;
}

qube_status qube_hold(const qube_params *p, const qube_prepared *q, qube_state *s, const qube_inputs *u)
{
    double *entry = s->delay_line[s->oldest];
    if (!isfinite(u->voltage + u->disturbance_voltage + u->pendulum_torque)) {
        return QUBE_INPUT_NOT_FINITE;
    }
    s->applied_voltage = flushed(clamp(u->voltage + u->disturbance_voltage, p->voltage_limit));
    s->applied_torque = flushed(u->pendulum_torque);
    entry[0] = quantize(p, q, s->x[0], p->theta_encoder_offset);
    entry[1] = quantize(p, q, s->x[1], p->delta_encoder_offset);
    return QUBE_OK;
}

void qube_tangent(const qube_params *p, const qube_prepared *q, const qube_state *s, const qube_inputs *u,
                  const double dx[QUBE_STATES], const qube_inputs *du, qube_outputs *dy)
{
    const pendulum_coefficients *e = &q->pendulum;
    const double free = fabs(u->voltage + u->disturbance_voltage) < p->voltage_limit ? 1.0 : 0.0;
    const double dvoltage = free * (du->voltage + du->disturbance_voltage);
    const double seen = p->encoder_counts == 0 ? 1.0 : 0.0;
    const double sine = sin(s->x[1]), cosine = cos(s->x[1]), v = s->x[2], w = s->x[3];
    double rate[QUBE_STATES], drate[QUBE_STATES];
    rate_of(p, q, s, rate);
    rate_tangent(p, q, s->x, s->applied_torque, rate, dx, dvoltage, du->pendulum_torque, drate);
    dy->theta = dx[0];
    dy->delta = dx[1];
    dy->theta_dot = dx[2];
    dy->delta_dot = dx[3];
    dy->theta_encoder = seen * dx[0];
    dy->delta_encoder = seen * dx[1];
    dy->current = has_inductance(p) ? dx[4] : (dvoltage - q->k_e * dx[2]) / p->R_m;
    dy->motor_torque = p->k_m * dy->current;
    dy->energy = (e->zeta_4 * sine * cosine * v * v + e->varpi_2 * sine * v * w - e->gravity * sine) * dx[1]
        + ((e->J_11 + e->zeta_4 * sine * sine) * v - e->varpi_2 * cosine * w) * dx[2]
        + (e->J_22 * w - e->varpi_2 * cosine * v) * dx[3];
    dy->theta_ddot = drate[2];
    dy->delta_ddot = drate[3];
    dy->current_dot = drate[4];
}

int qube_state_is_valid(const qube_state *s)
{
    const int32_t capacity = QUBE_MAX_DELAY + 1;
    return s->oldest >= 0 && s->oldest < capacity && s->count >= 1 && s->count <= capacity && s->delay_steps >= 0
        && s->delay_steps < capacity;
}
