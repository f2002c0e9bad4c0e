/* The controller of any linear model as a unit of the FMI adapter. */
#include <math.h>
#include <stdio.h>

#include "fmu_unit.h"

FMU_PRIVATE_BEGIN
#include "homogeneous_controller.h"
#include "sample_clock_fmu.h"
FMU_PRIVATE_END

#include "homogeneous_controller_table.h" /* generated: VARIABLES and what they count */

static int prepare(const void *parameters, void *prepared)
{
    return (int)regulator_prepare(parameters, prepared);
}

static int initialize(const void *parameters, const void *prepared, void *state, double time, const void *inputs)
{
    regulator_initialize(parameters, prepared, state, time, inputs);
    return REGULATOR_OK;
}

static int step(const void *parameters, const void *prepared, void *state, double time, double length,
                const void *inputs)
{
    return regulator_step(parameters, prepared, state, time, length, inputs);
}

static void get_outputs(const void *parameters, const void *prepared, const void *state, void *outputs)
{
    (void)prepared;
    regulator_get_outputs(parameters, state, outputs);
}

static int state_is_valid(const void *state)
{
    (void)state; /* holds no index */
    return 1;
}

static void explain_fault(const char *const *names, const regulator_state *s, const regulator_inputs *u, char *text,
                          size_t size)
{
    size_t length = 0;
    length +=
        (size_t)snprintf(text, size, "fault %s: ",
                         s->fault == REGULATOR_FAULT_NON_FINITE_INPUT ? "non_finite_input" : "non_finite_control");
    if (s->fault != REGULATOR_FAULT_NON_FINITE_INPUT) {
        length += (size_t)snprintf(text + length, size - length, "the command is not finite");
    }
    const char *between = "";
    for (int i = 0; i < 2 * REGULATOR_OUTPUTS && s->fault == REGULATOR_FAULT_NON_FINITE_INPUT && length < size; i++) {
        if (s->bad_inputs & 1u << i) {
            const int j = i % REGULATOR_OUTPUTS;
            const double input = i < REGULATOR_OUTPUTS ? u->measurement[j] : u->setpoint[j];
            const char *name = names[i < REGULATOR_OUTPUTS ? VR_measurement + j : VR_setpoint + j];
            const char *value = isnan(input) ? "nan" : input > 0.0 ? "inf" : "-inf"; /* on every platform */
            length += (size_t)snprintf(text + length, size - length, "%s%s = %s", between, name, value);
            between = ", ";
        }
    }
    if (length < size) {
        snprintf(text + length, size - length, "; the commands are 0 within their limits until reset");
    }
}

static fmu_severity explain(int status, const char *const *names, const void *parameters, const void *state,
                            const void *inputs, double length, char *text, size_t size)
{
    const regulator_params *p = parameters;
    const regulator_state *s = state;
    int i;
    switch (status) {
    case REGULATOR_NEW_FAULT:
        explain_fault(names, s, inputs, text, size);
        return FMU_WARNING;
    case REGULATOR_EXPONENTS:
        snprintf(text, size, "the exponents must fall by 0 or 1 from coordinate to coordinate, to 0");
        break;
    case REGULATOR_INDEFINITE_P:
        i = indefinite_block(p->P, p->state_count);
        snprintf(text, size, "P must be positive definite, found that its leading %d x %d block is not", i, i);
        break;
    case REGULATOR_SINGULAR_T:
        snprintf(text, size, "T must be regular, found a singular matrix");
        break;
    case REGULATOR_BLOCKS_NOT_FINITE:
        snprintf(text, size, "P and the gains must be of moderate size, found block coordinates that are not finite");
        break;
    case REGULATOR_BOUNDS:
        snprintf(text, size, "a_min must not exceed b_max, found a_min = %g and b_max = %g", p->a_min, p->b_max);
        break;
    case REGULATOR_LIMITS:
        i = regulator_contradicting_limit(p);
        snprintf(text, size, "%s must not exceed %s, found %g and %g", names[VR_lower + i], names[VR_upper + i],
                 p->lower[i], p->upper[i]);
        break;
    case REGULATOR_MEASURED_STATES:
        snprintf(text, size, "states that are measured need as many outputs, found %d states and %d outputs",
                 p->state_count, p->output_count);
        break;
    case REGULATOR_ERROR_BOUNDS:
        snprintf(text, size, "q_min must not exceed q_max, found q_min = %g and q_max = %g", p->q_min, p->q_max);
        break;
    case REGULATOR_FILTER_TIME:
        snprintf(text, size, "the Kalman filter is for a sample_time of %g s, found sample_time = %g s",
                 p->filter_sample_time, p->sample_time);
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
    .parameters_size = sizeof(regulator_params),
    .inputs_size = sizeof(regulator_inputs),
    .outputs_size = sizeof(regulator_outputs),
    .prepared_size = sizeof(regulator_prepared),
    .state_size = sizeof(regulator_state),
    .prepare = prepare,
    .initialize = initialize,
    .step = step,
    .get_outputs = get_outputs,
    .state_is_valid = state_is_valid,
    .explain = explain,
    .continuous = NULL,
};
