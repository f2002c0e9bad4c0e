/* Swing-up and stabilization of a rotary pendulum: the C twin of ihc_fmu (LC, first-order SMC, super-twisting, implicit
 * homogeneous control of D. Cruz-Ortiz et al., "Practical Realization of Implicit Homogeneous Controllers for
 * Linearized Systems").
 *
 * x = (theta - theta_setpoint, delta, theta', delta'), delta = 0 upright, z = Phi x, w_i = 1 + mu (n - i), s = r^-mu:
 *
 *     LC     u = k_lin x
 *     SMC    u = smc_k x - smc_rho sign(smc_c x)
 *     STA    u = sta_k x - k_1 |s|^(1/2) sign(s) + v,  v' = -k_2 sign(s),  s = sta_c x
 *     IHC    u = k_lin x + sum_i (kz_i s^(n-i+1) - kz_i) z_i      eq. (8), Remark 5,   r = ||x||_d, eq. (12)
 *
 * Pure functions of their arguments: no allocation, no globals, no input or output, every loop bounded. The order of
 * operations is that of the Python twin.
 */
#ifndef IHC_CONTROLLER_H
#define IHC_CONTROLLER_H

#include "ihc_controller_constants.h" /* generated from what Python has */

#define HOMOGENEOUS_ORDER IHC_ORDER
#define HOMOGENEOUS_INPUTS 1
#define HOMOGENEOUS_CHAIN 1
#include "homogeneous.h"
#include "rotary_pendulum.h"
#include "sample_clock.h"

typedef enum {
    IHC_OK = 0,
    IHC_NEW_FAULT,        /* the step worked; the controller has just faulted, see the output `fault` */
    IHC_INDEFINITE_P,     /* P is not positive definite */
    IHC_SINGULAR_PHI,     /* Phi is not regular */
    IHC_CHAIN_NOT_FINITE, /* Phi, P or the gains are beyond reason */
    IHC_SINGULAR_MODEL,   /* the nominal inertia matrix is singular in rounding */
    IHC_LIMITS,           /* a_min exceeds b_max */
    IHC_ANGLES,           /* capture_angle exceeds fall_back_angle */
    IHC_KALMAN_TIME       /* the Kalman filter's gain is for another sample time */
} ihc_status;             /* and those of sample_clock.h */

/* Parameters, named as in the FMU. */
typedef struct {
    int law, norm_solver, discretization, velocity_source;
    double k_lin[IHC_ORDER];                   /* gain of the linear controller [V/rad, V.s/rad] */
    double row[IHC_ORDER];                     /* row of the chain form, e_n' Phi A */
    double Phi[IHC_ORDER][IHC_ORDER];          /* z = Phi x */
    double P[IHC_ORDER * (IHC_ORDER + 1) / 2]; /* upper triangle by rows of P, the unit ball x' P x <= 1 */
    double mu;                                 /* minus the degree of homogeneity [1] */
    double a_min, b_max;                       /* limits of the norm in the law [1] */
    int j_max;                                 /* bisections per sample in Algorithm 1 */
    double smc_c[IHC_ORDER];                   /* sliding surface */
    double smc_k[IHC_ORDER];                   /* linear part of the sliding mode law */
    double smc_rho;                            /* switching gain [V] */
    double sta_c[IHC_ORDER];                   /* sliding surface of the super-twisting law */
    double sta_k[IHC_ORDER];                   /* its linear part */
    double sta_rate;                           /* L of k_1 = 1.5 sqrt(L), k_2 = 1.1 L [V/s] */
    double sample_time;                        /* [s] */
    double voltage_limit;                      /* [V] */
    double velocity_filter_cutoff;             /* w of w s/(s + w) [rad/s] */
    int enabled, swing_up_enabled;             /* [Boolean] */
    double swing_up_energy_gain;               /* k_e [rad/(s2 J)] */
    double swing_up_acceleration_limit;        /* [rad/s2] */
    double swing_up_arm_stiffness;             /* k_th [1/s2] */
    double swing_up_arm_damping;               /* k_d [1/s] */
    double swing_up_energy_offset;             /* e_o in m_p g_p L_p/2 [1] */
    double swing_up_velocity_scale;            /* v_s [rad/s] */
    double capture_level;                      /* of x' P x [1] */
    double capture_angle;                      /* [rad] */
    double capture_velocity;                   /* [rad/s] */
    double fall_back_angle;                    /* [rad] */
    double nominal_arm_inertia;                /* J_r + psi [kg.m2] */
    double nominal_pendulum_inertia;           /* J_p + zeta/4 [kg.m2] */
    double nominal_swing_inertia;              /* zeta/4 [kg.m2] */
    double nominal_coupling;                   /* varpi/2 [kg.m2] */
    double nominal_gravity_torque;             /* m_p g_p L_p/2 [N.m] */
    double nominal_arm_damping;                /* D_r [N.m.s/rad] */
    double nominal_pendulum_damping;           /* D_p [N.m.s/rad] */
    double nominal_torque_per_volt;            /* k_m/R_m [N.m/V] */
    double nominal_motor_damping;              /* k_m^2/R_m [N.m.s/rad] */
    double kalman_M[6][2];                     /* gain of the Kalman filter */
    double kalman_sample_time;                 /* sample time that it is for [s] */
    double kalman_angle;                       /* beyond it the observer's gains are used [rad] */
    int compensate_disturbance;                /* [Boolean] */
    double observer_acceleration_noise;        /* [rad2/s3] */
    double observer_resolution;                /* of the encoders: a count [rad] */
    double kalman_count_weight;                /* of an innovation within half a count in the Kalman filter [1] */
} ihc_params;

