[[ licence ]]
/* [[ title ]]: see [[ n ]]_rates.h. */
#include "[[ n ]]_rates.h"

typedef [[ n ]]_Real Real;

#define R(x) ((Real)(x))
#define ACTUATORS ([[ N ]]_JETS + 2)

/* Roll in throttle, pitch and yaw in [[ "rad of tilt" if tilts else "throttle" ]], of throttles and of the left and right tilt. */
static const Real INVERSE[3][ACTUATORS] = {
{% for row in inverse %}
    [[ row|c("     ") ]],
{% endfor %}
};
/* The same for a torque of 1 in [[ autopilot ]]: [[ origin_of_scale ]]. */
static const Real WORTH[3] = [[ torque_scale|c ]];
{% if curve is not none %}

/* The share of an engine's range of thrust that a throttle asks for: the inverse of the controller's thrust map. */
static Real collective_of(Real throttle)
{
    const [[ n ]]_Parameters *const p = &[[ n ]]_parameters;
    int i = 0;
    while ((i < [[ points - 2 ]]) && (throttle > p->curve_[[ curve ]]_throttle[i + 1])) {
        i++;
    }
    const Real thrust = p->curve_[[ curve ]]_thrust[i]
        + (throttle - p->curve_[[ curve ]]_throttle[i]) / p->curve_[[ curve ]]_slope[i];
    return (thrust - p->thrust_low) / p->thrust_span;
}
{% endif %}

void [[ n ]]_rates_reset([[ n ]]_Rates *rates)
{
    Real throttle[ [[- N ]]_JETS];
    [[ n ]]_reset(&[[ n ]]_parameters, &rates->state, true, R(0.0), throttle);
}

void [[ n ]]_rates_step([[ n ]]_Rates *rates, const Real setpoint[3], const Real measured[3], Real throttle, bool flies,
    Real torque[3])
{
    [[ n ]]_Input input = {
        .rates_commanded = true,
        .collective_commanded = true,
        .engines = flies ? [[ N ]]_FLY : [[ N ]]_IDLE,
        .attitude = {R(1.0), R(0.0), R(0.0), R(0.0)},
    };
    [[ n ]]_Output output;
    for (int i = 0; i < 3; i++) {
        input.rate_setpoint[i] = setpoint[i];
        input.rate[i] = measured[i];
    }
    input.collective_setpoint = {% if curve is none %}throttle{% else %}collective_of(throttle){% endif %};
    [[ n ]]_step(&[[ n ]]_parameters, &rates->state, &input, &output);
    for (int i = 0; i < 3; i++) {
        Real axis = R(0.0);
        for (int j = 0; j < [[ N ]]_JETS; j++) {
            axis += INVERSE[i][j] * output.throttle[j];
        }
        axis += INVERSE[i][ [[- N ]]_JETS] * output.tilt[0] + INVERSE[i][ [[- N ]]_JETS + 1] * output.tilt[1];
        torque[i] = flies ? (axis / WORTH[i]) : R(0.0);
    }
}
