/* The equation of motion of the rotary pendulum, eq. (5) of D. Cruz-Ortiz et al., "Practical Realization of Implicit
 * Homogeneous Controllers for Linearized Systems": the C twin of rotary_pendulum/equation.py and runge_kutta.py.
 *
 *     J(q) q'' + C(q, q') q' + w(q) = [tau, tau_p]',   q = [theta, delta]',   delta = 0 upright,
 *
 * zeta = m_p L_p^2, psi = m_p L_r^2, varpi = m_p L_p L_r, and D_r + T_r/(|theta'| + v_s) in place of D_r. Pure
 * functions of their arguments in the order of operations of the Python twin; static, so that several units that are
 * made of them can be parts of one program.
 */
#ifndef ROTARY_PENDULUM_H
#define ROTARY_PENDULUM_H

#include <math.h>

/* What a step runs through four times is compiled in its place. */
#if defined __GNUC__
#define PENDULUM_INLINE static inline __attribute__((always_inline))
#else
#define PENDULUM_INLINE static inline
#endif

enum { PENDULUM_MOST_STATES = 5 }; /* the pendulum's four and one of a motor */

/* PENDULUM_FRICTION_SPEED, v_s, is among the generated constants of the unit that includes this: at this speed dry
 * friction is half of T_r [rad/s]. */

/* The combinations of constants that eq. (5) consists of. */
typedef struct {
    double J_11;    /* J_r + psi [kg.m2] */
    double J_22;    /* J_p + zeta/4 [kg.m2] */
    double zeta_4;  /* zeta/4 [kg.m2] */
    double varpi_2; /* varpi/2 [kg.m2] */
    double gravity; /* m_p g_p L_p/2 [N.m] */
    double D_r;     /* [N.m.s/rad] */
    double T_r;     /* [N.m] */
    double D_p;     /* [N.m.s/rad] */
} pendulum_coefficients;

/* Whether the determinant of J upright, where it is smallest, is more than rounding. */
static inline int pendulum_is_regular(const pendulum_coefficients *c)
{
    const double diagonal = c->J_11 * c->J_22;
    return diagonal - c->varpi_2 * c->varpi_2 > 1e-9 * diagonal;
}

/* Of the arm, D_r + T_r/(|theta'| + v_s) [N.m.s/rad]. */
static inline double pendulum_damping(const pendulum_coefficients *c, double theta_dot)
{
    return c->D_r + c->T_r / (fabs(theta_dot) + PENDULUM_FRICTION_SPEED);
}

/* Solve eq. (5) for theta'', delta'' [rad/s2], under the arm's damping. */
static inline void pendulum_accelerations(const pendulum_coefficients *c, double damping, double delta,
                                          double theta_dot, double delta_dot, double tau, double tau_p,
                                          double *theta_ddot, double *delta_ddot)
{
    const double s = sin(delta), k = cos(delta);
    const double j_11 = c->J_11 + c->zeta_4 * s * s;
    const double j_12 = -c->varpi_2 * k;
    const double sk = c->zeta_4 * s * k;
    const double r_1 = tau - (2.0 * sk * delta_dot + damping) * theta_dot - c->varpi_2 * s * delta_dot * delta_dot;
    const double r_2 = tau_p + sk * theta_dot * theta_dot - c->D_p * delta_dot + c->gravity * s;
    const double determinant = j_11 * c->J_22 - j_12 * j_12;
    *theta_ddot = (c->J_22 * r_1 - j_12 * r_2) / determinant;
    *delta_ddot = (j_11 * r_2 - j_12 * r_1) / determinant;
}

/* The torque [N.m] under which the arm accelerates by theta_ddot, tau_p = 0: eq. (5) inverted. */
static inline double pendulum_arm_torque(const pendulum_coefficients *c, double damping, double delta, double theta_dot,
                                         double delta_dot, double theta_ddot)
{
    const double s = sin(delta), k = cos(delta);
    const double j_12 = -c->varpi_2 * k;
    const double sk = c->zeta_4 * s * k;
    const double r_2 = sk * theta_dot * theta_dot - c->D_p * delta_dot + c->gravity * s;
    const double delta_ddot = (r_2 - j_12 * theta_ddot) / c->J_22;
    const double tau = (c->J_11 + c->zeta_4 * s * s) * theta_ddot + j_12 * delta_ddot;
    return tau + (2.0 * sk * delta_dot + damping) * theta_dot + c->varpi_2 * s * delta_dot * delta_dot;
}

/* q'J(q)q'/2 + m_p g_p L_p (cos delta - 1)/2 [J]; 0 at rest upright. */
static inline double pendulum_energy(const pendulum_coefficients *c, double delta, double theta_dot, double delta_dot)
{
    const double s = sin(delta), k = cos(delta);
    double kinetic = 0.5 * (c->J_11 + c->zeta_4 * s * s) * theta_dot * theta_dot;
    kinetic += 0.5 * c->J_22 * delta_dot * delta_dot - c->varpi_2 * k * theta_dot * delta_dot;
    return kinetic + c->gravity * (k - 1.0);
}

/* x' = f(x) of a model. */
typedef void (*pendulum_rate)(const void *model, const double x[PENDULUM_MOST_STATES], double dx[PENDULUM_MOST_STATES]);

/* One classical Runge-Kutta step of length h [s] of all PENDULUM_MOST_STATES entries of x. */
PENDULUM_INLINE void pendulum_rk4_step(pendulum_rate f, const void *model, double x[PENDULUM_MOST_STATES], double h)
{
    double k1[PENDULUM_MOST_STATES], k2[PENDULUM_MOST_STATES], k3[PENDULUM_MOST_STATES], k4[PENDULUM_MOST_STATES];
    double y[PENDULUM_MOST_STATES];
    f(model, x, k1);
    for (int i = 0; i < PENDULUM_MOST_STATES; i++) {
        y[i] = x[i] + 0.5 * h * k1[i];
    }
    f(model, y, k2);
    for (int i = 0; i < PENDULUM_MOST_STATES; i++) {
        y[i] = x[i] + 0.5 * h * k2[i];
    }
    f(model, y, k3);
    for (int i = 0; i < PENDULUM_MOST_STATES; i++) {
        y[i] = x[i] + h * k3[i];
    }
    f(model, y, k4);
    for (int i = 0; i < PENDULUM_MOST_STATES; i++) {
        x[i] = x[i] + h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]);
    }
}

#endif
