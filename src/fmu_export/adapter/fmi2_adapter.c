/* The C interface of FMI 2.0.5 over an fmu_instance: which call is allowed when, and what its arguments must be. */
#include "fmu_model.h" /* FMI2_FUNCTION_PREFIX */
#include "fmi2Functions.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "fmu_instance.h"

enum {
    PROBLEM_SIZE = 1024,
    RUNNING = FMU_STEP | FMU_EVENT | FMU_CONTINUOUS,
    SETTABLE = FMU_INSTANTIATED | FMU_INITIALIZATION | RUNNING,
    ANY_PHASE = SETTABLE | FMU_TERMINATED,
    READABLE = FMU_INITIALIZATION | RUNNING | FMU_TERMINATED
};

static const char *phase_name(fmu_phase phase)
{
    switch (phase) {
    case FMU_INSTANTIATED:
        return "instantiated";
    case FMU_INITIALIZATION:
        return "initialization mode";
    case FMU_STEP:
        return "step";
    case FMU_EVENT:
        return "event mode";
    case FMU_CONTINUOUS:
        return "continuous-time mode";
    default:
        return "terminated";
    }
}

/* Whether `call` is allowed in the present phase; says so where it is not. */
static int allowed(const fmu_instance *m, const char *call, unsigned phases)
{
    if (m == NULL) {
        return 0;
    }
    if ((m->progress.phase & phases) == 0) {
        fmu_say(m, fmi2Error, "%s is not allowed in the state '%s'", call, phase_name(m->progress.phase));
        return 0;
    }
    return 1;
}

static int present(const fmu_instance *m, const char *call, const void *pointer, size_t count)
{
    if (pointer == NULL && count > 0) {
        fmu_say(m, fmi2Error, "%s: a pointer is missing", call);
        return 0;
    }
    return 1;
}

static fmi2Status unsupported(fmi2Component c, const char *call, const char *reason)
{
    const fmu_instance *m = c;
    return m == NULL ? fmi2Error : fmu_say(m, fmi2Error, "%s: %s", call, reason);
}

/* ---- Common ------------------------------------------------------------------------------------------------------ */

const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                              fmi2String fmuResourceLocation, const fmi2CallbackFunctions *functions,
                              fmi2Boolean visible, fmi2Boolean loggingOn)
{
    fmu_instance early; /* to log with before there is an instance */
    char problem[PROBLEM_SIZE], name[] = "unnamed";
    (void)visible;
    if (functions == NULL || functions->logger == NULL) {
        return NULL;
    }
    memset(&early, 0, sizeof early);
    early.name = name;
    early.logger = functions->logger;
    early.environment = functions->componentEnvironment;
    early.log_errors = 1;
    if (instanceName == NULL || instanceName[0] == '\0') {
        fmu_say(&early, fmi2Error, "fmi2Instantiate: an instance must have a name");
        return NULL;
    }
    if (fmuType != fmi2CoSimulation && fmuType != fmi2ModelExchange) {
        fmu_say(&early, fmi2Error, "%s has no kind %d", fmu_the_unit.name, (int)fmuType);
        return NULL;
    }
    if (fmuType == fmi2ModelExchange && fmu_the_unit.continuous == NULL) {
        fmu_say(&early, fmi2Error, "%s is not for model exchange", fmu_the_unit.name);
        return NULL;
    }
    fmu_instance *m = fmu_create(&fmu_the_unit, instanceName, fmuResourceLocation, problem, sizeof problem);
    if (m == NULL) {
        fmu_say(&early, fmi2Error, "%s: %s", instanceName, problem);
        return NULL;
    }
    m->logger = early.logger;
    m->environment = early.environment;
    m->kind = fmuType;
    m->log_errors = 1;
    m->log_warnings = loggingOn;
    if (fmuGUID == NULL || strcmp(fmuGUID, m->start.guid) != 0) {
        fmu_say(m, fmi2Error, "the GUID must be %s as in this FMU's modelDescription.xml, found %s", m->start.guid,
                fmuGUID == NULL ? "none" : fmuGUID);
        fmu_destroy(m);
        return NULL;
    }
    if (m->unit->continuous != NULL) {
        m->states = m->unit->continuous->count(m->parameters);
    }
    return m;
}

