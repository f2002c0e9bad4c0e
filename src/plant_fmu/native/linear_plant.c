#include "linear_plant.h"

#include <math.h>

/* 0 for what is too small to count. */
static double flushed(double value)
{
    return fabs(value) > 0.0 && fabs(value) < LINEAR_LEAST ? 0.0 : value;
}

/* What a sensor reports. */
static double counted(double value, double resolution, double offset)
{
    volatile const double divisor = resolution > 0.0 ? resolution : 1.0; /* compilers divide before they know its use */
    return resolution > 0.0 ? resolution * floor(value / divisor + offset) : value;
}

/* total + row' entries, added from the first to the last term. */
static double add_products(double total, const double *row, const double *entries, int count)
{
    for (int k = 0; k < count; k++) {
        total += row[k] * entries[k];
    }
    return total;
}

static void deviation_of(const linear_params *p, const double x[LINEAR_STATES], double deviation[LINEAR_STATES])
{
    for (int i = 0; i < p->state_count; i++) {
        deviation[i] = x[i] - p->state_equilibrium[i];
    }
}

static void outputs_at(const linear_params *p, const double x[LINEAR_STATES], const double w[LINEAR_INPUTS],
                       linear_outputs *y)
{
    static const linear_outputs zero;
    double deviation[LINEAR_STATES] = {0.0};
    deviation_of(p, x, deviation);
    *y = zero;
    for (int i = 0; i < p->output_count; i++) {
        const double true_output = p->output_equilibrium[i] + add_products(0.0, p->C[i], deviation, p->state_count);
        y->output[i] = counted(true_output + p->bias[i], p->resolution[i], p->resolution_offset[i]);
    }
    for (int i = 0; i < p->state_count; i++) {
        const double of_state = add_products(0.0, p->A[i], deviation, p->state_count);
        y->state[i] = x[i];
        y->derivative[i] = add_products(of_state, p->B[i], w, p->input_count);
    }
}

static int outputs_are_finite(const linear_outputs *y)
{
    int finite = 1;
    for (int i = 0; i < LINEAR_OUTPUTS; i++) {
        finite = finite && isfinite(y->output[i]);
    }
    for (int i = 0; i < LINEAR_STATES; i++) {
        finite = finite && isfinite(y->state[i]) && isfinite(y->derivative[i]);
    }
    return finite;
}

linear_status linear_initialize(const linear_params *p, linear_state *s)
{
    static const linear_state zero;
    linear_outputs y;
    for (int j = 0; j < p->input_count; j++) {
        if (p->lower[j] > p->upper[j]) {
            return LINEAR_LIMITS_CROSSED;
        }
    }
    *s = zero;
    for (int i = 0; i < p->state_count; i++) {
        s->x[i] = p->initial_state[i];
    }
    outputs_at(p, s->x, s->w, &y);
    return outputs_are_finite(&y) ? LINEAR_OK : LINEAR_OUTPUT_NOT_FINITE;
}

static void take_over(const linear_params *p, linear_state *s, const double x[LINEAR_STATES],
                      const double w[LINEAR_INPUTS])
{
    for (int i = 0; i < p->state_count; i++) {
        s->x[i] = x[i];
    }
    for (int j = 0; j < p->input_count; j++) {
        s->w[j] = w[j];
    }
}

/* w of one input, not flushed. */
static double acting(const linear_params *p, const linear_inputs *u, int j)
{
    const double driven = u->input[j] + u->disturbance[j];
    const double above = driven > p->lower[j] ? driven : p->lower[j];
    const double limited = above < p->upper[j] ? above : p->upper[j];
    return limited - p->input_equilibrium[j];
}

int linear_acts(const linear_params *p, const linear_inputs *u, int j)
{
    return isfinite(u->input[j] + u->disturbance[j]) && isfinite(acting(p, u, j));
}

static linear_status act(const linear_params *p, const linear_inputs *u, double w[LINEAR_INPUTS])
{
    for (int j = 0; j < p->input_count; j++) {
        if (!linear_acts(p, u, j)) {
            return LINEAR_INPUT_NOT_FINITE;
        }
        w[j] = flushed(acting(p, u, j));
    }
    return LINEAR_OK;
}

linear_status linear_step(const linear_params *p, linear_state *s, const linear_inputs *u, double step)
{
    static const linear_held none;
    linear_held other;
    const linear_held *held = &s->held;
    linear_outputs y;
    double deviation[LINEAR_STATES] = {0.0}, x[LINEAR_STATES] = {0.0}, w[LINEAR_INPUTS] = {0.0};
    if (act(p, u, w) != LINEAR_OK) {
        return LINEAR_INPUT_NOT_FINITE;
    }
    if (step != s->held_step) {
        other = none; /* what is saved has no entries by chance */
        held = &other;
        if (!linear_hold_inputs(p->A, p->B, p->state_count, p->input_count, step, &other)) {
            return LINEAR_STEP_TOO_LONG;
        }
    }
    deviation_of(p, s->x, deviation);
    for (int i = 0; i < p->state_count; i++) {
        const double of_state = add_products(0.0, held->E[i], deviation, p->state_count);
        x[i] = flushed(s->x[i] + add_products(of_state, held->G[i], w, p->input_count));
    }
    outputs_at(p, x, w, &y);
    if (!outputs_are_finite(&y)) {
        return LINEAR_DIVERGED;
    }
    take_over(p, s, x, w);
    if (held == &other) {
        s->held_step = step;
        s->held = other;
    }
    return LINEAR_OK;
}

void linear_get_outputs(const linear_params *p, const linear_state *s, linear_outputs *y)
{
    outputs_at(p, s->x, s->w, y);
}

linear_status linear_hold(const linear_params *p, linear_state *s, const linear_inputs *u)
{
    double w[LINEAR_INPUTS] = {0.0};
    const linear_status status = act(p, u, w);
    if (status == LINEAR_OK) {
        take_over(p, s, s->x, w);
    }
    return status;
}

void linear_tangent(const linear_params *p, const linear_inputs *u, const double dx[LINEAR_STATES],
                    const linear_inputs *du, linear_outputs *dy)
{
    static const linear_outputs zero;
    double dw[LINEAR_INPUTS] = {0.0};
    for (int j = 0; j < p->input_count; j++) {
        const double driven = u->input[j] + u->disturbance[j];
        dw[j] = driven > p->lower[j] && driven < p->upper[j] ? du->input[j] + du->disturbance[j] : 0.0;
    }
    *dy = zero;
    for (int i = 0; i < p->output_count; i++) {
        dy->output[i] = p->resolution[i] > 0.0 ? 0.0 : add_products(0.0, p->C[i], dx, p->state_count);
    }
    for (int i = 0; i < p->state_count; i++) {
        dy->state[i] = dx[i];
        dy->derivative[i] = add_products(add_products(0.0, p->A[i], dx, p->state_count), p->B[i], dw, p->input_count);
    }
}
