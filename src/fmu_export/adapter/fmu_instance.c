#include "fmu_instance.h"

#include <float.h>
#include <math.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { ALIGNMENT = 16, MESSAGE_SIZE = 1024, STATE_FORMAT = 2 };

/* What a usual call does not come to is kept out of its way. */
#if defined __GNUC__
#define FMU_SELDOM __attribute__((noinline, cold))
#else
#define FMU_SELDOM
#endif

static const unsigned long SNAPSHOT_MAGIC = 0x464D5573ul; /* "FMUs" */
static const double TIME_TOLERANCE = 1e-6; /* of a step, between the end of one and the start of the next */

static const char *const TYPE_NAMES[] = {"Real", "Integer", "Boolean"};

/* ---- Log --------------------------------------------------------------------------------------------------------- */

/* Take away the beginning of a UTF-8 character at which a text was cut. */
static void trim(char *text)
{
    size_t length = strlen(text), tail = 0;
    while (tail < 3 && tail < length && ((unsigned char)text[length - 1 - tail] & 0xC0u) == 0x80u) {
        tail++;
    }
    if (tail < length) {
        const unsigned char lead = (unsigned char)text[length - 1 - tail];
        const size_t wanted = lead >= 0xF0u ? 3 : lead >= 0xE0u ? 2 : lead >= 0xC0u ? 1 : 0;
        if (wanted > tail) {
            text[length - 1 - tail] = '\0';
        }
    }
}

fmi2Status fmu_say(const fmu_instance *m, fmi2Status status, const char *format, ...)
{
    const int wanted = status == fmi2Warning ? m->log_warnings : m->log_errors;
    char text[MESSAGE_SIZE], escaped[2 * MESSAGE_SIZE];
    size_t length = 0;
    va_list arguments;
    if (!wanted || m->logger == NULL) {
        return status;
    }
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    trim(text);
    for (const char *c = text; *c != '\0'; c++) { /* FMI takes a message as a format */
        if (*c == '%') {
            escaped[length++] = '%';
        }
        escaped[length++] = *c;
    }
    escaped[length] = '\0';
    m->logger(m->environment, m->name, status, status == fmi2Warning ? "logStatusWarning" : "logStatusError", escaped);
    return status;
}

/* Append ", name = value" for each real input. */
static void list_inputs(const fmu_instance *m, char *text, size_t size)
{
    size_t length = strlen(text);
    for (size_t i = 0; i < m->unit->variable_count && length < size; i++) {
        const fmu_variable *v = &m->unit->variables[i];
        if (v->role == FMU_INPUT && m->of_type[FMU_REAL][i] != NULL) {
            const int written =
                snprintf(text + length, size - length, ", %s = %.9g", m->names[i], *(const double *)m->where[i]);
            length += written > 0 ? (size_t)written : 0;
        }
    }
}

/* Say what a unit's status means; fmi2OK for a warning, fmi2Error for a refusal. */
FMU_SELDOM static fmi2Status explain(const fmu_instance *m, int status, double time, double step)
{
    char text[MESSAGE_SIZE] = "";
    const fmu_severity severity =
        m->unit->explain(status, m->names, m->parameters, m->state, m->inputs, step, text, sizeof text);
    if (severity == FMU_WARNING) {
        fmu_say(m, fmi2Warning, "t = %.9g s: %s", time, text);
        return fmi2OK;
    }
    char inputs[MESSAGE_SIZE] = "";
    list_inputs(m, inputs, sizeof inputs);
    return fmu_say(m, fmi2Error, "%s\nat t = %.9g s%s", text, time, inputs);
}

/* ---- Creation ---------------------------------------------------------------------------------------------------- */

