/* What the statuses of the sample clock mean, in words. Included behind fmu_unit.h. */
#ifndef SAMPLE_CLOCK_FMU_H
#define SAMPLE_CLOCK_FMU_H

#include <stdio.h>

#include "sample_clock.h"

static inline fmu_severity explain_clock(int status, const sample_clock *clock, double sample_time, double length,
                                         char *text, size_t size)
{
    switch (status) {
    case CLOCK_INPUTS_HELD:
        snprintf(text, size, "a communication step of %g s holds the inputs over several samples of sample_time = %g s",
                 length, sample_time);
        return FMU_WARNING;
    case CLOCK_STEP_NOT_MULTIPLE:
        snprintf(
            text, size,
            "sample_time must be a multiple of the communication step, or the step of it, found sample_time = %g s and "
            "a communication step of %g s",
            sample_time, length);
        break;
    case CLOCK_SAMPLE_MISSED:
        snprintf(text, size, "sample %lld of sample_time = %g s was stepped over", (long long)clock->next_sample,
                 sample_time);
        break;
    default:
        snprintf(text, size, "a communication step must not exceed %d samples of sample_time = %g s, found %g s",
                 (int)MOST_SAMPLES, sample_time, length);
    }
    return FMU_REFUSED;
}

#endif
