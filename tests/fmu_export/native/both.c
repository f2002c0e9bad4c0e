/* Plant and controller compiled into one program: the closed loop, and where it ends. */
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

#include "fmi2FunctionTypes.h"

#define DECLARE(unit)                                                                                                  \
    extern fmi2InstantiateTYPE unit##_fmi2Instantiate;                                                                 \
    extern fmi2SetupExperimentTYPE unit##_fmi2SetupExperiment;                                                         \
    extern fmi2EnterInitializationModeTYPE unit##_fmi2EnterInitializationMode;                                         \
    extern fmi2ExitInitializationModeTYPE unit##_fmi2ExitInitializationMode;                                           \
    extern fmi2SetRealTYPE unit##_fmi2SetReal;                                                                         \
    extern fmi2GetRealTYPE unit##_fmi2GetReal;                                                                         \
    extern fmi2DoStepTYPE unit##_fmi2DoStep;                                                                           \
    extern fmi2FreeInstanceTYPE unit##_fmi2FreeInstance;

DECLARE(QubeServo2)
DECLARE(IhcController)

static void log_message(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                        fmi2String message, ...)
{
    va_list arguments;
    (void)environment;
    fprintf(stderr, "%s %d %s: ", name, (int)status, category);
    va_start(arguments, message);
    vfprintf(stderr, message, arguments);
    va_end(arguments);
    fputc('\n', stderr);
}

static void check(fmi2Status status)
{
    if (status != fmi2OK) {
        exit(1);
    }
}

/* Arguments: GUIDs of plant and controller, value references of delta_0, theta_encoder and delta_encoder, steps. */
int main(int count, char **arguments)
{
    fmi2CallbackFunctions callbacks = {log_message, NULL, NULL, NULL, NULL};
    if (count != 7) {
        return 2;
    }
    fmi2Component plant = QubeServo2_fmi2Instantiate("plant", fmi2CoSimulation, arguments[1], NULL, &callbacks, 0, 1);
    fmi2Component controller =
        IhcController_fmi2Instantiate("controller", fmi2CoSimulation, arguments[2], NULL, &callbacks, 0, 1);
    const fmi2ValueReference tilt[1] = {(fmi2ValueReference)atoi(arguments[3])};
    const fmi2ValueReference seen[2] = {(fmi2ValueReference)atoi(arguments[4]), (fmi2ValueReference)atoi(arguments[5])};
    const fmi2ValueReference inputs[2] = {0, 1}, voltage_in[1] = {0}, voltage_out[1] = {4};
    const int steps = atoi(arguments[6]);
    fmi2Real angles[2], voltage[1] = {0.1};
    if (plant == NULL || controller == NULL) {
        return 3;
    }
    check(QubeServo2_fmi2SetReal(plant, tilt, 1, voltage));
    check(QubeServo2_fmi2SetupExperiment(plant, 0, 0.0, 0.0, 0, 0.0));
    check(QubeServo2_fmi2EnterInitializationMode(plant));
    check(QubeServo2_fmi2ExitInitializationMode(plant));
    check(IhcController_fmi2SetupExperiment(controller, 0, 0.0, 0.0, 0, 0.0));
    check(IhcController_fmi2EnterInitializationMode(controller));
    check(IhcController_fmi2ExitInitializationMode(controller));
    for (int k = 0; k < steps; k++) {
        check(QubeServo2_fmi2GetReal(plant, seen, 2, angles));
        check(IhcController_fmi2SetReal(controller, inputs, 2, angles));
        check(IhcController_fmi2DoStep(controller, k * 1e-3, 1e-3, 1));
        check(IhcController_fmi2GetReal(controller, voltage_out, 1, voltage));
        check(QubeServo2_fmi2SetReal(plant, voltage_in, 1, voltage));
        check(QubeServo2_fmi2DoStep(plant, k * 1e-3, 1e-3, 1));
    }
    check(QubeServo2_fmi2GetReal(plant, seen, 2, angles));
    printf("%.17g %.17g %.17g\n", angles[0], angles[1], voltage[0]);
    QubeServo2_fmi2FreeInstance(plant);
    IhcController_fmi2FreeInstance(controller);
    return 0;
}