typedef struct {
    double theta, delta;         /* measured angles [rad] */
    double theta_dot, delta_dot; /* [rad/s], used with velocity_source inputs */
    double theta_setpoint;       /* where the arm is to be held [rad] */
} ihc_inputs;

typedef struct {
    double voltage;               /* [V] */
    double homogeneous_norm;      /* ||x||_d [1] */
    double homogeneous_norm_used; /* r in the law [1] */
    int mode;                     /* IHC_MODE_IDLE ... IHC_MODE_FAULT */
    double theta_dot_estimate;    /* [rad/s] */
    double delta_dot_estimate;    /* [rad/s] */
    double disturbance_estimate;  /* [V] */
    double bias_estimate;         /* [rad] */
    int fault;                    /* IHC_FAULT_NONE ... */
} ihc_outputs;

/* What follows from the parameters alone; made by ihc_prepare, again after a parameter changed. */
typedef struct {
    block_design design;            /* in chain coordinates */
    pendulum_coefficients pendulum; /* the nominal model */
    norm_search search;             /* how the norm in the law is found */
    double ahead;                   /* sample time of the semi-implicit law; 0: explicit [s] */
    double decay;                   /* of the velocity filter over a sample [1] */
    double observer_gain[2];        /* on the angle [1] and the velocity [1/s] */
    double bias_decay;              /* over a sample [1] */
} ihc_prepared;

/* Everything that changes during a run. */
typedef struct {
    sample_clock clock;
    double voltage;        /* held since the last sample [V] */
    double measured_delta; /* as received last [rad] */
    double theta_lag;      /* velocity filter [rad] */
    double delta_lag;      /* velocity filter, unwrapped [rad] */
    double observed[4];    /* observer or Kalman filter: theta, delta unwrapped, theta', delta' */
    double interval[2];    /* [a, b] of Algorithm 1 */
    double norm;           /* homogeneous norm */
    double norm_used;      /* its value in the law */
    double disturbance;    /* Kalman filter's estimate [V] */
    double bias;           /* Kalman filter's estimate [rad] */
    double integral;       /* v of the super-twisting law [V] */
    double theta_dot;      /* velocity that the law uses [rad/s] */
    double delta_dot;
    double turns;   /* whole turns by which the measured delta has been unwrapped */
    int32_t primed; /* whether the estimators have seen a finite measurement */
    int32_t mode;
    int32_t fault;
    int32_t bad_inputs; /* bit i: input i was not finite when the fault came */
} ihc_state;

/* Compute what follows from the parameters; refuses those that contradict each other. */
ihc_status ihc_prepare(const ihc_params *p, ihc_prepared *q);

/* Start the sample clock at `time` [s]; with finite measurements start the estimators from rest there. */
void ihc_initialize(const ihc_params *p, const ihc_prepared *q, ihc_state *s, double time, const ihc_inputs *u);

/* Sample the inputs at each sample instant within `step` [s] from `time` [s] on; hold the voltage otherwise. */
int ihc_step(const ihc_params *p, const ihc_prepared *q, ihc_state *s, double time, double step, const ihc_inputs *u);

void ihc_get_outputs(const ihc_state *s, ihc_outputs *y);

#endif
