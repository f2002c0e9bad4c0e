/* The controller as a unit of the FMI adapter. */
#include <math.h>
#include <stdio.h>

#include "fmu_unit.h"

FMU_PRIVATE_BEGIN
#include "ihc_controller.h"
#include "sample_clock_fmu.h"
FMU_PRIVATE_END

#include "ihc_controller_table.h" /* generated: VARIABLES and what they count */

static int prepare(const void *parameters, void *prepared)
{
    return (int)ihc_prepare(parameters, prepared);
}

static int initialize(const void *parameters, const void *prepared, void *state, double time, const void *inputs)
{
    ihc_initialize(parameters, prepared, state, time, inputs);
    return IHC_OK;
}

static int step(const void *parameters, const void *prepared, void *state, double time, double length,
                const void *inputs)
{
    return ihc_step(parameters, prepared, state, time, length, inputs);
}

static void get_outputs(const void *parameters, const void *prepared, const void *state, void *outputs)
{
    (void)parameters;
    (void)prepared;
    ihc_get_outputs(state, outputs);
}

static int state_is_valid(const void *state)
{
    (void)state; /* holds no index */
    return 1;
}

static void explain_fault(const char *const *names, const ihc_state *s, const ihc_inputs *u, char *text, size_t size)
{
    const char *const inputs[] = {names[VR_theta], names[VR_delta], names[VR_theta_dot], names[VR_delta_dot],
                                  names[VR_theta_setpoint]};
    const double values[] = {u->theta, u->delta, u->theta_dot, u->delta_dot, u->theta_setpoint};
    char cause[256] = "the command is not finite";
    int length = 0;
    for (int i = 0; i < 5 && s->fault == IHC_FAULT_NON_FINITE_INPUT; i++) {
        if (s->bad_inputs & 1 << i) {
            const char *value = isnan(values[i]) ? "nan" : values[i] > 0.0 ? "inf" : "-inf"; /* on every platform */
            length += snprintf(cause + length, sizeof cause - (size_t)length, "%s%s = %s", length ? ", " : "",
                               inputs[i], value);
        }
    }
    snprintf(text, size, "fault %s: %s; the voltage is 0 V until reset",
             s->fault == IHC_FAULT_NON_FINITE_INPUT ? "non_finite_input" : "non_finite_control", cause);
}

static fmu_severity explain(int status, const char *const *names, const void *parameters, const void *state,
                            const void *inputs, double length, char *text, size_t size)
{
    const ihc_params *p = parameters;
    const ihc_state *s = state;
    int order;
    switch (status) {
    case IHC_NEW_FAULT:
        explain_fault(names, s, inputs, text, size);
        return FMU_WARNING;
    case IHC_INDEFINITE_P:
        order = indefinite_block(p->P, IHC_ORDER);
        snprintf(text, size, "P must be positive definite, found that its leading %d x %d block is not", order, order);
        break;
    case IHC_SINGULAR_PHI:
        snprintf(text, size, "Phi must be regular, found a singular matrix");
        break;
    case IHC_CHAIN_NOT_FINITE:
        snprintf(text, size, "Phi, P, k_lin and row must be of moderate size, found a chain form that is not finite");
        break;
    case IHC_SINGULAR_MODEL:
        snprintf(
            text, size,
            "the square of nominal_coupling must be below nominal_arm_inertia times nominal_pendulum_inertia, found "
            "%g, %g and %g kg.m2",
            p->nominal_coupling, p->nominal_arm_inertia, p->nominal_pendulum_inertia);
        break;
    case IHC_LIMITS:
        snprintf(text, size, "a_min must not exceed b_max, found a_min = %g and b_max = %g", p->a_min, p->b_max);
        break;
    case IHC_ANGLES:
        snprintf(text, size, "capture_angle must not exceed fall_back_angle, found %g and %g rad", p->capture_angle,
                 p->fall_back_angle);
        break;
    case IHC_KALMAN_TIME:
        snprintf(text, size,
                 "velocity_source kalman needs a gain for the sample_time, found kalman_sample_time = %g s and "
                 "sample_time = %g s",
                 p->kalman_sample_time, p->sample_time);
        break;
    default:
        return explain_clock(status, &s->clock, p->sample_time, length, text, size);
    }
    return FMU_REFUSED;
}

const fmu_unit fmu_the_unit = {
    .name = UNIT_NAME,
    .variables = VARIABLES,
    .variable_count = VARIABLE_COUNT,
    .parameters_size = sizeof(ihc_params),
    .inputs_size = sizeof(ihc_inputs),
    .outputs_size = sizeof(ihc_outputs),
    .prepared_size = sizeof(ihc_prepared),
    .state_size = sizeof(ihc_state),
    .prepare = prepare,
    .initialize = initialize,
    .step = step,
    .get_outputs = get_outputs,
    .state_is_valid = state_is_valid,
    .explain = explain,
    .continuous = NULL,
};
