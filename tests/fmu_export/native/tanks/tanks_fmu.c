/* The tanks as a unit of the FMI adapter. */
#include <math.h>
#include <stdio.h>

#include "fmu_unit.h"

FMU_PRIVATE_BEGIN
#include "tanks.h"
FMU_PRIVATE_END

#include "tanks_table.h" /* generated */

static int prepare(const void *parameters, void *prepared)
{
    (void)prepared;
    return (int)tanks_check(parameters);
}

static int initialize(const void *parameters, const void *prepared, void *state, double time, const void *inputs)
{
    (void)prepared;
    (void)time;
    (void)inputs;
    tanks_initialize(parameters, state);
    return TANKS_OK;
}

static int step(const void *parameters, const void *prepared, void *state, double time, double length,
                const void *inputs)
{
    (void)prepared;
    (void)time;
    return (int)tanks_step(parameters, state, inputs, length);
}

static void get_outputs(const void *parameters, const void *prepared, const void *state, void *outputs)
{
    (void)prepared;
    tanks_get_outputs(parameters, state, outputs);
}

static int state_is_valid(const void *state)
{
    (void)state;
    return 1;
}

static size_t state_count(const void *parameters)
{
    const tanks_params *p = parameters;
    return (size_t)p->count;
}

static double *states(void *state)
{
    tanks_state *s = state;
    return s->level;
}

static int hold(const void *parameters, const void *prepared, void *state, const void *inputs)
{
    (void)prepared;
    return (int)tanks_hold(parameters, state, inputs);
}

static void tangent(const void *parameters, const void *prepared, const void *state, const void *inputs,
                    const double *dx, const void *dinputs, void *doutputs)
{
    (void)prepared;
    (void)state;
    tanks_tangent(parameters, inputs, dx, dinputs, doutputs);
}

static const char *objection(const void *parameters)
{
    (void)parameters;
    return NULL;
}

static fmu_severity explain(int status, const char *const *names, const void *parameters, const void *state,
                            const void *inputs, double length, char *text, size_t size)
{
    const tanks_params *p = parameters;
    const tanks_inputs *u = inputs;
    (void)state;
    (void)length;
    if (status == TANKS_LIMITS) {
        snprintf(text, size, "%s must not exceed %s, found %g and %g", names[VR_low], names[VR_high], p->low, p->high);
        return FMU_REFUSED;
    }
    for (int j = 0; j < TANKS_PUMPS; j++) {
        if (!isfinite(u->flow[j])) {
            snprintf(text, size, "the flow %s must be finite", names[VR_flow + j]);
        }
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
    .parameters_size = sizeof(tanks_params),
    .inputs_size = sizeof(tanks_inputs),
    .outputs_size = sizeof(tanks_outputs),
    .prepared_size = 0,
    .state_size = sizeof(tanks_state),
    .prepare = prepare,
    .initialize = initialize,
    .step = step,
    .get_outputs = get_outputs,
    .state_is_valid = state_is_valid,
    .explain = explain,
    .continuous = &CONTINUOUS,
};
