/* Calls all FMI functions of a unit in random order with random arguments; linked with the unit's sources.
 *
 *     fuzz RESOURCE_URI GUID SEED CALLS LARGEST forge|honest
 *
 * LARGEST bounds finite numbers among the arguments. With `forge` damaged bytes of a state have the right checksum. The
 * same arguments give the same calls. Prints per function how many calls succeeded; it is for sanitizers to find
 * faults.
 */
#include <math.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

enum { SLOTS = 3, STATES = 3, MOST_REFERENCES = 128, HEADER = 128, CHECKSUM = 24 };

typedef struct {
    fmi2Component c;
    fmi2FMUstate states[STATES];
} slot;

static uint64_t seed;
static double largest;
static int forging;
static long messages;

static uint64_t draw(void)
{
    uint64_t z = (seed += UINT64_C(0x9E3779B97F4A7C15));
    z = (z ^ (z >> 30)) * UINT64_C(0xBF58476D1CE4E5B9);
    z = (z ^ (z >> 27)) * UINT64_C(0x94D049BB133111EB);
    return z ^ (z >> 31);
}

static unsigned below(unsigned limit)
{
    return (unsigned)(draw() % limit);
}

static double uniform(void)
{
    return (double)(draw() >> 11) * 0x1p-53;
}

static double number(void)
{
    static const double special[] = {0.0, -0.0, 1.0, 2.0, 1e-3, 3.14159, 1e-310, 5e-324};
    const double sign = below(2) ? 1.0 : -1.0;
    switch (below(16)) {
    case 0:
        return NAN;
    case 1:
        return sign * (double)INFINITY;
    case 2:
        return sign * largest;
    case 3:
        return special[below(sizeof special / sizeof special[0])];
    case 4:
    case 5:
        return sign * pow(largest, 2.0 * uniform() - 1.0);
    default:
        return sign * uniform();
    }
}

static int integer(void)
{
    static const int special[] = {INT32_MIN, INT32_MAX, -1, 0, 1, 2, 3, 4, 60, 61, 2048};
    return below(4) == 0 ? (int)(uint32_t)draw() : special[below(sizeof special / sizeof special[0])];
}

static void take_message(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                         fmi2String message, ...)
{
    char text[4096];
    va_list arguments;
    (void)environment;
    va_start(arguments, message);
    vsnprintf(text, sizeof text, message, arguments);
    va_end(arguments);
    if (strlen(name) == 0 || strlen(category) == 0 || strlen(text) == 0
        || (status != fmi2Warning && status < fmi2Discard)) {
        abort();
    }
    messages++;
}

static const fmi2CallbackFunctions CALLBACKS = {take_message, NULL, NULL, NULL, NULL};

/* Memory of exactly the size, so that the sanitizer sees a byte too many; NULL now and then. */
static void *room(size_t size)
{
    return below(200) == 0 ? NULL : malloc(size);
}

static fmi2ValueReference *draw_references(size_t count)
{
    fmi2ValueReference *vr = room(count * sizeof *vr);
    for (size_t i = 0; vr != NULL && i < count; i++) {
        vr[i] = below(40) == 0 ? (fmi2ValueReference)draw() : below(below(2) ? MOST_REFERENCES : 16);
    }
    return vr;
}

static double *draw_numbers(size_t count)
{
    double *values = room(count * sizeof *values);
    for (size_t i = 0; values != NULL && i < count; i++) {
        values[i] = number();
    }
    return values;
}

static int *draw_integers(size_t count)
{
    int *values = room(count * sizeof *values);
    for (size_t i = 0; values != NULL && i < count; i++) {
        values[i] = integer();
    }
    return values;
}

