/* A plain host: loads the binary of an FMU, runs it, and prints its Real outputs.
 *
 *     host BINARY RESOURCE_URI GUID cs|me STATES INPUTS INPUT... OUTPUT...
 *
 * INPUTS is the number of inputs; INPUT... and OUTPUT... are value references, of all inputs and of Real outputs.
 * After every 100 of 1000 steps of 1 ms a line with the outputs follows; last one with what is loaded and looks like
 * Python. The second half is repeated from a saved state and in another instance from a serialized one, everything
 * after a reset: the exit code is 1 with a message where these differ or where a call fails.
 */
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2FunctionTypes.h"

#if defined _WIN32
#include <windows.h>
#else
#include <dlfcn.h>
#endif

enum { STEPS = 1000, HALF = 500, PRINT_EVERY = 100, MOST = 32 };

static const double STEP = 1e-3;

static fmi2InstantiateTYPE *instantiate;
static fmi2FreeInstanceTYPE *free_instance;
static fmi2SetupExperimentTYPE *setup_experiment;
static fmi2EnterInitializationModeTYPE *enter_initialization;
static fmi2ExitInitializationModeTYPE *exit_initialization;
static fmi2TerminateTYPE *terminate;
static fmi2ResetTYPE *reset;
static fmi2GetRealTYPE *get_real;
static fmi2SetRealTYPE *set_real;
static fmi2GetFMUstateTYPE *get_state;
static fmi2SetFMUstateTYPE *set_state;
static fmi2FreeFMUstateTYPE *free_state;
static fmi2SerializedFMUstateSizeTYPE *serialized_size;
static fmi2SerializeFMUstateTYPE *serialize;
static fmi2DeSerializeFMUstateTYPE *deserialize;
static fmi2DoStepTYPE *do_step;
static fmi2EnterContinuousTimeModeTYPE *enter_continuous_time;
static fmi2GetContinuousStatesTYPE *get_states;
static fmi2SetContinuousStatesTYPE *set_states;
static fmi2GetDerivativesTYPE *get_derivatives;
static fmi2SetTimeTYPE *set_time;

static fmi2Type kind;
static size_t state_count, input_count, output_count;
static fmi2ValueReference inputs[MOST], outputs[MOST];

static void fail(const char *what)
{
    fprintf(stderr, "host: %s\n", what);
    exit(1);
}

#define DO(call) (void)((call) == fmi2OK || (fail(#call), 0))

static void log_message(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                        fmi2String message, ...)
{
    va_list arguments;
    (void)environment;
    va_start(arguments, message);
    fprintf(stderr, "%s: %d, %s: ", name, (int)status, category);
    vfprintf(stderr, message, arguments);
    fputc('\n', stderr);
    va_end(arguments);
}

#if defined _WIN32
static void *load(const char *path)
{
    return (void *)LoadLibraryA(path);
}

static void find(void *library, const char *name, void *function)
{
    const FARPROC found = GetProcAddress((HMODULE)library, name);
    memcpy(function, &found, sizeof found);
    if (found == NULL) {
        fail(name);
    }
}
#else
static void *load(const char *path)
{
    void *library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (library == NULL) {
        fail(dlerror());
    }
    return library;
}

static void find(void *library, const char *name, void *function)
{
    void *found = dlsym(library, name);
    memcpy(function, &found, sizeof found);
    if (found == NULL) {
        fail(name);
    }
}
#endif

static void find_all(void *library)
{
    find(library, "fmi2Instantiate", &instantiate);
    find(library, "fmi2FreeInstance", &free_instance);
    find(library, "fmi2SetupExperiment", &setup_experiment);
    find(library, "fmi2EnterInitializationMode", &enter_initialization);
    find(library, "fmi2ExitInitializationMode", &exit_initialization);
    find(library, "fmi2Terminate", &terminate);
    find(library, "fmi2Reset", &reset);
    find(library, "fmi2GetReal", &get_real);
    find(library, "fmi2SetReal", &set_real);
    find(library, "fmi2GetFMUstate", &get_state);
    find(library, "fmi2SetFMUstate", &set_state);
    find(library, "fmi2FreeFMUstate", &free_state);
    find(library, "fmi2SerializedFMUstateSize", &serialized_size);
    find(library, "fmi2SerializeFMUstate", &serialize);
    find(library, "fmi2DeSerializeFMUstate", &deserialize);
    find(library, "fmi2DoStep", &do_step);
    find(library, "fmi2EnterContinuousTimeMode", &enter_continuous_time);
    find(library, "fmi2GetContinuousStates", &get_states);
    find(library, "fmi2SetContinuousStates", &set_states);
    find(library, "fmi2GetDerivatives", &get_derivatives);
    find(library, "fmi2SetTime", &set_time);
}

