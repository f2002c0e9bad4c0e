/* Up to 16 tanks that up to 8 pumps fill: level_i' = -rate_i level_i + sum_j gain_ij flow_j, each flow within [low,
 * high].
 *
 * A unit with as many variables as there may be, of which an FMU shows some.
 */
#ifndef TANKS_H
#define TANKS_H

#include "tanks_constants.h" /* generated */

typedef enum { TANKS_OK = 0, TANKS_LIMITS, TANKS_FLOW_NOT_FINITE } tanks_status;

typedef struct {
    int count;                            /* of tanks */
    int strategy;                         /* TANKS_STRATEGY_FREE: flows as they are, or none */
    double low, high;                     /* limits of a flow [m3/s] */
    double rate[TANKS_MOST];              /* [1/s] */
    double gain[TANKS_MOST][TANKS_PUMPS]; /* [1/m2] */
    double begin[TANKS_MOST];             /* level at the start [m] */
    int kinds[TANKS_MOST];                /* factors of the total */
    double chart[TANKS_CHART][TANKS_CHART];
} tanks_params;

typedef struct {
    double flow[TANKS_PUMPS]; /* [m3/s] */
} tanks_inputs;

typedef struct {
    double level[TANKS_MOST];      /* [m] */
    double level_rate[TANKS_MOST]; /* [m/s] */
    double total;                  /* sum of kinds_i level_i [m] */
    double corner;                 /* last entry of the chart */
    int mode;                      /* TANKS_MODE_CALM ... */
} tanks_outputs;

typedef struct {
    double level[TANKS_MOST];
    double flow[TANKS_PUMPS]; /* held, within the limits */
} tanks_state;

tanks_status tanks_check(const tanks_params *p);
void tanks_initialize(const tanks_params *p, tanks_state *s);
tanks_status tanks_hold(const tanks_params *p, tanks_state *s, const tanks_inputs *u);
tanks_status tanks_step(const tanks_params *p, tanks_state *s, const tanks_inputs *u, double step);
void tanks_get_outputs(const tanks_params *p, const tanks_state *s, tanks_outputs *y);
void tanks_tangent(const tanks_params *p, const tanks_inputs *u, const double dx[TANKS_MOST], const tanks_inputs *du,
                   tanks_outputs *dy);

#endif
