/* What an engine model gives to the FMI adapter: three names, no FMI.
 *
 * A new engine is a folder with an engine.toml and a C file that defines these three.  The struct Variables holds
 * its inputs, outputs and parameters by name; it comes from variables.h, which the build generates from engine.toml,
 * as does ENGINE_STEP, the internal step in s.
 */
#ifndef ENGINE_H
#define ENGINE_H

#include <stddef.h>
#include <stdint.h>

#include "variables.h"

/* Several FMUs live in one process: nothing but the FMI functions may be seen from outside. */
#if defined(__GNUC__) && !defined(_WIN32)
#define ENGINE_LOCAL __attribute__((visibility("hidden")))
#else
#define ENGINE_LOCAL
#endif

/* Size in bytes of what the model carries from step to step.  It must hold no pointers: it is saved by copying. */
extern ENGINE_LOCAL const size_t engine_state_size;

/* Set the state from the parameters, and the outputs from the state.  Called again whenever a parameter changed. */
ENGINE_LOCAL void engine_start(Variables *v, void *state);

/* Advance by ENGINE_STEP with the inputs held, then set the outputs. */
ENGINE_LOCAL void engine_step(Variables *v, void *state);

static inline double limit(double value, double low, double high)
{
    return value < low ? low : value > high ? high : value;
}

/* A delay of whole samples: takes u[k], gives u[k - samples].  `held` has room for `samples` values, `at` starts at 0. */
static inline double delay(double held[], int32_t *at, int32_t samples, double u)
{
    if (samples == 0)
        return u;
    const double delayed = held[*at];
    held[*at] = u;
    *at = *at + 1 == samples ? 0 : *at + 1;
    return delayed;
}

#endif