static size_t aligned(size_t size)
{
    return (size + ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT;
}

static void *struct_of(const fmu_instance *m, fmu_role role)
{
    return role == FMU_INPUT ? m->inputs : role == FMU_OUTPUT ? m->outputs : m->parameters;
}

static int allocate(fmu_instance *m)
{
    const fmu_unit *u = m->unit;
    const size_t sizes[5] = {u->parameters_size, u->inputs_size, u->outputs_size, u->prepared_size, u->state_size};
    void **const parts[5] = {&m->parameters, &m->inputs, &m->outputs, &m->prepared, &m->state};
    size_t offset = 0;
    for (int i = 0; i < 5; i++) {
        m->block_size += aligned(sizes[i]);
    }
    m->block = calloc(1, m->block_size);
    m->spare = calloc(1, m->block_size);
    m->start.values = calloc(u->variable_count, sizeof *m->start.values);
    m->start.names = calloc(u->variable_count, sizeof *m->start.names);
    m->names = calloc(u->variable_count, sizeof *m->names);
    m->where = calloc(5 * u->variable_count, sizeof *m->where);
    if (m->block == NULL || m->spare == NULL || m->start.values == NULL || m->start.names == NULL || m->names == NULL
        || m->where == NULL) {
        return 0;
    }
    for (int type = 0; type < 3; type++) {
        m->of_type[type] = m->where + (size_t)(type + 1) * u->variable_count;
    }
    m->plain = m->where + 4 * u->variable_count;
    for (int i = 0; i < 5; i++) {
        *parts[i] = m->block + offset;
        offset += aligned(sizes[i]);
    }
    m->outdated = m->block + m->block_size;
    m->derived = u->derive_outputs == NULL ? m->outdated : (unsigned char *)m->outputs + u->first_derived;
    return 1;
}

/* Have callers find the variables that are shown. */
static void show(fmu_instance *m)
{
    const fmu_unit *u = m->unit;
    for (size_t i = 0; i < u->variable_count; i++) {
        const fmu_variable *v = &u->variables[i];
        m->where[i] = (unsigned char *)struct_of(m, v->role) + v->offset;
        m->names[i] = m->start.names[i] == NULL ? v->name : m->start.names[i];
        if (m->start.names[i] == NULL) {
            continue;
        }
        m->of_type[v->type][i] = m->where[i];
        if (v->type == FMU_REAL && v->role == FMU_INPUT && v->min == -DBL_MAX && v->max == DBL_MAX) {
            m->plain[i] = m->where[i];
        }
    }
}

void fmu_set_start(fmu_instance *m)
{
    const fmu_progress fresh = {FMU_INSTANTIATED, 0, 0.0, 0.0, fmi2OK, 0};
    m->progress = fresh;
    m->outdated = m->block + m->block_size;
    memset(m->block, 0, m->block_size);
    for (size_t i = 0; i < m->unit->variable_count; i++) {
        const fmu_variable *v = &m->unit->variables[i];
        if (v->role == FMU_OUTPUT) {
            continue;
        }
        if (v->type == FMU_REAL) {
            *(double *)m->where[i] = m->start.values[i];
        } else {
            *(int *)m->where[i] = (int)m->start.values[i];
        }
    }
}

/* Whether a parameter or an input may have the value. */
static int in_range(const fmu_variable *v, double value)
{
    return isfinite(value) ? value >= v->min && value <= v->max : v->any_value;
}

/* A bound as it is told: the largest number stands for none. */
static double bound(double limit)
{
    return fabs(limit) < DBL_MAX ? limit : limit > 0.0 ? INFINITY : -INFINITY;
}

static int is_start_value(const fmu_variable *v, double value)
{
    const int fits = v->type == FMU_REAL || (value >= INT32_MIN && value <= INT32_MAX && value == floor(value));
    return isfinite(value) && fits && in_range(v, value);
}

fmu_instance *fmu_create(const fmu_unit *unit, const char *name, const char *resource_location, char *problem,
                         size_t problem_size)
{
    fmu_instance *m = calloc(1, sizeof *m);
    snprintf(problem, problem_size, "no memory for an instance of %s", unit->name);
    if (m == NULL) {
        return NULL;
    }
    m->unit = unit;
    m->name = calloc(strlen(name) + 1, 1);
    if (m->name == NULL || !allocate(m)) {
        fmu_destroy(m);
        return NULL;
    }
    memcpy(m->name, name, strlen(name));
    if (fmu_load_start_values(resource_location, &m->start, unit->variable_count, problem, problem_size) != 0) {
        fmu_destroy(m);
        return NULL;
    }
    show(m);
    for (size_t i = 0; i < unit->variable_count; i++) {
        const fmu_variable *v = &unit->variables[i];
        if (v->role != FMU_OUTPUT && !is_start_value(v, m->start.values[i])) {
            snprintf(problem, problem_size, "the start value of %s must be a%s in [%g, %g], found %.17g", m->names[i],
                     v->type == FMU_REAL ? " number" : "n integer", bound(v->min), bound(v->max), m->start.values[i]);
            fmu_destroy(m);
            return NULL;
        }
    }
    fmu_set_start(m);
    return m;
}

void fmu_destroy(fmu_instance *m)
{
    if (m != NULL) {
        free(m->name);
        free(m->block);
        free(m->spare);
        free(m->start.values);
        free(m->start.names);
        free(m->start.texts);
        free(m->names);
        free(m->where);
        free(m);
    }
}

/* ---- Running ----------------------------------------------------------------------------------------------------- */

static void read_outputs(fmu_instance *m)
{
    m->unit->get_outputs(m->parameters, m->prepared, m->state, m->outputs);
    m->outdated = m->derived;
}

/* Compute the outputs that are out of date. */
static void derive_outputs(fmu_instance *m)
{
    if (m->outdated == m->derived && m->unit->derive_outputs != NULL) {
        m->unit->derive_outputs(m->parameters, m->prepared, m->state, m->outputs);
        m->outdated = m->block + m->block_size;
    }
}

static void read_all_outputs(fmu_instance *m)
{
    read_outputs(m);
    derive_outputs(m);
}

fmi2Status fmu_observe(fmu_instance *m, const char *call)
{
    const int status = m->unit->continuous->hold(m->parameters, m->prepared, m->state, m->inputs);
    if (status != 0) {
        fmu_say(m, fmi2Error, "%s: the inputs must be finite", call);
        return fmi2Error;
    }
    read_all_outputs(m);
    return fmi2OK;
}

fmi2Status fmu_initialize(fmu_instance *m)
{
    const double time = m->progress.time;
    int status = m->unit->prepare(m->parameters, m->prepared);
    if (status == 0) {
        status = m->unit->initialize(m->parameters, m->prepared, m->state, time, m->inputs);
    }
    if (status != 0) {
        return explain(m, status, time, 0.0);
    }
    if (m->kind == fmi2ModelExchange) {
        const char *objection = m->unit->continuous->objection(m->parameters);
        if (objection != NULL) {
            return fmu_say(m, fmi2Error, "in model exchange %s", objection);
        }
        if (m->unit->continuous->count(m->parameters) != m->states) {
            return fmu_say(
                m, fmi2Error,
                "this FMU was exported with %lu continuous states; parameters that change their number can be "
                "set in co-simulation only",
                (unsigned long)m->states);
        }
        return fmu_observe(m, "initialization");
    }
    read_all_outputs(m);
    return fmi2OK;
}

const fmu_variable *fmu_find(const fmu_instance *m, fmi2ValueReference vr)
{
    return vr < m->unit->variable_count && m->start.names[vr] != NULL ? &m->unit->variables[vr] : NULL;
}

int fmu_state_index(const fmu_instance *m, fmi2ValueReference vr)
{
    for (size_t i = 0; m->kind == fmi2ModelExchange && i < m->states; i++) {
        if (m->unit->continuous->states[i] == vr) {
            return (int)i;
        }
    }
    return -1;
}

fmi2Status fmu_advance(fmu_instance *m, double time, double step)
{
    fmi2Status result = fmi2OK;
    if (!(step > 0.0 && step < INFINITY)) {
        return fmu_say(m, fmi2Error, "the communication step must be positive and finite, found %g s", step);
    }
    if (!(fabs(time - m->progress.time) <= TIME_TOLERANCE * step + 1e-12 * fabs(m->progress.time))) {
        return fmu_say(m, fmi2Error, "time must not jump: the last step ended at %.17g s, this begins at %.17g s",
                       m->progress.time, time);
    }
    if (m->progress.stop_defined
        && !(time + step <= m->progress.stop + TIME_TOLERANCE * step + 1e-12 * fabs(m->progress.stop))) {
        return fmu_say(m, fmi2Error, "a step must not pass the stop time %.17g s, found one that ends at %.17g s",
                       m->progress.stop, time + step);
    }
    const int status = m->unit->step(m->parameters, m->prepared, m->state, time, step, m->inputs);
    if (status != 0) {
        result = explain(m, status, time, step);
        if (result != fmi2OK) {
            return result;
        }
    }
    m->progress.time = time + step;
    read_outputs(m);
    return result;
}

/* ---- Variables --------------------------------------------------------------------------------------------------- */

FMU_SELDOM static fmi2Status unknown(const fmu_instance *m, fmu_type type, fmi2ValueReference vr)
{
    return fmu_say(m, fmi2Error, "no %s variable has the value reference %u", TYPE_NAMES[type], vr);
}

/* Bring outputs up to date where they may be older than inputs, states or parameters. */
FMU_SELDOM static fmi2Status refresh(fmu_instance *m, const fmi2ValueReference *vr, size_t count)
{
    const fmu_phase phase = m->progress.phase;
    for (size_t i = 0; i < count; i++) {
        const fmu_variable *v = fmu_find(m, vr[i]);
        if (v != NULL && v->role == FMU_OUTPUT) {
            if (phase == FMU_INSTANTIATED) {
                return fmu_say(m, fmi2Error, "outputs are defined from initialization on, asked for %s before it",
                               m->names[vr[i]]);
            }
            return phase == FMU_INITIALIZATION ? fmu_initialize(m) : fmu_observe(m, "get");
        }
    }
    return fmi2OK;
}

size_t fmu_copy(const fmu_instance *m, fmu_type type, const fmi2ValueReference *vr, size_t count, void *values)
{
    const size_t variables = m->unit->variable_count;
    void *const *where = m->of_type[type];
    for (size_t i = 0; i < count; i++) {
        if (vr[i] >= variables || where[vr[i]] == NULL || (const unsigned char *)where[vr[i]] >= m->outdated) {
            return i;
        }
        if (type == FMU_REAL) {
            ((double *)values)[i] = *(const double *)where[vr[i]];
        } else {
            ((int *)values)[i] = *(const int *)where[vr[i]];
        }
    }
    return count;
}

fmi2Status fmu_get(fmu_instance *m, fmu_type type, const fmi2ValueReference *vr, size_t count, void *values)
{
    if (m->progress.phase & (FMU_INSTANTIATED | FMU_INITIALIZATION | FMU_EVENT | FMU_CONTINUOUS)) {
        const fmi2Status status = refresh(m, vr, count);
        if (status != fmi2OK) {
            return status;
        }
    }
    size_t copied = fmu_copy(m, type, vr, count, values);
    if (copied < count) {
        derive_outputs(m);
        copied = fmu_copy(m, type, vr, count, values);
    }
    return copied < count ? unknown(m, type, vr[copied]) : fmi2OK;
}

static int settable(const fmu_instance *m, const fmu_variable *v)
{
    const int before = (m->progress.phase & (FMU_INSTANTIATED | FMU_INITIALIZATION)) != 0;
    switch (v->role) {
    case FMU_INPUT:
        return 1;
    case FMU_TUNABLE:
        return before || (m->progress.phase & (FMU_STEP | FMU_EVENT)) != 0;
    case FMU_FIXED:
        return before;
    default:
        return 0;
    }
}

/* Whether it is a continuous state that a solver may set now. */
static int is_free_state(const fmu_instance *m, fmi2ValueReference vr)
{
    return m->progress.phase == FMU_CONTINUOUS && fmu_state_index(m, vr) >= 0;
}

/* Whether a call may set the variable to the value now; says so where it may not. */
static int admissible(const fmu_instance *m, fmi2ValueReference vr, double value)
{
    const fmu_variable *v = &m->unit->variables[vr];
    const char *name = m->names[vr];
    if (v->role == FMU_OUTPUT && !is_free_state(m, vr)) {
        fmu_say(m, fmi2Error, "%s is an output and cannot be set", name);
        return 0;
    }
    if (v->role != FMU_OUTPUT && !settable(m, v)) {
        fmu_say(m, fmi2Error, "%s is a %s parameter, which cannot be set in this state", name,
                v->role == FMU_FIXED ? "fixed" : "tunable");
        return 0;
    }
    if (!in_range(v, value)) {
        if (isfinite(value)) {
            fmu_say(m, fmi2Error, "%s must lie in [%g, %g], found %g", name, bound(v->min), bound(v->max), value);
        } else {
            fmu_say(m, fmi2Error, "%s must be finite, found %g at t = %.9g s", name, value, m->progress.time);
        }
        return 0;
    }
    return 1;
}

static void assign(fmu_instance *m, fmu_type type, const fmi2ValueReference *vr, size_t count, const void *values)
{
    for (size_t i = 0; i < count; i++) {
        if (type == FMU_REAL) {
            double *place = is_free_state(m, vr[i]) ? m->unit->continuous->values(m->state) + fmu_state_index(m, vr[i])
                                                    : m->where[vr[i]];
            *place = ((const double *)values)[i];
        } else {
            const int value = ((const int *)values)[i];
            *(int *)m->where[vr[i]] = type == FMU_BOOLEAN ? value != 0 : value;
        }
    }
}

/* Set tunable parameters between steps: their consequences are computed at once, or everything stays as it was. */
static fmi2Status tune(fmu_instance *m, fmu_type type, const fmi2ValueReference *vr, size_t count, const void *values)
{
    const size_t before_state = (size_t)((unsigned char *)m->state - m->block);
    memcpy(m->spare, m->block, before_state);
    assign(m, type, vr, count, values);
    const int status = m->unit->prepare(m->parameters, m->prepared);
    if (status == 0) {
        return fmi2OK;
    }
    explain(m, status, m->progress.time, 0.0);
    memcpy(m->block, m->spare, before_state);
    return fmi2Error;
}

int fmu_set_inputs(fmu_instance *m, const fmi2ValueReference *vr, size_t count, const double *values)
{
    const size_t variables = m->unit->variable_count;
    for (size_t i = 0; i < count; i++) {
        if (vr[i] >= variables || m->plain[vr[i]] == NULL || !isfinite(values[i])) {
            return 0;
        }
    }
    for (size_t i = 0; i < count; i++) {
        *(double *)m->plain[vr[i]] = values[i];
    }
    return 1;
}

fmi2Status fmu_set(fmu_instance *m, fmu_type type, const fmi2ValueReference *vr, size_t count, const void *values)
{
    int tunable = 0;
    for (size_t i = 0; i < count; i++) {
        if (vr[i] >= m->unit->variable_count || m->of_type[type][vr[i]] == NULL) {
            return unknown(m, type, vr[i]);
        }
        const fmu_variable *v = &m->unit->variables[vr[i]];
        const double value = type == FMU_REAL ? ((const double *)values)[i]
            : type == FMU_BOOLEAN             ? ((const int *)values)[i] != 0
                                              : ((const int *)values)[i];
        if (!admissible(m, vr[i], value)) {
            return fmi2Error;
        }
        tunable |= v->role == FMU_TUNABLE;
    }
    if (tunable && m->progress.phase & (FMU_STEP | FMU_EVENT)) {
        return tune(m, type, vr, count, values);
    }
    assign(m, type, vr, count, values);
    return fmi2OK;
}

/* ---- State ------------------------------------------------------------------------------------------------------- */

/* Serialized: this header, the progress, the block. */
typedef struct {
    char magic[8];
    uint32_t format, kind;
    uint64_t size;     /* of everything */
    uint64_t checksum; /* of what follows the header */
    char model[32];
    char guid[FMU_GUID_SIZE];
} header;

fmu_snapshot *fmu_save(fmu_instance *m)
{
    derive_outputs(m); /* what is saved is whole */
    fmu_snapshot *s = calloc(1, sizeof *s);
    if (s == NULL) {
        return NULL;
    }
    s->block = malloc(m->block_size);
    if (s->block == NULL) {
        free(s);
        return NULL;
    }
    s->magic = SNAPSHOT_MAGIC;
    s->block_size = m->block_size;
    s->kind = m->kind;
    memcpy(s->guid, m->start.guid, sizeof s->guid);
    s->progress = m->progress;
    memcpy(s->block, m->block, m->block_size);
    return s;
}

void fmu_restore(fmu_instance *m, const fmu_snapshot *s)
{
    m->progress = s->progress;
    memcpy(m->block, s->block, m->block_size);
    m->outdated = m->block + m->block_size;
}

int fmu_is_snapshot(const fmu_instance *m, const fmu_snapshot *s)
{
    return s != NULL && s->magic == SNAPSHOT_MAGIC && s->block_size == m->block_size && s->kind == m->kind
        && memcmp(s->guid, m->start.guid, sizeof s->guid) == 0;
}

void fmu_free_snapshot(fmu_snapshot *s)
{
    if (s != NULL) {
        s->magic = 0;
        free(s->block);
        free(s);
    }
}

/* FNV-1a. */
static uint64_t checksum(const unsigned char *bytes, size_t size)
{
    uint64_t hash = UINT64_C(0xcbf29ce484222325);
    for (size_t i = 0; i < size; i++) {
        hash = (hash ^ bytes[i]) * UINT64_C(0x100000001b3);
    }
    return hash;
}

size_t fmu_serialized_size(const fmu_instance *m)
{
    return sizeof(header) + sizeof(fmu_progress) + m->block_size;
}

static header header_for(const fmu_instance *m)
{
    header h;
    memset(&h, 0, sizeof h);
    memcpy(h.magic, "FMUstate", 8);
    h.format = STATE_FORMAT;
    h.kind = (uint32_t)m->kind;
    h.size = fmu_serialized_size(m);
    snprintf(h.model, sizeof h.model, "%s", m->unit->name);
    memcpy(h.guid, m->start.guid, sizeof h.guid);
    return h;
}

void fmu_serialize(const fmu_instance *m, const fmu_snapshot *s, unsigned char *bytes)
{
    header h = header_for(m);
    unsigned char *body = bytes + sizeof h;
    memcpy(body, &s->progress, sizeof s->progress);
    memcpy(body + sizeof s->progress, s->block, m->block_size);
    h.checksum = checksum(body, fmu_serialized_size(m) - sizeof h);
    memcpy(bytes, &h, sizeof h);
}

/* Whether every value that a caller may set lies within its bounds in the block, which restored bytes need not. */
static int values_are_admissible(const fmu_instance *m, const unsigned char *block)
{
    for (size_t i = 0; i < m->unit->variable_count; i++) {
        const fmu_variable *v = &m->unit->variables[i];
        const unsigned char *at = block + ((unsigned char *)m->where[i] - m->block);
        double value;
        int number;
        if (v->role == FMU_OUTPUT) {
            continue;
        }
        if (v->type == FMU_REAL) {
            memcpy(&value, at, sizeof value);
        } else {
            memcpy(&number, at, sizeof number);
            value = number;
        }
        if (!in_range(v, value)) {
            return 0;
        }
    }
    return 1;
}

static int is_phase(fmu_phase phase, fmi2Type kind)
{
    const int any = phase == FMU_INSTANTIATED || phase == FMU_INITIALIZATION || phase == FMU_TERMINATED;
    return any || (kind == fmi2CoSimulation ? phase == FMU_STEP : phase == FMU_EVENT || phase == FMU_CONTINUOUS);
}

fmu_snapshot *fmu_deserialize(fmu_instance *m, const unsigned char *bytes, size_t size)
{
    const header expected = header_for(m);
    header h;
    if (size != expected.size) {
        fmu_say(m, fmi2Error, "a serialized state must have %lu bytes, found %lu", (unsigned long)expected.size,
                (unsigned long)size);
        return NULL;
    }
    memcpy(&h, bytes, sizeof h);
    const uint64_t found = h.checksum;
    h.checksum = 0;
    if (memcmp(&h, &expected, sizeof h) != 0) {
        fmu_say(m, fmi2Error, "the bytes are no state of this FMU with GUID %s", m->start.guid);
        return NULL;
    }
    const unsigned char *body = bytes + sizeof h;
    fmu_snapshot *s = fmu_save(m);
    if (s == NULL) {
        fmu_say(m, fmi2Error, "no memory for a state");
        return NULL;
    }
    memcpy(&s->progress, body, sizeof s->progress);
    memcpy(s->block, body + sizeof s->progress, m->block_size);
    const unsigned char *state = s->block + ((unsigned char *)m->state - m->block);
    const int initialized = (s->progress.phase & (FMU_INSTANTIATED | FMU_INITIALIZATION)) == 0;
    if (found != checksum(body, size - sizeof h) || !is_phase(s->progress.phase, m->kind)
        || !values_are_admissible(m, s->block) || (initialized && !m->unit->state_is_valid(state))) {
        fmu_say(m, fmi2Error, "the serialized state is damaged");
        fmu_free_snapshot(s);
        return NULL;
    }
    return s;
}
