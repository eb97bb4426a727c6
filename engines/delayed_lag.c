/* An engine as a first-order lag behind a transport delay: G(z) = gain / (z - pole) z^-delay, throttle to thrust. */
#include "engine.h"

typedef struct {
    double y;                       /* thrust in the unit of the identification */
    double held[DELAY_SAMPLES_MAX]; /* throttles on their way */
    int32_t at;
} State;

const size_t engine_state_size = sizeof(State);

void engine_start(Variables *v, void *state)
{
    State *s = state;
    for (int32_t i = 0; i < DELAY_SAMPLES_MAX; i++)
        s->held[i] = v->throttle_start;
    s->at = 0;
    s->y = v->gain / (1.0 - v->pole) * v->throttle_start; /* y[k+1] = y[k] */
    v->thrust = v->newton_per_unit * s->y;
}

void engine_step(Variables *v, void *state)
{
    State *s = state;
    const double u = delay(s->held, &s->at, v->delay_samples, limit(v->throttle, 0.0, 1.0));
    s->y = v->pole * s->y + v->gain * u; /* y[k+1] = pole y[k] + gain u[k - delay] */
    v->thrust = v->newton_per_unit * s->y;
}