void fmi2FreeInstance(fmi2Component c)
{
    fmu_destroy(c);
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories,
                               const fmi2String categories[])
{
    fmu_instance *m = c;
    int errors = nCategories == 0, warnings = nCategories == 0;
    if (!allowed(m, "fmi2SetDebugLogging", ANY_PHASE) || !present(m, "fmi2SetDebugLogging", categories, nCategories)) {
        return fmi2Error;
    }
    for (size_t i = 0; i < nCategories; i++) {
        const char *category = categories[i] == NULL ? "" : categories[i];
        const int all = strcmp(category, "logAll") == 0;
        const int error = strcmp(category, "logStatusError") == 0, warning = strcmp(category, "logStatusWarning") == 0;
        if (!all && !error && !warning) {
            return fmu_say(m, fmi2Error, "fmi2SetDebugLogging: there is no log category '%s'", category);
        }
        errors |= all || error;
        warnings |= all || warning;
    }
    m->log_errors = errors ? loggingOn : m->log_errors;
    m->log_warnings = warnings ? loggingOn : m->log_warnings;
    return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real startTime,
                               fmi2Boolean stopTimeDefined, fmi2Real stopTime)
{
    fmu_instance *m = c;
    (void)toleranceDefined;
    (void)tolerance;
    if (!allowed(m, "fmi2SetupExperiment", FMU_INSTANTIATED)) {
        return fmi2Error;
    }
    if (!isfinite(startTime)) {
        return fmu_say(m, fmi2Error, "the start time must be finite, found %g", startTime);
    }
    if (stopTimeDefined && !(stopTime >= startTime)) {
        return fmu_say(m, fmi2Error, "the stop time must not be before the start time %g s, found %g", startTime,
                       stopTime);
    }
    m->progress.experiment_set = 1;
    m->progress.time = startTime;
    m->progress.stop_defined = stopTimeDefined != fmi2False;
    m->progress.stop = stopTimeDefined ? stopTime : 0.0;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    fmu_instance *m = c;
    if (!allowed(m, "fmi2EnterInitializationMode", FMU_INSTANTIATED)) {
        return fmi2Error;
    }
    if (!m->progress.experiment_set) {
        return fmu_say(m, fmi2Error, "fmi2EnterInitializationMode needs fmi2SetupExperiment before it");
    }
    m->progress.phase = FMU_INITIALIZATION;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    fmu_instance *m = c;
    if (!allowed(m, "fmi2ExitInitializationMode", FMU_INITIALIZATION)) {
        return fmi2Error;
    }
    const fmi2Status status = fmu_initialize(m);
    if (status == fmi2OK) {
        m->progress.phase = m->kind == fmi2CoSimulation ? FMU_STEP : FMU_EVENT;
    }
    return status;
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    fmu_instance *m = c;
    if (!allowed(m, "fmi2Terminate", RUNNING)) {
        return fmi2Error;
    }
    m->progress.phase = FMU_TERMINATED;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c)
{
    fmu_instance *m = c;
    if (!allowed(m, "fmi2Reset", ANY_PHASE)) {
        return fmi2Error;
    }
    fmu_set_start(m);
    return fmi2OK;
}

/* ---- Variables --------------------------------------------------------------------------------------------------- */

static fmi2Status get(fmi2Component c, const char *call, fmu_type type, const fmi2ValueReference vr[], size_t nvr,
                      void *value)
{
    fmu_instance *m = c;
    if (!allowed(m, call, ANY_PHASE) || !present(m, call, vr, nvr) || !present(m, call, value, nvr)) {
        return fmi2Error;
    }
    return fmu_get(m, type, vr, nvr, value);
}

static fmi2Status set(fmi2Component c, const char *call, fmu_type type, const fmi2ValueReference vr[], size_t nvr,
                      const void *value)
{
    fmu_instance *m = c;
    const unsigned phases = type == FMU_REAL ? SETTABLE : SETTABLE & ~(unsigned)FMU_CONTINUOUS;
    if (!allowed(m, call, phases) || !present(m, call, vr, nvr) || !present(m, call, value, nvr)) {
        return fmi2Error;
    }
    return fmu_set(m, type, vr, nvr, value);
}

