/* Stabilization of any linear model of up to 16 states, 8 inputs and 16 measured outputs: state estimation by a linear
 * Kalman filter or a homogeneous observer, set-points, the linear, implicit homogeneous or super-twisting law,
 * compensation of estimated disturbances, integral action, limits, faults. What is sampled, and when, is the sample
 * clock's.
 *
 * At each sample, with deviations x, y, u from the equilibrium of the model and set-points r:
 *     e = x - Nx r,  r_d = ||e||_d,  u = law(e) + Nu r - d + v,  v' = r_d^(1-2 mu) K_i d(-ln r_d) e
 *
 * Matrices are packed by rows for the sizes that a design has: (rows, columns) takes the first rows times columns
 * entries.
 *
 * Pure functions of their arguments: no allocation, no globals, no input or output, every loop bounded. The order of
 * operations is that of the Python twin, `regulator/unit.py`.
 */
#ifndef HOMOGENEOUS_CONTROLLER_H
#define HOMOGENEOUS_CONTROLLER_H

#include "homogeneous_controller_constants.h" /* generated from what Python has */

#define HOMOGENEOUS_ORDER REGULATOR_STATES
#define HOMOGENEOUS_INPUTS REGULATOR_INPUTS
#define HOMOGENEOUS_CHAIN 0
#include "homogeneous.h"
#include "sample_clock.h"

typedef enum {
    REGULATOR_OK = 0,
    REGULATOR_NEW_FAULT,         /* the step worked; the controller has just faulted, see the output `fault` */
    REGULATOR_EXPONENTS,         /* the exponents are not those of blocks */
    REGULATOR_INDEFINITE_P,      /* P is not positive definite */
    REGULATOR_SINGULAR_T,        /* T is not regular */
    REGULATOR_BLOCKS_NOT_FINITE, /* T, P or the gains are beyond reason */
    REGULATOR_BOUNDS,            /* a_min exceeds b_max */
    REGULATOR_LIMITS,            /* a lower limit exceeds the upper one */
    REGULATOR_MEASURED_STATES,   /* other numbers of states and outputs although the states are measured */
    REGULATOR_ERROR_BOUNDS,      /* q_min exceeds q_max */
    REGULATOR_FILTER_TIME        /* the Kalman filter is for another sample time */
} regulator_status;              /* and those of sample_clock.h */

/* Parameters, named as in the compiled table. */
typedef struct {
    int law, norm_solver, discretization;
    double a_min, b_max;                 /* bounds of the norm in the law [1] */
    int j_max;                           /* bisections per sample in Algorithm 1 */
    int enabled, compensate_disturbance; /* [Boolean] */
    double lower[REGULATOR_INPUTS];      /* limits of the commands */
    double upper[REGULATOR_INPUTS];
    double sample_time;                                      /* [s] */
    double mu;                                               /* minus the degree of homogeneity [1] */
    double K[BLOCK_GAINS];                                   /* (m, n), the linear controller u = K x */
    double P[REGULATOR_STATES * (REGULATOR_STATES + 1) / 2]; /* upper triangle by rows, the unit ball x' P x <= 1 */
    double output_equilibrium[REGULATOR_OUTPUTS];
    double input_equilibrium[REGULATOR_INPUTS];
    double state_equilibrium[REGULATOR_STATES];
    int state_count, input_count, output_count;      /* n, m, p */
    int exponent[REGULATOR_STATES];                  /* e_j of the block coordinates */
    double T[BLOCK_SQUARE];                          /* (n, n), z = T x */
    double N[BLOCK_SQUARE];                          /* (n, n), superdiagonal blocks */
    double B[BLOCK_GAINS];                           /* (n, m), T B */
    double K0[BLOCK_GAINS];                          /* (m, n), K_0 */
    double Ki[BLOCK_GAINS];                          /* (m, n), K_i of the integral action, 0 for none */
    double Nx[REGULATOR_STATES * REGULATOR_OUTPUTS]; /* (n, p), states at rest per set-point */
    double Nu[REGULATOR_INPUTS * REGULATOR_OUTPUTS]; /* (m, p), inputs at rest per set-point */
    int estimator;
    double first[REGULATOR_STATES * REGULATOR_OUTPUTS]; /* (n, p), states that the first measurement is taken for */
    double C[REGULATOR_OUTPUTS * REGULATOR_STATES];     /* (p, n), y = C x */
    double F[BLOCK_SQUARE];                             /* (n, n), x+ = F x + G (u + d); A, B of the observer */
    double G[BLOCK_GAINS];                              /* (n, m) */
    double M[(REGULATOR_STATES + REGULATOR_INPUTS + REGULATOR_OUTPUTS) * REGULATOR_OUTPUTS]; /* (n + m + p, p), gain */
    double bias_decay;                               /* what remains of a bias after a sample [1] */
    double filter_sample_time;                       /* sample time that the filter is for [s] */
    double To[BLOCK_SQUARE];                         /* (n, n), block coordinates of the observer, of (A', C') */
    int observer_exponent[REGULATOR_STATES];         /* e_j of theirs */
    double L0[REGULATOR_STATES * REGULATOR_OUTPUTS]; /* (n, p), L_0 of the observer */
    double Lz[REGULATOR_STATES * REGULATOR_OUTPUTS]; /* (n, p), To^-T (L - L_0) */
    double observer_degree;                          /* nu [1] */
    double q_min, q_max;                             /* bounds of the output error in its gain */
    double S[BLOCK_GAINS];                           /* (m, n), sliding surfaces s = S e of the super-twisting law */
    double Ks[BLOCK_GAINS];                          /* (m, n), its linear part */
    double sta_rate[REGULATOR_INPUTS];               /* L of its k_1 = 1.5 sqrt(L), k_2 = 1.1 L */
    double count[REGULATOR_OUTPUTS];                 /* resolution of a sensor, 0 for none */
    double kalman_count_weight;                      /* of what of an innovation is within half a count [1] */
} regulator_params;

