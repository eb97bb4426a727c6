/* A turbojet of 220 N, thrust dynamics identified on the bench in May 2024 (Gorbani et al., 2025): a second-order equation
 * in the thrust T [N], written in standardised variables,
 *
 *     T'' = S_T (f(a, d) + g(a, d) v),   a = (T - M_T)/S_T,   d = T'/S_T,   v = w + C[12] w^2,   w = (u - M_U)/S_U
 *     f = C[0] + C[1] a + C[2] d + C[3] a d + C[4] a^2 + C[5] d^2,   g likewise with C[6] to C[11]
 *
 * with u in percent. */
#include <math.h>

#include "p220.h"

static const double C[13] = {-0.464730485, -8.13171858,  -6.19539230,  0.661113140,  1.67673231,  -0.483287064,  8.77996617,
                             -1.01096376,  -0.586442286, 0.519093322, -0.423782666, -1.45705257, -0.00783052261};
static const double M_T = 108.309, S_T = 65.793, M_U = 47.333, S_U = 31.483;

double thrust_drive(double percent)
{
    const double w = (percent - M_U) / S_U;
    return w + C[12] * w * w;
}

double thrust_acceleration(double T, double D, double v)
{
    const double a = (T - M_T) / S_T, d = D / S_T;
    const double f = C[0] + C[1] * a + C[2] * d + C[3] * a * d + C[4] * a * a + C[5] * d * d;
    const double g = C[6] + C[7] * a + C[8] * d + C[9] * a * d + C[10] * a * a + C[11] * d * d;
    return S_T * (f + g * v);
}

double thrust_at_rest(double v)
{
    /* T'' = T' = 0 is a quadratic in a; of its two roots the lower one is stable, the upper above 387 N */
    const double p = C[4] + C[10] * v, q = C[1] + C[7] * v, r = C[0] + C[6] * v;
    return M_T + S_T * 2.0 * r / (sqrt(q * q - 4.0 * p * r) - q);
}
