[[ licence ]]
/* [[ title ]] behind the three functions of an FMU's adapter. */
#include "engine.h"

#include "[[ n ]].h"

const size_t engine_state_size = sizeof([[ n ]]_State);

/* What stands before the first step: the throttles of the start, and nothing else. */
void engine_start(Variables *v, void *state)
{
    double throttle[ [[- N ]]_JETS];
    [[ n ]]_reset(&[[ n ]]_parameters, state, v->on_ground != 0, v->fuel_burnt, throttle);
{% for name in outputs %}
    v->[[ name ]] = {% if loop.index0 < jets %}throttle[ [[- loop.index0 ]]]{% else %}0.0{% endif %};
{% endfor %}
}

void engine_step(Variables *v, void *state)
{
    const [[ n ]]_Input input = {
        .attitude_setpoint = {v->roll_setpoint, v->pitch_setpoint, v->yaw_setpoint},
        .altitude_setpoint = v->altitude_setpoint,
        .rate_setpoint = {v->roll_rate_setpoint, v->pitch_rate_setpoint, v->yaw_rate_setpoint},
        .collective_setpoint = v->collective_setpoint,
        .rates_commanded = v->rates_commanded > 0.5,
        .collective_commanded = v->collective_commanded > 0.5,
        .engines = (v->engines > 1.5) ? [[ N ]]_OFF : ((v->engines > 0.5) ? [[ N ]]_IDLE : [[ N ]]_FLY),
        .rate = {v->roll_rate, v->pitch_rate, v->yaw_rate},
        .attitude = {v->attitude_w, v->attitude_x, v->attitude_y, v->attitude_z},
        .velocity_down = v->velocity_down,
        .altitude = v->altitude,
        .fuel_burnt = v->fuel_burnt,
    };
    [[ n ]]_Output output;
    [[ n ]]_step(&[[ n ]]_parameters, state, &input, &output);
{% for name, place in places %}
    v->[[ name ]] = [[ place ]];
{% endfor %}
}
