/* A linear plant of any size up to the largest, exact under held inputs: the C twin of plant_fmu/linear.
 *
 *     x' = A (x - x_eq) + B w,   y = y_eq + C (x - x_eq),   w = min(upper, max(lower, u + d)) - u_eq,
 *
 * and measured is r floor((y + bias)/r + offset), or y + bias where the resolution r is 0. Pure functions of their
 * arguments: no allocation, no globals, no input or output, every loop bounded. The order of operations is that of the
 * Python twin.
 */
#ifndef LINEAR_PLANT_H
#define LINEAR_PLANT_H

#include "linear_exponential.h"

#define linear_acts FMU_NAMED(linear_acts)
#define linear_initialize FMU_NAMED(linear_initialize)
#define linear_step FMU_NAMED(linear_step)
#define linear_get_outputs FMU_NAMED(linear_get_outputs)
#define linear_hold FMU_NAMED(linear_hold)
#define linear_tangent FMU_NAMED(linear_tangent)

typedef enum {
    LINEAR_OK = 0,
    LINEAR_LIMITS_CROSSED,    /* an input's lower limit exceeds its upper one */
    LINEAR_OUTPUT_NOT_FINITE, /* the start values give an output that is not finite */
    LINEAR_INPUT_NOT_FINITE,  /* a NaN or an infinity among the inputs */
    LINEAR_STEP_TOO_LONG,     /* for the model to be computed in double precision */
    LINEAR_DIVERGED           /* states or outputs left the range of numbers */
} linear_status;

/* Parameters, named as in the compiled interface; only the leading entries count, as many as the sizes tell. */
typedef struct {
    int state_count;                           /* n, 1..LINEAR_STATES */
    int input_count;                           /* m, 1..LINEAR_INPUTS */
    int output_count;                          /* p, 1..LINEAR_OUTPUTS */
    double A[LINEAR_STATES][LINEAR_STATES];    /* [1/s and units of the states] */
    double B[LINEAR_STATES][LINEAR_INPUTS];    /* [1/s and units of states and inputs] */
    double C[LINEAR_OUTPUTS][LINEAR_STATES];   /* [units of outputs and states] */
    double state_equilibrium[LINEAR_STATES];   /* x_eq */
    double input_equilibrium[LINEAR_INPUTS];   /* u_eq */
    double output_equilibrium[LINEAR_OUTPUTS]; /* y_eq */
    double initial_state[LINEAR_STATES];       /* x at the start */
    double lower[LINEAR_INPUTS];               /* limits of the inputs */
    double upper[LINEAR_INPUTS];
    double resolution[LINEAR_OUTPUTS];        /* r: step of a counting sensor, 0 for none */
    double resolution_offset[LINEAR_OUTPUTS]; /* where inside a step it was zeroed [1] */
    double bias[LINEAR_OUTPUTS];              /* of a sensor */
} linear_params;

typedef struct {
    double input[LINEAR_INPUTS];       /* u */
    double disturbance[LINEAR_INPUTS]; /* d */
} linear_inputs;

/* Entries beyond the model's sizes are 0. */
typedef struct {
    double output[LINEAR_OUTPUTS];    /* measured */
    double state[LINEAR_STATES];      /* x */
    double derivative[LINEAR_STATES]; /* x' under the held inputs [1/s] */
} linear_outputs;

/* Everything that changes during a run. */
typedef struct {
    double x[LINEAR_STATES];
    double w[LINEAR_INPUTS]; /* held over the last step, 0 before the first */
    double held_step;        /* step that `held` is for, 0 for none [s] */
    linear_held held;
} linear_state;

/* Whether an input and its disturbance are numbers that can act. */
int linear_acts(const linear_params *p, const linear_inputs *u, int j);

/* Set the initial state. */
linear_status linear_initialize(const linear_params *p, linear_state *s);

/* Advance by `step` [s] with the inputs held; a refused step changes nothing. */
linear_status linear_step(const linear_params *p, linear_state *s, const linear_inputs *u, double step);

void linear_get_outputs(const linear_params *p, const linear_state *s, linear_outputs *y);

/* Model exchange: take the inputs as held from now on. */
linear_status linear_hold(const linear_params *p, linear_state *s, const linear_inputs *u);

/* Derivative of linear_hold and linear_get_outputs in the direction (dx, du); a counting sensor is constant. */
void linear_tangent(const linear_params *p, const linear_inputs *u, const double dx[LINEAR_STATES],
                    const linear_inputs *du, linear_outputs *dy);

#endif
