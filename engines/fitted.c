/* An engine as a bench log tells it: transport delay, static curve, two lags, limits of the rate.  The first
 * lag may change with the thrust.
 *
 *     f = offset + gain u(t - delay)^exponent, not below 0
 *     lag_2 x' = f - x      lag y' = x - y, within -fall and rise times gain
 *
 * Solved exactly over a step in which f stands still. */
#include <math.h>

#include "engine.h"

typedef struct {
    double x, y;                    /* behind the second lag, and thrust [N] */
    double held[DELAY_SAMPLES_MAX]; /* throttles on their way */
    int32_t at;
} State;

const size_t engine_state_size = sizeof(State);

static double curve(const Variables *v, double u)
{
    const double thrust = v->offset + v->gain * (v->exponent == 1.0 ? u : pow(u, v->exponent));
    return thrust > 0.0 ? thrust : 0.0; /* a fitted line may cross 0 above the throttle at which the engine gives none */
}

/* The lag at the thrust as it stands: in a straight line from that of no throttle to that of full throttle. */
static double lag_at(const Variables *v, double thrust)
{
    if (v->lag_full == 0.0)
        return v->lag;
    const double low = v->offset, high = v->offset + v->gain;
    const double level = high > low ? limit((thrust - low) / (high - low), 0.0, 1.0) : 0.0;
    return v->lag + (v->lag_full - v->lag) * level;
}

static double fade(double lag) { return lag > 0.0 ? exp(-ENGINE_STEP / lag) : 0.0; }

void engine_start(Variables *v, void *state)
{
    State *s = state;
    for (int32_t i = 0; i < DELAY_SAMPLES_MAX; i++)
        s->held[i] = v->throttle_start;
    s->at = 0;
    s->x = s->y = curve(v, limit(v->throttle_start, 0.0, 1.0));
    v->thrust = s->y;
}

void engine_step(Variables *v, void *state)
{
    State *s = state;
    const double f = curve(v, delay(s->held, &s->at, v->delay_samples, limit(v->throttle, 0.0, 1.0)));
    const double lag = lag_at(v, s->y), e = fade(lag), e2 = fade(v->lag_2), apart = v->lag_2 - lag;
    /* what a unit of x - f at the beginning of the step adds to y at its end */
    const double through = v->lag_2 == 0.0          ? 0.0
                           : fabs(apart) < 1e-9 * lag ? ENGINE_STEP / lag * e
                                                      : v->lag_2 / apart * (e2 - e);
    const double y = f + e * (s->y - f) + through * (s->x - f);
    const double highest = v->rise > 0.0 ? s->y + ENGINE_STEP * v->rise * v->gain : HUGE_VAL;
    const double lowest = v->fall > 0.0 ? s->y - ENGINE_STEP * v->fall * v->gain : -HUGE_VAL;
    s->y = limit(y, lowest, highest);
    s->x = f + e2 * (s->x - f);
    v->thrust = s->y;
}
