/* The stepping loop of the master over the FMUs' own functions: any number of FMUs, wires and recorded variables.
 *
 * Every FMU is given as C functions and ports; a port is a buffer that one call of fmi2GetReal, fmi2SetInteger, ...
 * empties or fills. Time is an integer step index k, t = start_time + k step. The caller makes all structs and owns all
 * memory.
 */
#ifndef LOOP_H
#define LOOP_H

#include <stddef.h>
#include <stdint.h>

#if defined _WIN32
#define LOOP_EXPORT __declspec(dllexport)
#else
#define LOOP_EXPORT __attribute__((visibility("default")))
#endif

/* fmi2GetReal and its kin; status 0 is OK, 1 a warning, more a failure. */
typedef int loop_transfer(void *component, const unsigned *references, size_t count, void *values);
typedef int loop_do_step(void *component, double time, double step, int no_state_before);

typedef struct {
    loop_transfer *call;
    const unsigned *references;
    size_t count;
    void *values;
} loop_port;

/* A value that a wire carries into an input port: of `size` bytes. */
typedef struct {
    const void *source;
    void *target;
    size_t size;
} loop_wire;

/* A wire between real numbers that converts: target = factor source + offset. */
typedef struct {
    const double *source;
    double *target;
    double factor, offset;
} loop_conversion;

/* An input that follows a function of time: its values, of `size` bytes each, in the steps of a call. */
typedef struct {
    const unsigned char *values;
    void *target;
    size_t size;
} loop_signal;

typedef struct {
    void *component;
    loop_do_step *do_step;
    size_t input_count, output_count, wire_count, conversion_count, signal_count;
    const loop_port *inputs, *outputs;
    const loop_wire *wires;
    const loop_conversion *conversions;
    const loop_signal *signals;
} loop_instance;

/* `count` real numbers, one after the other. */
typedef struct {
    const double *first;
    size_t count;
} loop_span;

/* What is recorded: rows of `count` values; real ones from spans, others from their sources. */
typedef struct {
    size_t count, span_count;
    const loop_span *spans;
    double *rows;
} loop_reals;

typedef struct {
    size_t count;
    const int *const *sources;
    int64_t *rows;
} loop_integers;

/* Where a call of an FMU failed. */
enum { LOOP_INPUT = 1, LOOP_STEP, LOOP_OUTPUT };

typedef struct {
    size_t instance_count;
    const loop_instance *instances;
    loop_reals reals;
    loop_integers integers;
    double start_time, step; /* [s] */
    int64_t steps;           /* in all */
    int64_t every;           /* steps from row to row; the last one is recorded too */
    int32_t parallel;        /* 1: all inputs are gathered before any FMU steps (Jacobi) */
    int64_t done;            /* steps done */
    int64_t recorded;        /* rows recorded */
    double *times;           /* of the rows [s] */
    int32_t failed_in;       /* LOOP_INPUT ..., 0 for none */
    int32_t failed_status;
    size_t failed_instance, failed_port;
} loop_run;

/* Step until `until` steps are done, about `seconds` have passed or a call fails; returns 0, or 1 for a failure. */
LOOP_EXPORT int loop_advance(loop_run *run, int64_t until, double seconds);

#endif
