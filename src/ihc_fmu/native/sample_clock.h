/* The sample clock of a controller: it samples at multiples of its sample time from the start on, and holds its
 * commands in between; a communication step that is longer runs the samples that fall in on held inputs.
 * `sampled_unit.py` in C.
 */
#ifndef SAMPLE_CLOCK_H
#define SAMPLE_CLOCK_H

#include <math.h>
#include <stdint.h>

enum {
    CLOCK_OK = 0,
    CLOCK_INPUTS_HELD = 100, /* the step worked; it is the first that held its inputs over several samples */
    CLOCK_STEP_NOT_MULTIPLE, /* neither sample_time nor the communication step is a multiple of the other */
    CLOCK_TOO_MANY_SAMPLES,  /* the communication step is more than MOST_SAMPLES samples */
    CLOCK_SAMPLE_MISSED      /* a sample before this step was never run: the state is not of this run */
};

typedef struct {
    double start_time;   /* [s] */
    int64_t next_sample; /* index of the next sample instant */
    int64_t held;        /* whether it has been said that a step held its inputs over several samples */
} sample_clock;

/* Whether one of the two times is a multiple of the other. */
static inline int check_step(double sample_time, double step)
{
    const double ratio = step > sample_time ? step / sample_time : sample_time / step;
    if (step > sample_time && ratio > (double)MOST_SAMPLES + 0.5) {
        return CLOCK_TOO_MANY_SAMPLES;
    }
    return fabs(ratio - nearbyint(ratio)) <= 1e-6 * ratio ? CLOCK_OK : CLOCK_STEP_NOT_MULTIPLE; /* also for NaN */
}

/* The index of the last sample instant within `step` [s] from `time` [s] on, at most MOST_SAMPLES beyond the next. */
static inline int samples_until(const sample_clock *clock, double sample_time, double time, double step, double *last)
{
    const double samples = step / sample_time;
    const double beyond = samples > 1.0 ? samples - 0.5 : 0.5 * samples;
    const int status = check_step(sample_time, step);
    if (status != CLOCK_OK) {
        return status;
    }
    *last = floor((time - clock->start_time) / sample_time + beyond);
    return *last - (double)clock->next_sample >= fmax(1.0, nearbyint(samples)) ? CLOCK_SAMPLE_MISSED : CLOCK_OK;
}

/* After a step that worked: the status of one that held its inputs over several samples, once. */
static inline int note_held_inputs(sample_clock *clock, double sample_time, double step)
{
    if (step / sample_time > 1.5 && !clock->held) {
        clock->held = 1;
        return CLOCK_INPUTS_HELD;
    }
    return CLOCK_OK;
}

#endif
