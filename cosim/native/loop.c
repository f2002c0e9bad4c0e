#if !defined _WIN32
#define _POSIX_C_SOURCE 199309L
#endif
#include "loop.h"

#include <string.h>
#if defined _WIN32
#include <windows.h>
#else
#include <time.h>
#endif

enum { MOST_STEPS_BETWEEN_LOOKS = 1024 }; /* at the clock */

static const double SHORT_TIME = 1e-3; /* [s] */

/* Seconds of a clock that does not jump. */
static double now(void)
{
#if defined _WIN32
    return 1e-3 * (double)GetTickCount64();
#else
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
#endif
}

static int fail(loop_run *run, int32_t where, size_t instance, size_t port, int status)
{
    run->failed_in = where;
    run->failed_instance = instance;
    run->failed_port = port;
    run->failed_status = status;
    return 1;
}

/* Whether a call succeeded: OK or warning; no other number is a success, negative ones included. */
static int good(int status)
{
    return status == 0 || status == 1;
}

static void copy(void *target, const void *source, size_t size)
{
    if (size == sizeof(double)) { /* by far the most, and without a call */
        memcpy(target, source, sizeof(double));
    } else {
        memcpy(target, source, size);
    }
}

/* Copy what the inputs of an instance are wired to into its input ports; `k` counts from the call's first step. */
static void gather(const loop_instance *instance, int64_t k)
{
    for (size_t i = 0; i < instance->wire_count; i++) {
        const loop_wire *wire = &instance->wires[i];
        copy(wire->target, wire->source, wire->size);
    }
    for (size_t i = 0; i < instance->conversion_count; i++) {
        const loop_conversion *conversion = &instance->conversions[i];
        *conversion->target = conversion->factor * *conversion->source + conversion->offset;
    }
    for (size_t i = 0; i < instance->signal_count; i++) {
        const loop_signal *signal = &instance->signals[i];
        copy(signal->target, signal->values + (size_t)k * signal->size, signal->size);
    }
}

/* Set the inputs of instance `index`, step it, get its outputs. */
static int step_instance(loop_run *run, size_t index, double time)
{
    const loop_instance *instance = &run->instances[index];
    for (size_t i = 0; i < instance->input_count; i++) {
        const loop_port *port = &instance->inputs[i];
        const int status = port->call(instance->component, port->references, port->count, port->values);
        if (!good(status)) {
            return fail(run, LOOP_INPUT, index, i, status);
        }
    }
    const int status = instance->do_step(instance->component, time, run->step, 1);
    if (!good(status)) {
        return fail(run, LOOP_STEP, index, 0, status);
    }
    for (size_t i = 0; i < instance->output_count; i++) {
        const loop_port *port = &instance->outputs[i];
        const int got = port->call(instance->component, port->references, port->count, port->values);
        if (!good(got)) {
            return fail(run, LOOP_OUTPUT, index, i, got);
        }
    }
    return 0;
}

static void record(loop_run *run)
{
    const size_t row = (size_t)run->recorded++;
    run->times[row] = run->start_time + (double)run->done * run->step;
    double *reals = run->reals.rows + row * run->reals.count;
    int64_t *integers = run->integers.rows + row * run->integers.count;
    for (size_t i = 0; i < run->reals.span_count; i++) {
        const loop_span *span = &run->reals.spans[i];
        for (size_t j = 0; j < span->count; j++) {
            *reals++ = span->first[j];
        }
    }
    for (size_t i = 0; i < run->integers.count; i++) {
        integers[i] = *run->integers.sources[i];
    }
}

static int one_step(loop_run *run, int64_t first)
{
    const double time = run->start_time + (double)run->done * run->step;
    if (run->parallel) {
        for (size_t i = 0; i < run->instance_count; i++) {
            gather(&run->instances[i], run->done - first);
        }
    }
    for (size_t i = 0; i < run->instance_count; i++) {
        if (!run->parallel) {
            gather(&run->instances[i], run->done - first);
        }
        if (step_instance(run, i, time)) {
            return 1;
        }
    }
    return 0;
}

int loop_advance(loop_run *run, int64_t until, double seconds)
{
    const int64_t first = run->done;
    double looked = now();
    const double end = looked + seconds;
    int64_t pause = 1, look = first + 1; /* FMUs may be slow: look often, unless steps turn out to be short */
    while (run->done < until) {
        if (one_step(run, first)) {
            return 1;
        }
        run->done++;
        if (run->done % run->every == 0 || run->done == run->steps) {
            record(run);
        }
        if (run->done >= look) {
            const double time = now();
            if (time >= end) {
                break;
            }
            pause = time - looked > SHORT_TIME ? 1 : pause < MOST_STEPS_BETWEEN_LOOKS ? 2 * pause : pause;
            looked = time;
            look = run->done + pause;
        }
    }
    return 0;
}