static fmi2Status variables(fmi2Component c, unsigned which)
{
    const size_t count = below(5);
    fmi2ValueReference *vr = draw_references(count);
    double *reals = draw_numbers(count);
    int *integers = draw_integers(count);
    const char **texts = room(count * sizeof *texts);
    fmi2Status status;
    for (size_t i = 0; texts != NULL && i < count; i++) {
        texts[i] = "%s%n";
    }
    switch (which) {
    case 0:
        status = fmi2GetReal(c, vr, count, reals);
        break;
    case 1:
        status = fmi2GetInteger(c, vr, count, integers);
        break;
    case 2:
        status = fmi2GetBoolean(c, vr, count, integers);
        break;
    case 3:
        status = fmi2SetReal(c, vr, count, reals);
        break;
    case 4:
        status = fmi2SetInteger(c, vr, count, integers);
        break;
    case 5:
        status = fmi2SetBoolean(c, vr, count, integers);
        break;
    case 6:
        status = fmi2GetString(c, vr, count, texts);
        break;
    case 7:
        status = fmi2SetString(c, vr, count, texts);
        break;
    case 8:
        status = fmi2SetRealInputDerivatives(c, vr, count, integers, reals);
        break;
    default:
        status = fmi2GetRealOutputDerivatives(c, vr, count, integers, reals);
    }
    free(vr);
    free(reals);
    free(integers);
    free(texts);
    return status;
}

static fmi2Status derivative(fmi2Component c)
{
    const size_t unknowns = below(14), knowns = below(8);
    fmi2ValueReference *u = draw_references(unknowns), *k = draw_references(knowns);
    double *dk = draw_numbers(knowns), *du = draw_numbers(unknowns);
    const fmi2Status status = fmi2GetDirectionalDerivative(c, u, unknowns, k, knowns, dk, du);
    free(u);
    free(k);
    free(dk);
    free(du);
    return status;
}

static fmi2Status continuous(fmi2Component c, unsigned which)
{
    const size_t count = below(8) == 0 ? below(8) : 4;
    double *x = draw_numbers(count);
    fmi2Status status;
    switch (which) {
    case 0:
        status = fmi2SetContinuousStates(c, x, count);
        break;
    case 1:
        status = fmi2GetContinuousStates(c, x, count);
        break;
    case 2:
        status = fmi2GetDerivatives(c, x, count);
        break;
    case 3:
        status = fmi2GetNominalsOfContinuousStates(c, x, count);
        break;
    default:
        status = fmi2GetEventIndicators(c, x, below(2) ? 0 : count);
    }
    free(x);
    return status;
}

static fmi2Status step(fmi2Component c)
{
    double time = number(), length = 1e-3;
    if (below(16) != 0 && fmi2GetRealStatus(c, fmi2LastSuccessfulTime, &time) > fmi2Error) {
        abort();
    }
    if (below(8) == 0) {
        length = below(2) ? 1e-3 * uniform() : number();
        length = length > 0.01 && length < 1e7 ? 0.01 : length; /* longer steps work, but take too long */
    }
    return fmi2DoStep(c, time, length, (fmi2Boolean)below(2));
}

static void forge(char *bytes, size_t size)
{
    uint64_t hash = UINT64_C(0xcbf29ce484222325);
    for (size_t i = HEADER; i < size; i++) {
        hash = (hash ^ (unsigned char)bytes[i]) * UINT64_C(0x100000001b3);
    }
    memcpy(bytes + CHECKSUM, &hash, sizeof hash);
}

static void damage(char *bytes, size_t size)
{
    const unsigned flips = below(4) ? 1 + below(8) : 0;
    for (unsigned i = 0; i < flips; i++) {
        const size_t at = below(2) || size < HEADER + 16 ? draw() % size : HEADER + below(16);
        bytes[at] = (char)(bytes[at] ^ (1 << below(8)));
    }
    if (below(50) == 0) {
        for (size_t i = forging ? HEADER : 0; i < size; i++) {
            bytes[i] = (char)draw();
        }
    }
    if (forging && size > HEADER) {
        forge(bytes, size);
    }
}

