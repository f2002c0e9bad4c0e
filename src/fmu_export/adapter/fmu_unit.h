/* What a unit (a plant, a controller) gives to the FMI adapter: its variables and its functions.
 *
 * The table of variables is generated from the unit's interface; the functions are hand-written. A unit's data are five
 * structs: parameters, inputs, outputs (local variables included), what follows from the parameters alone (prepared),
 * and the state. A status of 0 is success; what another means is told by `explain`.
 */
#ifndef FMU_UNIT_H
#define FMU_UNIT_H

#include <stddef.h>

#include "fmu_names.h"

/* Limits of a unit; its generated table asserts them. */
enum { FMU_MOST_STATES = 16, FMU_MOST_BYTES = 1024, FMU_GUID_SIZE = 64, FMU_NAME_SIZE = 801 };

typedef enum { FMU_REAL, FMU_INTEGER, FMU_BOOLEAN } fmu_type;            /* enumerations are integers */
typedef enum { FMU_INPUT, FMU_OUTPUT, FMU_FIXED, FMU_TUNABLE } fmu_role; /* local variables count as outputs */
typedef enum { FMU_WARNING, FMU_REFUSED } fmu_severity;

/* A variable; its value reference is its index in the table. An FMU may show it under another name, or not at all. */
typedef struct {
    const char *name;
    fmu_type type;
    fmu_role role;
    int any_value;   /* whether an input may be NaN or infinite, which the unit turns into a fault */
    size_t offset;   /* in the struct that the role tells [byte] */
    double min, max; /* admissible values; -DBL_MAX, DBL_MAX: any finite */
} fmu_variable;

/* The continuous states of a unit that can be used for model exchange. */
typedef struct {
    const unsigned *states;      /* value references of the states, which are outputs too */
    const unsigned *derivatives; /* and of their derivatives */
    size_t (*count)(const void *parameters);
    double *(*values)(void *state);
    /* Take the inputs as held from now on. */
    int (*hold)(const void *parameters, const void *prepared, void *state, const void *inputs);
    /* Derivative of the outputs in the direction (dx, dinputs). */
    void (*tangent)(const void *parameters, const void *prepared, const void *state, const void *inputs,
                    const double *dx, const void *dinputs, void *doutputs);
    /* What in the parameters has no meaning in model exchange; NULL for nothing. */
    const char *(*objection)(const void *parameters);
} fmu_continuous;

typedef struct {
    const char *name;
    const fmu_variable *variables;
    size_t variable_count;
    size_t parameters_size, inputs_size, outputs_size, prepared_size, state_size;
    int (*prepare)(const void *parameters, void *prepared);
    int (*initialize)(const void *parameters, const void *prepared, void *state, double time, const void *inputs);
    int (*step)(const void *parameters, const void *prepared, void *state, double time, double step,
                const void *inputs);
    void (*get_outputs)(const void *parameters, const void *prepared, const void *state, void *outputs);
    /* Compute the outputs from offset `first_derived` on, which get_outputs leaves, of the state and fixed parameters;
     * called when they are asked for. NULL: there are none. */
    void (*derive_outputs)(const void *parameters, const void *prepared, const void *state, void *outputs);
    size_t first_derived;
    int (*state_is_valid)(const void *state); /* whether a restored state can do no harm */
    /* Write a sentence on a status; `names` are those of the variables, by reference, as the FMU shows them. */
    fmu_severity (*explain)(int status, const char *const *names, const void *parameters, const void *state,
                            const void *inputs, double step, char *text, size_t size);
    const fmu_continuous *continuous; /* NULL: co-simulation only */
} fmu_unit;

FMU_PRIVATE_BEGIN

/* The unit, defined beside its functions. */
extern const fmu_unit fmu_the_unit;

/* What an FMU's file tells of its variables, in the table's order. */
typedef struct {
    char guid[FMU_GUID_SIZE];
    double *values;     /* start values; outputs have 0 */
    const char **names; /* under which the variables are shown; NULL for those that are not */
    char *texts;        /* where the names are; NULL, or to be freed */
} fmu_start;

/* Read the GUID and, where there is room for `count` variables, their start values and names.
 *
 * One of two implementations is linked: that of prebuilt binaries reads the file start_values.bin in the FMU's
 * resources folder, that among an FMU's sources has the values compiled in. Returns 0, or -1 with a sentence in
 * `problem`.
 */
int fmu_load_start_values(const char *resource_location, fmu_start *start, size_t count, char *problem,
                          size_t problem_size);

FMU_PRIVATE_END

#endif
