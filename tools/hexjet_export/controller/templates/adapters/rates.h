[[ licence ]]
/* [[ title ]]: its rate loop alone, for [[ autopilot ]], which keeps its attitude loop and its mixer.
 *
 * Made by hexjet export controller ([[ maker ]]). The controller is [[ n ]].h; what it would do with throttles and tilts
 * at the autopilot's collective goes back through the pseudo-inverse of its allocation to torques about three axes, so
 * limits of the actuators, and the tilt that a thrust other than hover's asks for, are in them. What the mixer cannot
 * give beyond that the controller does not know.
 */
#ifndef [[ N ]]_RATES_H
#define [[ N ]]_RATES_H

#include "[[ n ]].h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    [[ n ]]_State state;
} [[ n ]]_Rates;

/* Once, before the first step. */
void [[ n ]]_rates_reset([[ n ]]_Rates *rates);

/* One control step, every [[ N ]]_STEP_S. Rates in rad/s about the body axes forward, right and down; `throttle` is the mean
 * of the engines', 0 to 1; `torque` in the autopilot's unit about the same axes. Where `flies` is false it is zero, and
 * nothing is remembered. */
void [[ n ]]_rates_step([[ n ]]_Rates *rates, const [[ n ]]_Real setpoint[3], const [[ n ]]_Real measured[3],
    [[ n ]]_Real throttle, bool flies, [[ n ]]_Real torque[3]);

#ifdef __cplusplus
}
#endif

#endif