typedef struct {
    double measurement[REGULATOR_OUTPUTS]; /* measured outputs */
    double setpoint[REGULATOR_OUTPUTS];    /* where they are to be held */
} regulator_inputs;

typedef struct {
    double command[REGULATOR_INPUTS];
    double homogeneous_norm;      /* ||e||_d [1] */
    double homogeneous_norm_used; /* r in the law [1] */
    int mode;                     /* REGULATOR_MODE_IDLE ... */
    double state_estimate[REGULATOR_STATES];
    double disturbance_estimate[REGULATOR_INPUTS];
    double bias_estimate[REGULATOR_OUTPUTS];
    int fault; /* REGULATOR_FAULT_NONE ... */
} regulator_outputs;

/* What follows from the parameters alone; made by regulator_prepare, again after a parameter changed. */
typedef struct {
    block_design design;
    norm_search search;
    double ahead;                  /* sample time of the semi-implicit law; 0: explicit [s] */
    double Kiz[BLOCK_GAINS];       /* (m, n), K_i T^-1 */
    int integrates;                /* whether K_i has an entry */
    double idle[REGULATOR_INPUTS]; /* 0 within the limits */
} regulator_prepared;

/* Everything that changes during a run. */
typedef struct {
    sample_clock clock;
    double command[REGULATOR_INPUTS]; /* held since the last sample */
    double x[REGULATOR_STATES];       /* estimated state */
    double d[REGULATOR_INPUTS];       /* estimated disturbances of the inputs */
    double b[REGULATOR_OUTPUTS];      /* estimated biases of the outputs */
    double v[REGULATOR_INPUTS];       /* integral action, or that of the super-twisting law */
    double interval[2];               /* [a, b] of Algorithm 1 */
    double norm;                      /* homogeneous norm */
    double norm_used;                 /* its value in the law */
    int32_t primed;                   /* whether the estimator has seen a measurement */
    int32_t mode;
    int32_t fault;
    uint32_t bad_inputs; /* bit i: measurement i, bit 16 + i: set-point i was not finite */
} regulator_state;

/* Compute what follows from the parameters; refuses those that contradict each other. */
regulator_status regulator_prepare(const regulator_params *p, regulator_prepared *q);

/* Start the sample clock at `time` [s]; with finite inputs compute the norm of the state that they mean. */
void regulator_initialize(const regulator_params *p, const regulator_prepared *q, regulator_state *s, double time,
                          const regulator_inputs *u);

/* Sample the inputs at each sample instant within `step` [s] from `time` [s] on; hold the commands otherwise. */
int regulator_step(const regulator_params *p, const regulator_prepared *q, regulator_state *s, double time, double step,
                   const regulator_inputs *u);

void regulator_get_outputs(const regulator_params *p, const regulator_state *s, regulator_outputs *y);

/* The first input whose lower limit exceeds its upper one. */
int regulator_contradicting_limit(const regulator_params *p);

#endif