/* Whether nothing about a call needs a closer look: an instance between two steps, no pointer missing. */
static int is_usual(const fmu_instance *m, const void *vr, const void *value)
{
    return m != NULL && vr != NULL && value != NULL && m->progress.phase == FMU_STEP;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[])
{
    return is_usual(c, vr, value) && fmu_copy(c, FMU_REAL, vr, nvr, value) == nvr
        ? fmi2OK
        : get(c, "fmi2GetReal", FMU_REAL, vr, nvr, value);
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Integer value[])
{
    return is_usual(c, vr, value) && fmu_copy(c, FMU_INTEGER, vr, nvr, value) == nvr
        ? fmi2OK
        : get(c, "fmi2GetInteger", FMU_INTEGER, vr, nvr, value);
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Boolean value[])
{
    return get(c, "fmi2GetBoolean", FMU_BOOLEAN, vr, nvr, value);
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2String value[])
{
    (void)vr;
    (void)value;
    return c != NULL && nvr == 0 ? fmi2OK : unsupported(c, "fmi2GetString", "there are no String variables");
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Real value[])
{
    return is_usual(c, vr, value) && fmu_set_inputs(c, vr, nvr, value)
        ? fmi2OK
        : set(c, "fmi2SetReal", FMU_REAL, vr, nvr, value);
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Integer value[])
{
    return set(c, "fmi2SetInteger", FMU_INTEGER, vr, nvr, value);
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Boolean value[])
{
    return set(c, "fmi2SetBoolean", FMU_BOOLEAN, vr, nvr, value);
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2String value[])
{
    (void)vr;
    (void)value;
    return c != NULL && nvr == 0 ? fmi2OK : unsupported(c, "fmi2SetString", "there are no String variables");
}

/* ---- State ------------------------------------------------------------------------------------------------------- */

static int is_state(const fmu_instance *m, const char *call, const fmu_snapshot *s)
{
    if (fmu_is_snapshot(m, s)) {
        return 1;
    }
    fmu_say(m, fmi2Error, "%s: the pointer is no state of this FMU", call);
    return 0;
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    fmu_instance *m = c;
    if (!allowed(m, "fmi2GetFMUstate", ANY_PHASE) || !present(m, "fmi2GetFMUstate", FMUstate, 1)) {
        return fmi2Error;
    }
    if (*FMUstate != NULL && !is_state(m, "fmi2GetFMUstate", *FMUstate)) {
        return fmi2Error;
    }
    fmu_snapshot *s = fmu_save(m);
    if (s == NULL) {
        return fmu_say(m, fmi2Error, "no memory for a state");
    }
    fmu_free_snapshot(*FMUstate);
    *FMUstate = s;
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate)
{
    fmu_instance *m = c;
    const fmu_snapshot *s = FMUstate;
    if (!allowed(m, "fmi2SetFMUstate", ANY_PHASE) || !is_state(m, "fmi2SetFMUstate", s)) {
        return fmi2Error;
    }
    fmu_restore(m, s);
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    fmu_instance *m = c;
    if (!allowed(m, "fmi2FreeFMUstate", ANY_PHASE) || !present(m, "fmi2FreeFMUstate", FMUstate, 1)) {
        return fmi2Error;
    }
    if (*FMUstate != NULL) {
        if (!is_state(m, "fmi2FreeFMUstate", *FMUstate)) {
            return fmi2Error;
        }
        fmu_free_snapshot(*FMUstate);
        *FMUstate = NULL;
    }
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size)
{
    fmu_instance *m = c;
    if (!allowed(m, "fmi2SerializedFMUstateSize", ANY_PHASE) || !present(m, "fmi2SerializedFMUstateSize", size, 1)
        || !is_state(m, "fmi2SerializedFMUstateSize", FMUstate)) {
        return fmi2Error;
    }
    *size = fmu_serialized_size(m);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[], size_t size)
{
    fmu_instance *m = c;
    if (!allowed(m, "fmi2SerializeFMUstate", ANY_PHASE) || !present(m, "fmi2SerializeFMUstate", serializedState, size)
        || !is_state(m, "fmi2SerializeFMUstate", FMUstate)) {
        return fmi2Error;
    }
    if (size < fmu_serialized_size(m)) {
        return fmu_say(m, fmi2Error, "fmi2SerializeFMUstate needs %lu bytes, found %lu",
                       (unsigned long)fmu_serialized_size(m), (unsigned long)size);
    }
    fmu_serialize(m, FMUstate, (unsigned char *)serializedState);
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size,
                                   fmi2FMUstate *FMUstate)
{
    fmu_instance *m = c;
    if (!allowed(m, "fmi2DeSerializeFMUstate", ANY_PHASE) || !present(m, "fmi2DeSerializeFMUstate", FMUstate, 1)
        || !present(m, "fmi2DeSerializeFMUstate", serializedState, size)) {
        return fmi2Error;
    }
    if (*FMUstate != NULL && !is_state(m, "fmi2DeSerializeFMUstate", *FMUstate)) {
        return fmi2Error;
    }
    fmu_snapshot *s = fmu_deserialize(m, (const unsigned char *)serializedState, size);
    if (s == NULL) {
        return fmi2Error;
    }
    fmu_free_snapshot(*FMUstate);
    *FMUstate = s;
    return fmi2OK;
}

