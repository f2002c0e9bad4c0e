/* One instance of a unit: its data in one block, its variables by value reference, its log.
 *
 * A call that is refused says why in the log and leaves everything as it was.
 */
#ifndef FMU_INSTANCE_H
#define FMU_INSTANCE_H

#include "fmi2FunctionTypes.h"
#include "fmu_unit.h"

/* States of FMI 2.0.5, sections 3.2.3 and 4.2.4, as bits so that a call can name those that allow it. */
typedef enum {
    FMU_INSTANTIATED = 1,
    FMU_INITIALIZATION = 2,
    FMU_STEP = 4,        /* co-simulation: between steps */
    FMU_EVENT = 8,       /* model exchange */
    FMU_CONTINUOUS = 16, /* model exchange */
    FMU_TERMINATED = 32
} fmu_phase;

/* What get/setFMUstate keeps besides the block. */
typedef struct {
    fmu_phase phase;
    int experiment_set;
    double time; /* [s] */
    double stop; /* end of the experiment where one is defined [s] */
    fmi2Status last_status;
    int stop_defined;
} fmu_progress;

typedef struct {
    const fmu_unit *unit;
    char *name;
    fmi2Type kind;
    fmi2CallbackLogger logger;
    fmi2ComponentEnvironment environment;
    int log_errors, log_warnings;
    fmu_start start;
    const char **names; /* of all variables, as they are shown; of those that are not, as compiled */
    fmu_progress progress;
    size_t block_size;
    unsigned char *block; /* parameters, inputs, outputs, prepared, state */
    void *parameters, *inputs, *outputs, *prepared, *state;
    const unsigned char *derived;  /* where outputs begin that are computed when asked for; the block's end for none */
    const unsigned char *outdated; /* where those begin that are older than the state; the block's end for none */
    unsigned char *spare;          /* room for the block up to the state, before a change */
    void **where;                  /* address of each variable */
    void **of_type[3];             /* the same of those of one fmu_type that are shown, NULL for others */
    void **plain;                  /* the same of real inputs without bounds */
    size_t states;                 /* continuous states in model exchange */
} fmu_instance;

/* A copy of an instance's block and progress. */
typedef struct {
    unsigned long magic;
    size_t block_size;
    fmi2Type kind;
    char guid[FMU_GUID_SIZE];
    fmu_progress progress;
    unsigned char *block;
} fmu_snapshot;

FMU_PRIVATE_BEGIN

fmu_instance *fmu_create(const fmu_unit *unit, const char *name, const char *resource_location, char *problem,
                         size_t problem_size);
void fmu_destroy(fmu_instance *m);

/* Back to the start values. */
void fmu_set_start(fmu_instance *m);

/* Log a formatted message in one of the categories; fmi2Error always returns what it is called with. */
fmi2Status fmu_say(const fmu_instance *m, fmi2Status status, const char *format, ...)
#if defined __GNUC__
    __attribute__((format(printf, 3, 4)))
#endif
    ;

/* Compute parameters' consequences, the initial state and the outputs at the present time. */
fmi2Status fmu_initialize(fmu_instance *m);

/* Advance by `step` [s]. */
fmi2Status fmu_advance(fmu_instance *m, double time, double step);

/* The variable with a value reference; NULL where none is shown. */
const fmu_variable *fmu_find(const fmu_instance *m, fmi2ValueReference vr);

/* Index of the continuous state with a value reference in model exchange, or -1. */
int fmu_state_index(const fmu_instance *m, fmi2ValueReference vr);

/* Model exchange: outputs under the present inputs and states. */
fmi2Status fmu_observe(fmu_instance *m, const char *call);

/* Copy values as they are, into reals for FMU_REAL, else into ints, up to the first that is unknown or out of date;
 * returns how many. */
size_t fmu_copy(const fmu_instance *m, fmu_type type, const fmi2ValueReference *vr, size_t count, void *values);

/* The usual call between steps: finite values of real inputs without bounds. 0, and nothing is set, where it is
 * another. */
int fmu_set_inputs(fmu_instance *m, const fmi2ValueReference *vr, size_t count, const double *values);

/* Copy values after bringing outputs up to date. */
fmi2Status fmu_get(fmu_instance *m, fmu_type type, const fmi2ValueReference *vr, size_t count, void *values);
fmi2Status fmu_set(fmu_instance *m, fmu_type type, const fmi2ValueReference *vr, size_t count, const void *values);

fmu_snapshot *fmu_save(fmu_instance *m);
void fmu_restore(fmu_instance *m, const fmu_snapshot *s);

/* Whether it is one of an instance of the same FMU and kind. */
int fmu_is_snapshot(const fmu_instance *m, const fmu_snapshot *s);
void fmu_free_snapshot(fmu_snapshot *s);
size_t fmu_serialized_size(const fmu_instance *m);
void fmu_serialize(const fmu_instance *m, const fmu_snapshot *s, unsigned char *bytes);

/* NULL with a sentence in the log for bytes that are no state of this FMU. */
fmu_snapshot *fmu_deserialize(fmu_instance *m, const unsigned char *bytes, size_t size);

FMU_PRIVATE_END

#endif