static void initialize(fmi2Component c)
{
    DO(setup_experiment(c, fmi2False, 0.0, 0.0, fmi2False, 0.0));
    DO(enter_initialization(c));
    DO(exit_initialization(c));
    if (kind == fmi2ModelExchange) {
        DO(enter_continuous_time(c));
    }
}

/* One explicit step of Euler. */
static void integrate(fmi2Component c, double time)
{
    double x[MOST], rate[MOST];
    DO(set_time(c, time));
    DO(get_states(c, x, state_count));
    DO(get_derivatives(c, rate, state_count));
    for (size_t i = 0; i < state_count; i++) {
        const double change = STEP * rate[i];
        x[i] += change;
    }
    DO(set_states(c, x, state_count));
}

static void run(fmi2Component c, int first, int last, double y[MOST], int print)
{
    double u[MOST];
    for (int k = first; k < last; k++) {
        for (size_t i = 0; i < input_count; i++) {
            u[i] = ((k / 10 * 7 + (int)i * 3) % 11 - 5) * 0.03125 / (i == 2 ? 1024.0 : 1.0);
        }
        DO(set_real(c, inputs, input_count, u));
        if (kind == fmi2ModelExchange) {
            integrate(c, k * STEP);
        } else {
            DO(do_step(c, k * STEP, STEP, fmi2True));
        }
        DO(get_real(c, outputs, output_count, y));
        if (print && (k + 1) % PRINT_EVERY == 0) {
            for (size_t i = 0; i < output_count; i++) {
                printf(i + 1 < output_count ? "%.17g " : "%.17g\n", y[i]);
            }
        }
    }
}

static void compare(const double a[MOST], const double b[MOST], const char *what)
{
    if (memcmp(a, b, output_count * sizeof a[0]) != 0) {
        fail(what);
    }
}

static void print_python(void)
{
    char line[4096];
    int count = 0;
    FILE *maps = fopen("/proc/self/maps", "r");
    while (maps != NULL && fgets(line, sizeof line, maps) != NULL) {
        if (strstr(line, "libpython") != NULL) {
            printf("%s", line);
            count++;
        }
    }
    if (maps != NULL) {
        fclose(maps);
    }
    if (count == 0) {
        puts("python: none");
    }
}

int main(int count, char **arguments)
{
    const fmi2CallbackFunctions callbacks = {log_message, calloc, free, NULL, NULL};
    double first[MOST] = {0.0}, again[MOST] = {0.0};
    fmi2FMUstate state = NULL, copy = NULL;
    size_t size = 0;
    if (count < 8 || count > 7 + MOST) {
        fail("wrong arguments");
    }
    kind = strcmp(arguments[4], "me") == 0 ? fmi2ModelExchange : fmi2CoSimulation;
    state_count = (size_t)atoi(arguments[5]);
    input_count = (size_t)atoi(arguments[6]);
    for (int i = 7; i < count; i++) {
        const fmi2ValueReference reference = (fmi2ValueReference)atoi(arguments[i]);
        const size_t k = (size_t)i - 7;
        if (k < input_count) {
            inputs[k] = reference;
        } else {
            outputs[output_count++] = reference;
        }
    }
    void *library = load(arguments[1]);
    if (library == NULL) {
        fail("the binary cannot be loaded");
    }
    find_all(library);
    if (instantiate("bad", kind, "{}", arguments[2], &callbacks, fmi2False, fmi2True) != NULL) {
        fail("a wrong GUID was accepted");
    }
    fmi2Component c = instantiate("one", kind, arguments[3], arguments[2], &callbacks, fmi2False, fmi2True);
    fmi2Component other = instantiate("two", kind, arguments[3], arguments[2], &callbacks, fmi2False, fmi2True);
    if (c == NULL || other == NULL) {
        fail("there is no instance");
    }
    initialize(c);
    run(c, 0, HALF, first, 1);
    DO(get_state(c, &state));
    run(c, HALF, STEPS, first, 1);

    DO(set_state(c, state));
    run(c, HALF, STEPS, again, 0);
    compare(first, again, "a rollback differs");

    DO(serialized_size(c, state, &size));
    char *bytes = malloc(size);
    if (bytes == NULL) {
        fail("no memory");
    }
    DO(serialize(c, state, bytes, size));
    DO(deserialize(other, bytes, size, &copy));
    DO(set_state(other, copy));
    run(other, HALF, STEPS, again, 0);
    compare(first, again, "a serialized state differs");
    free(bytes);
    DO(free_state(c, &state));
    DO(free_state(other, &copy));

    DO(terminate(c));
    DO(reset(c));
    initialize(c);
    run(c, 0, STEPS, again, 0);
    compare(first, again, "a run after a reset differs");
    free_instance(c);
    free_instance(other);
    print_python();
    return 0;
}