/* ---- Directional derivatives ------------------------------------------------------------------------------------- */

/* Room for a unit's inputs or outputs. */
typedef union {
    double aligned;
    unsigned char bytes[FMU_MOST_BYTES];
} room;

/* Spread the seeds over states and inputs. */
static fmi2Status seed(const fmu_instance *m, const fmi2ValueReference known[], size_t count, const fmi2Real seeds[],
                       double dx[FMU_MOST_STATES], room *dinputs)
{
    for (size_t i = 0; i < count; i++) {
        const fmu_variable *v = fmu_find(m, known[i]);
        const int state = fmu_state_index(m, known[i]);
        if (state >= 0) {
            dx[state] += seeds[i];
        } else if (v != NULL && v->role == FMU_INPUT && v->type == FMU_REAL) {
            double sum;
            memcpy(&sum, dinputs->bytes + v->offset, sizeof sum);
            sum += m->kind == fmi2ModelExchange ? seeds[i] : 0.0; /* a step's inputs are held: they act in the next */
            memcpy(dinputs->bytes + v->offset, &sum, sizeof sum);
        } else {
            return fmu_say(m, fmi2Error, "there is no derivative with respect to %s",
                           v == NULL ? "a value reference that does not exist" : m->names[known[i]]);
        }
    }
    return fmi2OK;
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference vUnknown_ref[], size_t nUnknown,
                                        const fmi2ValueReference vKnown_ref[], size_t nKnown, const fmi2Real dvKnown[],
                                        fmi2Real dvUnknown[])
{
    static const char call[] = "fmi2GetDirectionalDerivative";
    fmu_instance *m = c;
    double dx[FMU_MOST_STATES] = {0.0};
    room dinputs, doutputs;
    if (!allowed(m, call, READABLE) || !present(m, call, vUnknown_ref, nUnknown)
        || !present(m, call, vKnown_ref, nKnown) || !present(m, call, dvKnown, nKnown)
        || !present(m, call, dvUnknown, nUnknown)) {
        return fmi2Error;
    }
    if (m->unit->continuous == NULL) {
        return fmu_say(m, fmi2Error, "%s has no directional derivatives", m->unit->name);
    }
    memset(&dinputs, 0, sizeof dinputs);
    fmi2Status status = seed(m, vKnown_ref, nKnown, dvKnown, dx, &dinputs);
    if (status == fmi2OK && m->progress.phase == FMU_INITIALIZATION) {
        status = fmu_initialize(m);
    } else if (status == fmi2OK && m->kind == fmi2ModelExchange) {
        status = fmu_observe(m, call);
    }
    if (status != fmi2OK) {
        return status;
    }
    for (size_t i = 0; i < nUnknown; i++) {
        const fmu_variable *v = fmu_find(m, vUnknown_ref[i]);
        if (v == NULL || v->role != FMU_OUTPUT || v->type != FMU_REAL) {
            return fmu_say(m, fmi2Error, "there is no derivative of %s",
                           v == NULL ? "a value reference that does not exist" : m->names[vUnknown_ref[i]]);
        }
    }
    m->unit->continuous->tangent(m->parameters, m->prepared, m->state, m->inputs, dx, &dinputs, &doutputs);
    for (size_t i = 0; i < nUnknown; i++) {
        memcpy(&dvUnknown[i], doutputs.bytes + m->unit->variables[vUnknown_ref[i]].offset, sizeof dvUnknown[i]);
    }
    return fmi2OK;
}

