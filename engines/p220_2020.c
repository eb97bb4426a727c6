/* JetCat P220-RXi, thrust dynamics identified by L'Erario et al. (2020): a second-order equation in the thrust T [N]
 *
 *     T'' = K_T T + K_TT T^2 + K_D T' + K_DD T'^2 + K_TD T T' + (B_U + B_T T + B_D T') v + c,   v = u + B_UU u^2
 *
 * with u in percent. */
#include <math.h>

#include "p220.h"

/* K_TT stands for K_TT, D for T': the paper's names, its values for kerosene */
static const double K_T = 0.237755, K_TT = -0.012799, K_D = -0.860374, K_DD = 0.023606, K_TD = 0.008599;
static const double B_U = 1.139026, B_T = 0.019914, B_D = -0.050257, B_UU = 0.000302, C = -0.692913;

double thrust_drive(double percent) { return percent + B_UU * percent * percent; }

double thrust_acceleration(double T, double D, double v)
{
    return K_T * T + K_TT * T * T + K_D * D + K_DD * D * D + K_TD * T * D + (B_U + B_T * T + B_D * D) * v + C;
}

double thrust_at_rest(double v)
{
    /* T'' = T' = 0 is a quadratic in T; of its two roots the upper one is stable */
    const double b = K_T + B_T * v;
    return (-b - sqrt(b * b - 4.0 * K_TT * (B_U * v + C))) / (2.0 * K_TT);
}
