/* The QUBE-Servo 2 rotary pendulum with its motor and encoders: the C twin of plant_fmu (eq. (5) of D. Cruz-Ortiz et
 * al., "Practical Realization of Implicit Homogeneous Controllers for Linearized Systems").
 *
 * The equation of motion is that of rotary_pendulum.h. Pure functions of their arguments: no allocation, no globals, no
 * input or output, every loop bounded. The order of operations is that of the Python twin.
 */
#ifndef QUBE_SERVO2_H
#define QUBE_SERVO2_H

#include <stdint.h>

#include "qube_servo2_constants.h" /* generated from what Python has */
#include "rotary_pendulum.h"

enum { QUBE_STATES = PENDULUM_MOST_STATES };

/* What a call says of itself; every status but QUBE_OK leaves the state as it was. */
typedef enum {
    QUBE_OK = 0,
    QUBE_OUTPUT_NOT_FINITE,  /* the start values give an output that is not finite */
    QUBE_SINGULAR,           /* the inertia matrix is singular in rounding */
    QUBE_INPUT_NOT_FINITE,   /* a NaN or an infinity among the inputs */
    QUBE_DELAY_NOT_MULTIPLE, /* measurement_delay is no multiple of the communication step */
    QUBE_DELAY_TOO_LONG,     /* measurement_delay is more than QUBE_MAX_DELAY communication steps */
    QUBE_STEP_CHANGED,       /* the communication step changed under a measurement_delay */
    QUBE_TOO_MANY_SUBSTEPS,  /* the communication step is more than QUBE_MAX_SUBSTEPS internal steps */
    QUBE_DIVERGED            /* the state left the range of numbers */
} qube_status;

/* Parameters, named as in the FMU. */
typedef struct {
    double m_p;                  /* mass of the pendulum [kg] */
    double L_p;                  /* length of the pendulum [m] */
    double J_p;                  /* inertia of the pendulum about its centre of mass [kg.m2] */
    double D_p;                  /* viscous damping of the pendulum joint [N.m.s/rad] */
    double L_r;                  /* length of the rotary arm [m] */
    double J_r;                  /* inertia of the rotary arm about the motor axis [kg.m2] */
    double D_r;                  /* viscous damping of the rotary arm [N.m.s/rad] */
    double T_r;                  /* dry (Coulomb) friction torque of the rotary arm [N.m] */
    double g_p;                  /* gravitational acceleration [m/s2] */
    double R_m;                  /* terminal resistance of the motor [Ohm] */
    double k_m;                  /* electromotive force constant [V.s/rad], torque constant [N.m/A] */
    double L_m;                  /* rotor inductance of the motor [H] */
    double voltage_limit;        /* the amplifier saturates at plus and minus this voltage [V] */
    int back_emf;                /* whether the turning motor induces a voltage [Boolean] */
    int motor_model;             /* QUBE_MOTOR_MODEL_STATIC or ..._INDUCTANCE */
    double theta_0;              /* initial angle of the arm [rad] */
    double delta_0;              /* initial angle of the pendulum [rad] */
    double theta_dot_0;          /* initial angular velocity of the arm [rad/s] */
    double delta_dot_0;          /* initial angular velocity of the pendulum [rad/s] */
    int encoder_counts;          /* encoder counts per turn; 0 is an ideal sensor */
    double theta_encoder_offset; /* where inside a count the arm's encoder was zeroed [1] */
    double delta_encoder_offset; /* where inside a count the pendulum's encoder was zeroed [1] */
    double noise_std;            /* standard deviation of the noise on both angles [rad] */
    int noise_seed;              /* seed of the measurement noise */
    double measurement_delay;    /* age of the measured angles [s] */
    double solver_step;          /* longest internal Runge-Kutta step [s] */
} qube_params;

typedef struct {
    double voltage;             /* commanded motor voltage [V] */
    double disturbance_voltage; /* matched disturbance [V] */
    double pendulum_torque;     /* disturbance torque on the pendulum joint [N.m] */
} qube_inputs;

typedef struct {
    double theta;         /* [rad] */
    double delta;         /* [rad] */
    double theta_dot;     /* [rad/s] */
    double delta_dot;     /* [rad/s] */
    double theta_encoder; /* measured [rad] */
    double delta_encoder; /* measured [rad] */
    double current;       /* [A] */
    double motor_torque;  /* [N.m] */
    double energy;        /* [J] */
    double theta_ddot;    /* under the held inputs [rad/s2] */
    double delta_ddot;    /* under the held inputs [rad/s2] */
    double current_dot;   /* under the held inputs, 0 for the static motor [A/s] */
} qube_outputs;

/* Everything that changes during a run. */
typedef struct {
    double x[QUBE_STATES];                    /* theta, delta, theta', delta' and, with inductance, the current */
    double applied_voltage;                   /* held over the last step, within the limit [V] */
    double applied_torque;                    /* on the pendulum joint, held over the last step [N.m] */
    double delayed_step;                      /* communication step that the delay is counted in, 0 before [s] */
    uint64_t random_state;                    /* of the measurement noise */
    int32_t delay_steps;                      /* measurement_delay in communication steps */
    int32_t oldest;                           /* index of the oldest entry of the delay line */
    int32_t count;                            /* entries in the delay line */
    double delay_line[QUBE_MAX_DELAY + 1][2]; /* measured theta, delta [rad] */
} qube_state;

/* What follows from the parameters alone; made by qube_prepare. */
typedef struct {
    pendulum_coefficients pendulum; /* what eq. (5) consists of */
    double k_e;                     /* k_m with back-EMF, 0 without [V.s/rad] */
    double longest_substep;         /* solver_step, or less for the inductance [s] */
    double resolution;              /* of the encoders; not used for ideal sensors [rad] */
} qube_prepared;

/* Compute what follows from the parameters; QUBE_SINGULAR for constants that eq. (5) does not admit. */
qube_status qube_prepare(const qube_params *p, qube_prepared *q);

/* Set the initial state; QUBE_OUTPUT_NOT_FINITE for numbers beyond reason. */
qube_status qube_initialize(const qube_params *p, const qube_prepared *q, qube_state *s);

/* Advance by `step` [s] with the inputs held, by equal Runge-Kutta steps no longer than solver_step. */
qube_status qube_step(const qube_params *p, const qube_prepared *q, qube_state *s, const qube_inputs *u, double step);

/* The outputs up to the encoders. */
void qube_get_outputs(const qube_state *s, qube_outputs *y);

/* The other outputs, from the current on. */
void qube_derive_outputs(const qube_params *p, const qube_prepared *q, const qube_state *s, qube_outputs *y);

/* Number of continuous states: 4, or 5 with inductance. */
int qube_state_count(const qube_params *p);

/* Model exchange: take the inputs as held from now on, and measure the angles again, without noise or delay. */
qube_status qube_hold(const qube_params *p, const qube_prepared *q, qube_state *s, const qube_inputs *u);

/* Derivative of qube_hold and all outputs in the direction (dx, du); encoders are constant where they count. */
void qube_tangent(const qube_params *p, const qube_prepared *q, const qube_state *s, const qube_inputs *u,
                  const double dx[QUBE_STATES], const qube_inputs *du, qube_outputs *dy);

/* Whether indices inside a restored state lie within their arrays. */
int qube_state_is_valid(const qube_state *s);

#endif
