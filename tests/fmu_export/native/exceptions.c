/* A host that unmasks floating-point exceptions, as those in Delphi, Ada or LabVIEW do: the first invalid operation,
 * division by zero or overflow ends it by SIGFPE.
 *
 *     exceptions BINARY RESOURCE_URI GUID OUTPUT INPUT... < CASES
 *
 * OUTPUT and INPUT are value references, of a Real output and of all inputs. Standard input: lines "case NAME", "int
 * REFERENCE VALUE", "real REFERENCE VALUE" (start values), then "row U_0 U_1 ...", one per step of 1 ms; "end" runs the
 * case. The first row is set after the first step: in initialization inputs are left at 0. Prints the case's name
 * before it runs.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fenv.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2FunctionTypes.h"

enum { MOST = 32, LINE = 1024 };

static fmi2InstantiateTYPE *instantiate;
static fmi2FreeInstanceTYPE *free_instance;
static fmi2SetupExperimentTYPE *setup_experiment;
static fmi2EnterInitializationModeTYPE *enter_initialization;
static fmi2ExitInitializationModeTYPE *exit_initialization;
static fmi2GetRealTYPE *get_real;
static fmi2SetRealTYPE *set_real;
static fmi2SetIntegerTYPE *set_integer;
static fmi2DoStepTYPE *do_step;

static void fail(const char *what)
{
    fprintf(stderr, "exceptions: %s\n", what);
    exit(1);
}

#define DO(call) (void)((call) == fmi2OK || (fail(#call), 0))

static void find(void *library, const char *name, void *function)
{
    void *found = dlsym(library, name);
    memcpy(function, &found, sizeof found);
    if (found == NULL) {
        fail(name);
    }
}

static void log_message(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                        fmi2String message, ...)
{
    (void)environment;
    (void)status;
    (void)category;
    fprintf(stderr, "%s: %s\n", name, message);
}

static void run(fmi2Component c, const fmi2ValueReference references[], size_t inputs, fmi2ValueReference output,
                char *line)
{
    double u[MOST], y, time = 0.0;
    DO(setup_experiment(c, fmi2False, 0.0, 0.0, fmi2False, 0.0));
    DO(enter_initialization(c));
    DO(exit_initialization(c));
    DO(do_step(c, time, 1e-3, fmi2True));
    while (strncmp(line, "row", 3) == 0) {
        const char *at = line + 3;
        char *after;
        for (size_t i = 0; i < inputs; i++, at = after) {
            u[i] = strtod(at, &after);
        }
        time += 1e-3;
        DO(set_real(c, references, inputs, u));
        DO(do_step(c, time, 1e-3, fmi2True));
        DO(get_real(c, &output, 1, &y));
        if (fgets(line, LINE, stdin) == NULL) {
            fail("the case has no end");
        }
    }
}

int main(int count, char **arguments)
{
    const fmi2CallbackFunctions callbacks = {log_message, calloc, free, NULL, NULL};
    char line[LINE];
    fmi2Component c = NULL;
    fmi2ValueReference references[MOST];
    if (count < 6 || count > 5 + MOST) {
        fail("wrong arguments");
    }
    void *library = dlopen(arguments[1], RTLD_NOW | RTLD_LOCAL);
    if (library == NULL) {
        fail(dlerror());
    }
    find(library, "fmi2Instantiate", &instantiate);
    find(library, "fmi2FreeInstance", &free_instance);
    find(library, "fmi2SetupExperiment", &setup_experiment);
    find(library, "fmi2EnterInitializationMode", &enter_initialization);
    find(library, "fmi2ExitInitializationMode", &exit_initialization);
    find(library, "fmi2GetReal", &get_real);
    find(library, "fmi2SetReal", &set_real);
    find(library, "fmi2SetInteger", &set_integer);
    find(library, "fmi2DoStep", &do_step);
    const size_t inputs = (size_t)count - 5;
    for (size_t i = 0; i < inputs; i++) {
        references[i] = (fmi2ValueReference)atoi(arguments[5 + i]);
    }
    feenableexcept(FE_INVALID | FE_DIVBYZERO | FE_OVERFLOW);
    while (fgets(line, sizeof line, stdin) != NULL) {
        unsigned reference;
        int whole;
        double real;
        if (strncmp(line, "case", 4) == 0) {
            fputs(line, stdout);
            fflush(stdout);
            c = instantiate("one", fmi2CoSimulation, arguments[3], arguments[2], &callbacks, fmi2False, fmi2True);
            if (c == NULL) {
                fail("there is no instance");
            }
        } else if (sscanf(line, "int %u %d", &reference, &whole) == 2) {
            DO(set_integer(c, &reference, 1, &whole));
        } else if (sscanf(line, "real %u %lf", &reference, &real) == 2) {
            DO(set_real(c, &reference, 1, &real));
        } else {
            run(c, references, inputs, (fmi2ValueReference)atoi(arguments[4]), line);
            free_instance(c);
        }
    }
    puts("done");
    return 0;
}