/* Serialize a state, damage the bytes, restore what is restored of them. */
static fmi2Status bytes_of_state(slot *s, unsigned from, unsigned to)
{
    size_t size = 0;
    if (fmi2SerializedFMUstateSize(s->c, s->states[from], &size) != fmi2OK) {
        return fmi2Error;
    }
    const size_t given = below(10) == 0 ? below((unsigned)size) : size;
    char *bytes = malloc(given);
    fmi2Status status = fmi2Error;
    if (bytes != NULL && (fmi2SerializeFMUstate(s->c, s->states[from], bytes, given) == fmi2OK || given < size)) {
        memset(bytes, 0, given < size ? given : 0);
        if (given > 0) {
            damage(bytes, given);
        }
        status = fmi2DeSerializeFMUstate(s->c, bytes, given, &s->states[to]);
    }
    free(bytes);
    if (status == fmi2OK) {
        status = fmi2SetFMUstate(s->c, s->states[to]);
    }
    return status;
}

static fmi2Status ask(fmi2Component c)
{
    double number_out;
    int integer_out;
    fmi2Status status_out;
    fmi2String text_out;
    const fmi2StatusKind kind = (fmi2StatusKind)below(4);
    const int give = below(20) != 0;
    switch (below(5)) {
    case 0:
        return fmi2GetStatus(c, kind, give ? &status_out : NULL);
    case 1:
        return fmi2GetRealStatus(c, kind, give ? &number_out : NULL);
    case 2:
        return fmi2GetIntegerStatus(c, kind, give ? &integer_out : NULL);
    case 3:
        return fmi2GetBooleanStatus(c, kind, give ? &integer_out : NULL);
    default:
        return fmi2GetStringStatus(c, kind, give ? &text_out : NULL);
    }
}

static fmi2Status experiment(fmi2Component c)
{
    const double start = below(4) ? 0.0 : number();
    return fmi2SetupExperiment(c, (fmi2Boolean)below(2), number(), start, (fmi2Boolean)below(2),
                               below(4) ? 1e3 : number());
}

static void begin(slot *s, const char *location, const char *guid)
{
    const fmi2Type kind = below(2) ? fmi2ModelExchange : fmi2CoSimulation;
    const fmi2Boolean logging = below(4) != 0;
    s->c = fmi2Instantiate("fuzz%s%n", kind, guid, location, &CALLBACKS, fmi2False, logging);
    if (s->c == NULL) {
        s->c = fmi2Instantiate("fuzz%s%n", fmi2CoSimulation, guid, location, &CALLBACKS, fmi2False, logging);
    }
    if (s->c == NULL) {
        fprintf(stderr, "fuzz: there is no instance\n");
        exit(1);
    }
}

static void end(slot *s)
{
    for (int i = 0; i < STATES; i++) {
        if (fmi2FreeFMUstate(s->c, &s->states[i]) != fmi2OK || s->states[i] != NULL) {
            abort();
        }
    }
    fmi2FreeInstance(s->c);
    s->c = NULL;
}

enum {
    SETUP,
    ENTER,
    EXIT,
    STEP,
    VARIABLES,
    DERIVATIVE,
    CONTINUOUS,
    ASK,
    GET_STATE,
    SET_STATE,
    FREE_STATE,
    BYTES,
    RESET,
    TERMINATE,
    EVENT_MODE,
    NEW_DISCRETE,
    CONTINUOUS_MODE,
    COMPLETED,
    SET_TIME,
    LOGGING,
    CANCEL,
    REBIRTH,
    STRANGE,
    OPERATIONS
};

static const char *const NAMES[OPERATIONS] = {
    "setup",           "enter",     "exit",       "step",    "variables", "derivative", "continuous", "ask",
    "get_state",       "set_state", "free_state", "bytes",   "reset",     "terminate",  "event_mode", "new_discrete",
    "continuous_mode", "completed", "set_time",   "logging", "cancel",    "rebirth",    "strange"};

/* How often each is called, in 1000. */
static const unsigned WEIGHTS[OPERATIONS] = {40, 60, 60, 250, 200, 30, 100, 20, 20, 20, 5, 30,
                                             10, 3,  20, 10,  40,  20, 20,  5,  2,  3,  32};

static unsigned operation(void)
{
    unsigned place = below(1000), which = 0;
    while (place >= WEIGHTS[which]) {
        place -= WEIGHTS[which++];
    }
    return which;
}

