/* The P220: thrust by an identified equation of second order (p220.h), T'' = F(T, T', v(u)), with u in percent.  Spool
 * speed and fuel flow follow the thrust without lag. */
#include <math.h>

#include "command.h"
#include "p220.h"

/* The data sheet's two ends; between them speed follows T = T_0 + a n^b, and fuel is a straight line. */
static const double IDLE_T = 9.0, FULL_T = 220.0;                 /* N */
static const double IDLE_RPM = 35000.0, FULL_RPM = 117000.0;      /* 1/min */
static const double IDLE_FUEL = 0.104 / 60.0, FULL_FUEL = 0.58 / 60.0; /* kg/s */
static const double EXPONENT = 3.205;                             /* b, Momin et al. (2022) */

typedef struct {
    double T, D; /* thrust and its rate, in the time of the identification */
    Command command;
} State;

const size_t engine_state_size = sizeof(State);

static double drive(const Variables *v, double throttle)
{
    return thrust_drive(v->idle_percent + (100.0 - v->idle_percent) * throttle);
}

static void outputs(Variables *v, const State *s)
{
    const double load = (limit(s->T, IDLE_T, INFINITY) - IDLE_T) / (FULL_T - IDLE_T); /* 0 at idle, 1 at full thrust */
    const double idle = pow(IDLE_RPM / FULL_RPM, EXPONENT);
    v->thrust = s->T;
    v->spool_speed = FULL_RPM * pow(idle + (1.0 - idle) * load, 1.0 / EXPONENT);
    v->fuel_flow = IDLE_FUEL + (FULL_FUEL - IDLE_FUEL) * load;
}

void engine_start(Variables *v, void *state)
{
    State *s = state;
    s->T = thrust_at_rest(drive(v, command_start(v, &s->command, v->throttle_start)));
    s->D = 0.0;
    outputs(v, s);
}

void engine_step(Variables *v, void *state)
{
    State *s = state;
    const double u = drive(v, command_step(v, &s->command, v->throttle));
    const double h = ENGINE_STEP / v->time_factor, T = s->T, D = s->D; /* T' in the engine's own time */
    /* Runge-Kutta of fourth order, one step: the fastest mode takes 150 ms or longer, 40 steps */
    const double D1 = D, a1 = thrust_acceleration(T, D1, u);
    const double D2 = D + h / 2.0 * a1, a2 = thrust_acceleration(T + h / 2.0 * D1, D2, u);
    const double D3 = D + h / 2.0 * a2, a3 = thrust_acceleration(T + h / 2.0 * D2, D3, u);
    const double D4 = D + h * a3, a4 = thrust_acceleration(T + h * D3, D4, u);
    s->T = T + h / 6.0 * (D1 + 2.0 * D2 + 2.0 * D3 + D4);
    s->D = D + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4);
    outputs(v, s);
}