/* ---- Co-simulation ----------------------------------------------------------------------------------------------- */

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint)
{
    fmu_instance *m = c;
    (void)noSetFMUStatePriorToCurrentPoint;
    if (!allowed(m, "fmi2DoStep", FMU_STEP)) {
        return fmi2Error;
    }
    return m->progress.last_status = fmu_advance(m, currentCommunicationPoint, communicationStepSize);
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
    return unsupported(c, "fmi2CancelStep", "steps end before fmi2DoStep returns");
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                       const fmi2Integer order[], const fmi2Real value[])
{
    (void)vr;
    (void)nvr;
    (void)order;
    (void)value;
    return unsupported(c, "fmi2SetRealInputDerivatives", "inputs are held during a step");
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                        const fmi2Integer order[], fmi2Real value[])
{
    (void)vr;
    (void)nvr;
    (void)order;
    (void)value;
    return unsupported(c, "fmi2GetRealOutputDerivatives", "derivatives of outputs are not provided");
}

/* Whether a status may be asked for: from the first step on. */
static int has_status(const fmu_instance *m, const char *call, const void *value)
{
    if (!allowed(m, call, FMU_STEP | FMU_TERMINATED) || !present(m, call, value, 1)) {
        return 0;
    }
    if (m->kind != fmi2CoSimulation) {
        fmu_say(m, fmi2Error, "%s is for co-simulation", call);
        return 0;
    }
    return 1;
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind s, fmi2Status *value)
{
    const fmu_instance *m = c;
    if (!has_status(m, "fmi2GetStatus", value)) {
        return fmi2Error;
    }
    if (s != fmi2DoStepStatus) {
        return fmi2Discard;
    }
    *value = m->progress.last_status;
    return fmi2OK;
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *value)
{
    const fmu_instance *m = c;
    if (!has_status(m, "fmi2GetRealStatus", value)) {
        return fmi2Error;
    }
    if (s != fmi2LastSuccessfulTime) {
        return fmi2Discard;
    }
    *value = m->progress.time;
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind s, fmi2Integer *value)
{
    (void)s;
    return has_status(c, "fmi2GetIntegerStatus", value) ? fmi2Discard : fmi2Error; /* no kind is an Integer */
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind s, fmi2Boolean *value)
{
    const fmu_instance *m = c;
    if (!has_status(m, "fmi2GetBooleanStatus", value)) {
        return fmi2Error;
    }
    if (s != fmi2Terminated) {
        return fmi2Discard;
    }
    *value = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind s, fmi2String *value)
{
    (void)s;
    return has_status(c, "fmi2GetStringStatus", value) ? fmi2Discard : fmi2Error; /* no step is pending */
}

/* ---- Model exchange ---------------------------------------------------------------------------------------------- */

/* Whether `call` is allowed in the phase and `count` is the number that it must be. */
static int fits(const fmu_instance *m, const char *call, unsigned phases, const void *pointer, size_t count,
                size_t expected)
{
    if (!allowed(m, call, phases) || !present(m, call, pointer, count)) {
        return 0;
    }
    if (m->kind != fmi2ModelExchange) {
        fmu_say(m, fmi2Error, "%s is for model exchange", call);
        return 0;
    }
    if (count != expected) {
        fmu_say(m, fmi2Error, "%s must be for %lu values, found %lu", call, (unsigned long)expected,
                (unsigned long)count);
        return 0;
    }
    return 1;
}

