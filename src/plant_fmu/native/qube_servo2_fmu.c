/* The plant as a unit of the FMI adapter. */
#include <stdio.h>

#include "fmu_unit.h"

FMU_PRIVATE_BEGIN
#include "qube_servo2.h"
FMU_PRIVATE_END

#include "qube_servo2_table.h" /* generated: VARIABLES and what they count */

static int prepare(const void *parameters, void *prepared)
{
    return (int)qube_prepare(parameters, prepared);
}

static int initialize(const void *parameters, const void *prepared, void *state, double time, const void *inputs)
{
    (void)time;
    (void)inputs;
    return (int)qube_initialize(parameters, prepared, state);
}

static int step(const void *parameters, const void *prepared, void *state, double time, double length,
                const void *inputs)
{
    (void)time;
    return (int)qube_step(parameters, prepared, state, inputs, length);
}

static void get_outputs(const void *parameters, const void *prepared, const void *state, void *outputs)
{
    (void)parameters;
    (void)prepared;
    qube_get_outputs(state, outputs);
}

static void derive_outputs(const void *parameters, const void *prepared, const void *state, void *outputs)
{
    qube_derive_outputs(parameters, prepared, state, outputs);
}

static int state_is_valid(const void *state)
{
    return qube_state_is_valid(state);
}

static size_t state_count(const void *parameters)
{
    return (size_t)qube_state_count(parameters);
}

static double *states(void *state)
{
    qube_state *s = state;
    return s->x;
}

static int hold(const void *parameters, const void *prepared, void *state, const void *inputs)
{
    return (int)qube_hold(parameters, prepared, state, inputs);
}

static void tangent(const void *parameters, const void *prepared, const void *state, const void *inputs,
                    const double *dx, const void *dinputs, void *doutputs)
{
    qube_tangent(parameters, prepared, state, inputs, dx, dinputs, doutputs);
}

static const char *objection(const void *parameters)
{
    const qube_params *p = parameters;
    if (p->noise_std != 0.0) {
        return "noise_std must be 0: noise is drawn at communication points, which there are none of";
    }
    if (p->measurement_delay != 0.0) {
        return "measurement_delay must be 0: it is counted in communication steps, which there are none of";
    }
    return NULL;
}

static fmu_severity explain(int status, const char *const *names, const void *parameters, const void *state,
                            const void *inputs, double length, char *text, size_t size)
{
    const qube_params *p = parameters;
    const qube_state *s = state;
    const qube_inputs *u = inputs;
    switch (status) {
    case QUBE_OUTPUT_NOT_FINITE:
        snprintf(text, size, "start values must give finite outputs, found x = (%g, %g, %g, %g)", p->theta_0,
                 p->delta_0, p->theta_dot_0, p->delta_dot_0);
        break;
    case QUBE_SINGULAR:
        snprintf(
            text, size,
            "J_p and J_r must not vanish beside the pendulum's mass, found J_p = %g kg.m2, J_r = %g kg.m2 and m_p = "
            "%g kg",
            p->J_p, p->J_r, p->m_p);
        break;
    case QUBE_INPUT_NOT_FINITE:
        snprintf(text, size, "inputs must be finite, found %s, %s, %s = (%.17g, %.17g, %.17g)", names[VR_voltage],
                 names[VR_disturbance_voltage], names[VR_pendulum_torque], u->voltage, u->disturbance_voltage,
                 u->pendulum_torque);
        break;
    case QUBE_DELAY_NOT_MULTIPLE:
        snprintf(text, size,
                 "measurement_delay must be a multiple of the communication step, found %g s with a step of %g s",
                 p->measurement_delay, length);
        break;
    case QUBE_DELAY_TOO_LONG:
        snprintf(text, size, "measurement_delay must not exceed %d communication steps, found %g s with a step of %g s",
                 (int)QUBE_MAX_DELAY, p->measurement_delay, length);
        break;
    case QUBE_STEP_CHANGED:
        snprintf(text, size,
                 "the communication step must stay the same with a measurement_delay, found %g s after %g s", length,
                 s->delayed_step);
        break;
    case QUBE_TOO_MANY_SUBSTEPS:
        snprintf(text, size, "a communication step must not exceed %d internal steps of %g s, found %g s",
                 (int)QUBE_MAX_SUBSTEPS, p->solver_step, length);
        break;
    default:
        snprintf(text, size, "the state left the range of numbers, x = (%.9g, %.9g, %.9g, %.9g, %.9g) before the step",
                 s->x[0], s->x[1], s->x[2], s->x[3], s->x[4]);
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
    .parameters_size = sizeof(qube_params),
    .inputs_size = sizeof(qube_inputs),
    .outputs_size = sizeof(qube_outputs),
    .prepared_size = sizeof(qube_prepared),
    .state_size = sizeof(qube_state),
    .prepare = prepare,
    .initialize = initialize,
    .step = step,
    .get_outputs = get_outputs,
    .derive_outputs = derive_outputs,
    .first_derived = offsetof(qube_outputs, current),
    .state_is_valid = state_is_valid,
    .explain = explain,
    .continuous = &CONTINUOUS,
};
