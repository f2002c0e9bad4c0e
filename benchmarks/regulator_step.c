/* What a whole sample of HomogeneousController costs; the header start_values.h with DESIGNS is generated. */
#include "homogeneous_controller.h"
#include "start_values.h"

#define EXPORTED __attribute__((visibility("default")))

/* Whole samples on `count` measurements; returns how many were in the stabilizing mode, -1 on failure. */
EXPORTED long whole_steps(int design, const double (*y)[REGULATOR_OUTPUTS], long count)
{
    static const regulator_inputs at_rest;
    const regulator_params *p = &DESIGNS[design];
    regulator_prepared prepared;
    regulator_state state;
    regulator_outputs outputs;
    regulator_inputs u = at_rest;
    long stabilizing = 0;
    if (regulator_prepare(p, &prepared) != REGULATOR_OK) {
        return -1;
    }
    regulator_initialize(p, &prepared, &state, 0.0, &u);
    for (long k = 0; k < count; k++) {
        for (int i = 0; i < p->output_count; i++) {
            u.measurement[i] = y[k][i];
        }
        if (regulator_step(p, &prepared, &state, (double)k * p->sample_time, p->sample_time, &u)
            > REGULATOR_NEW_FAULT) {
            return -1;
        }
        stabilizing += state.mode == REGULATOR_MODE_STABILIZING;
    }
    regulator_get_outputs(p, &state, &outputs);
    return stabilizing;
}
