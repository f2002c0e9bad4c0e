/* The linear plant as a unit of the FMI adapter. */
#include <stdio.h>

#include "fmu_unit.h"

FMU_PRIVATE_BEGIN
#include "linear_plant.h"
FMU_PRIVATE_END

#include "linear_plant_table.h" /* generated: VARIABLES and what they count */

static int prepare(const void *parameters, void *prepared)
{
    (void)parameters;
    (void)prepared;
    return LINEAR_OK;
}

static int initialize(const void *parameters, const void *prepared, void *state, double time, const void *inputs)
{
    (void)prepared;
    (void)time;
    (void)inputs;
    return (int)linear_initialize(parameters, state);
}

static int step(const void *parameters, const void *prepared, void *state, double time, double length,
                const void *inputs)
{
    (void)prepared;
    (void)time;
    return (int)linear_step(parameters, state, inputs, length);
}

static void get_outputs(const void *parameters, const void *prepared, const void *state, void *outputs)
{
    (void)prepared;
    linear_get_outputs(parameters, state, outputs);
}

static int state_is_valid(const void *state)
{
    (void)state; /* nothing in it is an index or a size */
    return 1;
}

static size_t state_count(const void *parameters)
{
    const linear_params *p = parameters;
    return (size_t)p->state_count;
}

static double *states(void *state)
{
    linear_state *s = state;
    return s->x;
}

static int hold(const void *parameters, const void *prepared, void *state, const void *inputs)
{
    (void)prepared;
    return (int)linear_hold(parameters, state, inputs);
}

static void tangent(const void *parameters, const void *prepared, const void *state, const void *inputs,
                    const double *dx, const void *dinputs, void *doutputs)
{
    (void)prepared;
    (void)state;
    linear_tangent(parameters, inputs, dx, dinputs, doutputs);
}

static const char *objection(const void *parameters)
{
    (void)parameters;
    return NULL;
}

/* Write "BEFORE x = (1, 2, 3)AFTER". */
static void explain_state(const char *before, const double *x, int count, const char *after, char *text, size_t size)
{
    size_t length = (size_t)snprintf(text, size, "%s x = (", before);
    for (int i = 0; i < count && length < size; i++) {
        length += (size_t)snprintf(text + length, size - length, i == 0 ? "%.9g" : ", %.9g", x[i]);
    }
    if (length < size) {
        snprintf(text + length, size - length, ")%s", after);
    }
}

static void explain_limits(const linear_params *p, const char *const *names, char *text, size_t size)
{
    for (int j = 0; j < p->input_count; j++) {
        if (p->lower[j] > p->upper[j]) {
            snprintf(text, size, "%s must not exceed %s, found %g and %g", names[VR_lower + j], names[VR_upper + j],
                     p->lower[j], p->upper[j]);
            return;
        }
    }
}

static void explain_inputs(const linear_params *p, const linear_inputs *u, const char *const *names, char *text,
                           size_t size)
{
    for (int j = 0; j < p->input_count; j++) {
        if (!linear_acts(p, u, j)) {
            snprintf(text, size, "inputs must be finite, found %s, %s = (%.17g, %.17g)", names[VR_input + j],
                     names[VR_disturbance + j], u->input[j], u->disturbance[j]);
            return;
        }
    }
}

static fmu_severity explain(int status, const char *const *names, const void *parameters, const void *state,
                            const void *inputs, double length, char *text, size_t size)
{
    const linear_params *p = parameters;
    const linear_state *s = state;
    switch (status) {
    case LINEAR_LIMITS_CROSSED:
        explain_limits(p, names, text, size);
        break;
    case LINEAR_OUTPUT_NOT_FINITE:
        explain_state("start values must give finite outputs, found", p->initial_state, p->state_count, "", text, size);
        break;
    case LINEAR_INPUT_NOT_FINITE:
        explain_inputs(p, inputs, names, text, size);
        break;
    case LINEAR_STEP_TOO_LONG:
        snprintf(text, size,
                 "a communication step must be shorter for the plant's fastest mode to be computed, found %g s",
                 length);
        break;
    default:
        explain_state("the state left the range of numbers,", s->x, p->state_count, " before the step", text, size);
    }
    return FMU_REFUSED;
}

static const fmu_continuous CONTINUOUS = {
    .states = STATES,
    .derivatives = DERIVATIVES,
    .count = state_count,
    .values = states,
    .hold = hold,
    .tangent = tangent,
    .objection = objection,
};

const fmu_unit fmu_the_unit = {
    .name = UNIT_NAME,
    .variables = VARIABLES,
    .variable_count = VARIABLE_COUNT,
    .parameters_size = sizeof(linear_params),
    .inputs_size = sizeof(linear_inputs),
    .outputs_size = sizeof(linear_outputs),
    .prepared_size = 0,
    .state_size = sizeof(linear_state),
    .prepare = prepare,
    .initialize = initialize,
    .step = step,
    .get_outputs = get_outputs,
    .state_is_valid = state_is_valid,
    .explain = explain,
    .continuous = &CONTINUOUS,
};