fmi2Status fmi2EnterEventMode(fmi2Component c)
{
    fmu_instance *m = c;
    if (!allowed(m, "fmi2EnterEventMode", FMU_CONTINUOUS | FMU_EVENT)) {
        return fmi2Error;
    }
    m->progress.phase = FMU_EVENT;
    return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *fmi2eventInfo)
{
    static const fmi2EventInfo nothing = {fmi2False, fmi2False, fmi2False, fmi2False, fmi2False, 0.0};
    fmu_instance *m = c;
    if (!allowed(m, "fmi2NewDiscreteStates", FMU_EVENT) || !present(m, "fmi2NewDiscreteStates", fmi2eventInfo, 1)) {
        return fmi2Error;
    }
    *fmi2eventInfo = nothing;
    return fmi2OK;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c)
{
    fmu_instance *m = c;
    if (!allowed(m, "fmi2EnterContinuousTimeMode", FMU_EVENT)) {
        return fmi2Error;
    }
    m->progress.phase = FMU_CONTINUOUS;
    return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi2Boolean *enterEventMode, fmi2Boolean *terminateSimulation)
{
    fmu_instance *m = c;
    (void)noSetFMUStatePriorToCurrentPoint;
    if (!allowed(m, "fmi2CompletedIntegratorStep", FMU_CONTINUOUS)
        || !present(m, "fmi2CompletedIntegratorStep", enterEventMode, 1)
        || !present(m, "fmi2CompletedIntegratorStep", terminateSimulation, 1)) {
        return fmi2Error;
    }
    *enterEventMode = *terminateSimulation = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time)
{
    fmu_instance *m = c;
    if (!allowed(m, "fmi2SetTime", FMU_EVENT | FMU_CONTINUOUS)) {
        return fmi2Error;
    }
    if (!isfinite(time)) {
        return fmu_say(m, fmi2Error, "the time must be finite, found %g", time);
    }
    m->progress.time = time;
    return fmi2OK;
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t nx)
{
    fmu_instance *m = c;
    if (!fits(m, "fmi2SetContinuousStates", FMU_CONTINUOUS, x, nx, m == NULL ? 0 : m->states)) {
        return fmi2Error;
    }
    for (size_t i = 0; i < nx; i++) {
        if (!isfinite(x[i])) {
            fmu_say(m, fmi2Discard, "%s must be finite, found %g at t = %.9g s",
                    m->names[m->unit->continuous->states[i]], x[i], m->progress.time);
            return fmi2Discard; /* a solver may try a shorter step */
        }
    }
    memcpy(m->unit->continuous->values(m->state), x, nx * sizeof x[0]);
    return fmi2OK;
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t nx)
{
    fmu_instance *m = c;
    if (!fits(m, "fmi2GetContinuousStates", READABLE, x, nx, m == NULL ? 0 : m->states)) {
        return fmi2Error;
    }
    if (m->progress.phase == FMU_INITIALIZATION && fmu_initialize(m) != fmi2OK) {
        return fmi2Error;
    }
    memcpy(x, m->unit->continuous->values(m->state), nx * sizeof x[0]);
    return fmi2OK;
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real derivatives[], size_t nx)
{
    fmu_instance *m = c;
    if (!fits(m, "fmi2GetDerivatives", READABLE, derivatives, nx, m == NULL ? 0 : m->states)) {
        return fmi2Error;
    }
    const fmi2Status status =
        m->progress.phase == FMU_INITIALIZATION ? fmu_initialize(m) : fmu_observe(m, "fmi2GetDerivatives");
    for (size_t i = 0; status == fmi2OK && i < nx; i++) {
        derivatives[i] = *(const double *)m->where[m->unit->continuous->derivatives[i]];
        if (!isfinite(derivatives[i])) {
            return fmi2Discard;
        }
    }
    return status;
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x_nominal[], size_t nx)
{
    fmu_instance *m = c;
    if (!fits(m, "fmi2GetNominalsOfContinuousStates", ANY_PHASE, x_nominal, nx, m == NULL ? 0 : m->states)) {
        return fmi2Error;
    }
    for (size_t i = 0; i < nx; i++) {
        x_nominal[i] = 1.0;
    }
    return fmi2OK;
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real eventIndicators[], size_t ni)
{
    fmu_instance *m = c;
    return fits(m, "fmi2GetEventIndicators", READABLE, eventIndicators, ni, 0) ? fmi2OK : fmi2Error;
}
