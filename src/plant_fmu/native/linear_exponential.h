/* A step of a linear model under held inputs: the C twin of plant_fmu/linear/exponential.py, which tells the method.
 *
 *     x' = A x + B w, w constant over h:   x(t + h) = x + E x + G w
 */
#ifndef LINEAR_EXPONENTIAL_H
#define LINEAR_EXPONENTIAL_H

#include "fmu_names.h"              /* several linear plants may be parts of one program */
#include "linear_plant_constants.h" /* generated from what Python has: the largest sizes LINEAR_STATES, ... */

#define linear_hold_inputs FMU_NAMED(linear_hold_inputs)

typedef struct {
    double E[LINEAR_STATES][LINEAR_STATES]; /* e^(A h) - I [1] */
    double G[LINEAR_STATES][LINEAR_INPUTS]; /* integral of e^(A s) over 0..h times B */
} linear_held;

/* Compute E and G for the leading n x n and n x m entries of A and B, 1 <= n <= LINEAR_STATES, 1 <= m <= LINEAR_INPUTS,
 * and h > 0 [s]. Returns 0 where h is so long that they are not numbers, or not to be computed in double precision;
 * `held` then has no meaning.
 */
int linear_hold_inputs(const double A[LINEAR_STATES][LINEAR_STATES], const double B[LINEAR_STATES][LINEAR_INPUTS],
                       int n, int m, double h, linear_held *held);

#endif
