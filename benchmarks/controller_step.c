/* What a sample of the controller costs: the whole step with each law, and the laws alone.
 *
 * The header start_values.h with LC, ALGORITHM1, EXACT, MEASURED and KALMAN, the start values of each, is generated.
 */
#include "ihc_controller.h"
#include "start_values.h"

#define EXPORTED __attribute__((visibility("default")))

enum { N = IHC_ORDER };

static const ihc_params *const PARAMETERS[] = {&LC, &ALGORITHM1, &EXACT, &MEASURED, &KALMAN};

/* Whole samples on `count` measured states, of which only MEASURED uses the velocities; returns how many were in the
 * stabilizing mode, -1 on failure. */
EXPORTED long whole_steps(int variant, const double (*x)[N], long count)
{
    const ihc_params *p = PARAMETERS[variant];
    ihc_prepared prepared;
    ihc_state state;
    ihc_inputs u = {x[0][0], x[0][1], x[0][2], x[0][3], 0.0};
    long stabilizing = 0;
    if (ihc_prepare(p, &prepared) != IHC_OK) {
        return -1;
    }
    ihc_initialize(p, &prepared, &state, 0.0, &u);
    for (long k = 0; k < count; k++) {
        u.theta = x[k][0];
        u.delta = x[k][1];
        u.theta_dot = x[k][2];
        u.delta_dot = x[k][3];
        if (ihc_step(p, &prepared, &state, (double)k * p->sample_time, p->sample_time, &u) > IHC_NEW_FAULT) {
            return -1;
        }
        stabilizing += state.mode == IHC_MODE_STABILIZING;
    }
    return stabilizing;
}

/* The linear law alone on `count` states; returns the sum of the voltages [V]. */
EXPORTED double linear_law(const double (*x)[N], long count)
{
    double sum = 0.0;
    for (long k = 0; k < count; k++) {
        sum += dot(LC.k_lin, x[k], N);
    }
    return sum;
}

/* The polynomial, Algorithm 1 and the homogeneous law alone; `a_min` in place of the parameter. */
EXPORTED double algorithm1_law(const double (*x)[N], long count, double a_min)
{
    const ihc_params *p = &ALGORITHM1;
    ihc_prepared q;
    double sum = 0.0, voltage = 0.0, interval[2];
    block_state state;
    if (ihc_prepare(p, &q) != IHC_OK) {
        return 0.0;
    }
    interval[0] = a_min;
    interval[1] = p->b_max;
    for (long k = 0; k < count; k++) {
        make_block_state(&q.design, x[k], &state);
        bisection_update(&q.design, &state.polynomial, interval, a_min, p->b_max, p->j_max);
        homogeneous_law(&q.design, interval[1], 0.0, &state, &voltage);
        sum += voltage;
    }
    return sum;
}

/* The same with the exact norm, started from the last one. */
EXPORTED double exact_law(const double (*x)[N], long count, double a_min)
{
    const ihc_params *p = &EXACT;
    ihc_prepared q;
    double sum = 0.0, voltage = 0.0, norm = 1.0;
    block_state state;
    if (ihc_prepare(p, &q) != IHC_OK) {
        return 0.0;
    }
    for (long k = 0; k < count; k++) {
        make_block_state(&q.design, x[k], &state);
        norm = homogeneous_norm(&q.design, &state.polynomial, norm);
        const double r = norm < a_min ? a_min : norm > p->b_max ? p->b_max : norm;
        homogeneous_law(&q.design, r, 0.0, &state, &voltage);
        sum += voltage;
    }
    return sum;
}
