#include "tanks.h"

#include <math.h>
#include <string.h>

tanks_status tanks_check(const tanks_params *p)
{
    return p->low <= p->high ? TANKS_OK : TANKS_LIMITS;
}

void tanks_initialize(const tanks_params *p, tanks_state *s)
{
    memset(s, 0, sizeof *s);
    for (int i = 0; i < p->count; i++) {
        s->level[i] = p->begin[i];
    }
}

static double inflow(const tanks_params *p, int i, const double flow[TANKS_PUMPS])
{
    double sum = 0.0;
    for (int j = 0; j < TANKS_PUMPS; j++) {
        sum += p->gain[i][j] * flow[j];
    }
    return sum;
}

tanks_status tanks_hold(const tanks_params *p, tanks_state *s, const tanks_inputs *u)
{
    for (int j = 0; j < TANKS_PUMPS; j++) {
        if (!isfinite(u->flow[j])) {
            return TANKS_FLOW_NOT_FINITE;
        }
    }
    for (int j = 0; j < TANKS_PUMPS; j++) {
        s->flow[j] = p->strategy == TANKS_STRATEGY_FREE ? fmin(fmax(u->flow[j], p->low), p->high) : 0.0;
    }
    return TANKS_OK;
}

tanks_status tanks_step(const tanks_params *p, tanks_state *s, const tanks_inputs *u, double step)
{
    const tanks_status status = tanks_hold(p, s, u);
    for (int i = 0; status == TANKS_OK && i < p->count; i++) {
        const double end = inflow(p, i, s->flow) / p->rate[i];
        s->level[i] = end + exp(-p->rate[i] * step) * (s->level[i] - end);
    }
    return status;
}

void tanks_get_outputs(const tanks_params *p, const tanks_state *s, tanks_outputs *y)
{
    memset(y, 0, sizeof *y);
    y->mode = TANKS_MODE_CALM;
    y->corner = p->chart[TANKS_CHART - 1][TANKS_CHART - 1];
    for (int i = 0; i < p->count; i++) {
        y->level[i] = s->level[i];
        y->level_rate[i] = inflow(p, i, s->flow) - p->rate[i] * s->level[i];
        y->total += p->kinds[i] * s->level[i];
    }
    for (int j = 0; j < TANKS_PUMPS; j++) {
        y->mode = s->flow[j] > 0.0 ? TANKS_MODE_FILLING : y->mode;
    }
}

void tanks_tangent(const tanks_params *p, const tanks_inputs *u, const double dx[TANKS_MOST], const tanks_inputs *du,
                   tanks_outputs *dy)
{
    double flow[TANKS_PUMPS];
    memset(dy, 0, sizeof *dy);
    for (int j = 0; j < TANKS_PUMPS; j++) {
        flow[j] =
            p->strategy == TANKS_STRATEGY_FREE && u->flow[j] >= p->low && u->flow[j] <= p->high ? du->flow[j] : 0.0;
    }
    for (int i = 0; i < p->count; i++) {
        dy->level[i] = dx[i];
        dy->level_rate[i] = inflow(p, i, flow) - p->rate[i] * dx[i];
        dy->total += p->kinds[i] * dx[i];
    }
}