/* Calls with an argument that no host should give. */
static fmi2Status strange(slot *s)
{
    fmi2FMUstate none = NULL;
    switch (below(8)) {
    case 0:
        return fmi2SetFMUstate(s->c, NULL);
    case 1:
        return fmi2GetFMUstate(s->c, NULL);
    case 2:
        return fmi2FreeFMUstate(s->c, &none);
    case 3:
        return fmi2DoStep(NULL, 0.0, 1e-3, fmi2True);
    case 4:
        return fmi2NewDiscreteStates(s->c, NULL);
    case 5:
        return fmi2CompletedIntegratorStep(s->c, fmi2True, NULL, NULL);
    case 6:
        return fmi2DeSerializeFMUstate(s->c, NULL, below(2) ? 0 : 100, &none);
    default:
        return fmi2SerializeFMUstate(s->c, NULL, NULL, 0);
    }
}

static fmi2Status call(slot *s, unsigned which, const char *location, const char *guid)
{
    static const fmi2String categories[] = {"logAll", "logStatusError", "logStatusWarning", "%s%n", NULL};
    const unsigned i = below(STATES), j = below(STATES);
    fmi2EventInfo information;
    fmi2Boolean first, second;
    switch (which) {
    case SETUP:
        return experiment(s->c);
    case ENTER:
        return fmi2EnterInitializationMode(s->c);
    case EXIT:
        return fmi2ExitInitializationMode(s->c);
    case STEP:
        return step(s->c);
    case VARIABLES:
        return variables(s->c, below(10));
    case DERIVATIVE:
        return derivative(s->c);
    case CONTINUOUS:
        return continuous(s->c, below(5));
    case ASK:
        return ask(s->c);
    case GET_STATE:
        return fmi2GetFMUstate(s->c, &s->states[i]);
    case SET_STATE:
        return fmi2SetFMUstate(s->c, s->states[i]);
    case FREE_STATE:
        return fmi2FreeFMUstate(s->c, &s->states[i]);
    case BYTES:
        return bytes_of_state(s, i, j);
    case RESET:
        return fmi2Reset(s->c);
    case TERMINATE:
        return fmi2Terminate(s->c);
    case EVENT_MODE:
        return fmi2EnterEventMode(s->c);
    case NEW_DISCRETE:
        return fmi2NewDiscreteStates(s->c, &information);
    case CONTINUOUS_MODE:
        return fmi2EnterContinuousTimeMode(s->c);
    case COMPLETED:
        return fmi2CompletedIntegratorStep(s->c, fmi2True, &first, &second);
    case SET_TIME:
        return fmi2SetTime(s->c, number());
    case LOGGING:
        return fmi2SetDebugLogging(s->c, (fmi2Boolean)(below(4) != 0), below(5), categories + below(2));
    case CANCEL:
        return fmi2CancelStep(s->c);
    case REBIRTH:
        end(s);
        begin(s, location, guid);
        return fmi2OK;
    default:
        return strange(s);
    }
}

int main(int count, char **arguments)
{
    slot slots[SLOTS];
    long good[OPERATIONS] = {0};
    if (count != 7) {
        fprintf(stderr, "fuzz: wrong arguments\n");
        return 1;
    }
    seed = (uint64_t)atol(arguments[3]);
    largest = atof(arguments[5]);
    forging = strcmp(arguments[6], "forge") == 0;
    memset(slots, 0, sizeof slots);
    for (int i = 0; i < SLOTS; i++) {
        begin(&slots[i], arguments[1], arguments[2]);
    }
    for (long k = atol(arguments[4]); k > 0; k--) {
        const unsigned which = operation();
        const fmi2Status status = call(&slots[below(SLOTS)], which, arguments[1], arguments[2]);
        if ((int)status < fmi2OK || status > fmi2Error) {
            fprintf(stderr, "fuzz: %s gave the status %d\n", NAMES[which], (int)status);
            return 1;
        }
        good[which] += status == fmi2OK;
    }
    for (int i = 0; i < SLOTS; i++) {
        end(&slots[i]);
    }
    for (int i = 0; i < OPERATIONS; i++) {
        printf("%s %ld\n", NAMES[i], good[i]);
    }
    printf("messages %ld\n", messages);
    return 0;
}
