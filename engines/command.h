/* What an ECU does to the throttle before its engine hears of it: transport delay, reading now and then, resolution, dead
 * band, limit of the rate.  Where a number is 0 (the interval: 1) that part is left out, bit for bit. */
#ifndef COMMAND_H
#define COMMAND_H

#include <math.h>

#include "engine.h"

typedef struct {
    double held[DELAY_SAMPLES_MAX]; /* throttles on their way */
    double read, taken, out;        /* what was read last, what of it was taken on, what the engine is led along */
    int32_t at, waited;
} Command;

static inline double command_resolved(const Variables *v, double throttle)
{
    if (v->command_resolution == 0.0)
        return throttle;
    return limit(v->command_resolution * floor(throttle / v->command_resolution + 0.5), 0.0, 1.0);
}

/* As if the throttle had stood at `throttle` for ever; returns what the engine then runs at. */
static inline double command_start(const Variables *v, Command *c, double throttle)
{
    for (int32_t i = 0; i < DELAY_SAMPLES_MAX; i++)
        c->held[i] = throttle;
    c->at = c->waited = 0;
    c->read = throttle;
    c->taken = c->out = command_resolved(v, throttle);
    return c->out;
}

/* One internal step. */
static inline double command_step(const Variables *v, Command *c, double throttle)
{
    const double arrived = delay(c->held, &c->at, v->delay_samples, limit(throttle, 0.0, 1.0));
    if (c->waited == 0)
        c->read = arrived;
    c->waited = c->waited + 1 >= v->command_interval ? 0 : c->waited + 1;
    const double resolved = command_resolved(v, c->read);
    if (!(fabs(resolved - c->taken) <= v->command_dead_band))
        c->taken = resolved;
    const double most = ENGINE_STEP * v->command_rate, change = c->taken - c->out;
    c->out = v->command_rate == 0.0 || fabs(change) <= most ? c->taken : c->out + copysign(most, change);
    return c->out;
}

#endif
