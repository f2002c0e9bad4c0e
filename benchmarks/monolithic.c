/* The closed loop as one hand-written program: what the FMUs and the master are measured against.
 *
 * The same step functions as in the FMUs, called directly; controller first, all outputs recorded in each step. The
 * header start_values.h with PLANT and CONTROLLER is generated from the same start values as the FMUs.
 */
#include "ihc_controller.h"
#include "qube_servo2.h"
#include "start_values.h"

typedef struct {
    double time;
    ihc_outputs controller;
    qube_outputs plant;
} row;

/* Run `steps` steps of `step` [s], fill steps + 1 rows; returns 0, or the number of the step that failed. */
__attribute__((visibility("default"))) long run(long steps, double step, row *rows)
{
    static const qube_inputs no_inputs;
    qube_state plant;
    ihc_state controller;
    qube_prepared of_plant;
    ihc_prepared of_controller;
    qube_inputs u = no_inputs;
    ihc_inputs y;
    if (qube_prepare(&PLANT, &of_plant) != QUBE_OK || qube_initialize(&PLANT, &of_plant, &plant) != QUBE_OK
        || ihc_prepare(&CONTROLLER, &of_controller) != IHC_OK) {
        return -1;
    }
    rows[0].time = 0.0;
    qube_get_outputs(&plant, &rows[0].plant);
    qube_derive_outputs(&PLANT, &of_plant, &plant, &rows[0].plant);
    y.theta = rows[0].plant.theta_encoder;
    y.delta = rows[0].plant.delta_encoder;
    y.theta_dot = y.delta_dot = y.theta_setpoint = 0.0;
    ihc_initialize(&CONTROLLER, &of_controller, &controller, 0.0, &y);
    ihc_get_outputs(&controller, &rows[0].controller);
    for (long k = 0; k < steps; k++) {
        const double time = (double)k * step;
        row *next = &rows[k + 1];
        y.theta = rows[k].plant.theta_encoder;
        y.delta = rows[k].plant.delta_encoder;
        if (ihc_step(&CONTROLLER, &of_controller, &controller, time, step, &y) > IHC_NEW_FAULT) {
            return k + 1;
        }
        ihc_get_outputs(&controller, &next->controller);
        u.voltage = next->controller.voltage;
        if (qube_step(&PLANT, &of_plant, &plant, &u, step) != QUBE_OK) {
            return k + 1;
        }
        qube_get_outputs(&plant, &next->plant);
        qube_derive_outputs(&PLANT, &of_plant, &plant, &next->plant);
        next->time = (double)(k + 1) * step;
    }
    return 0;
}
