/* A single-spool turbojet: compressor, combustor, turbine and nozzle in balance at every instant, one rotor, one ECU.
 *
 *     J w' = (P_turbine - P_compressor - P_windage + P_starter) / w        rotor
 *     m_f' = (command - m_f) / tau                                         fuel pump
 *
 * Symbols as in turbine-220/README.md; 2, 3, 4, 5, 8 are the stations from intake to jet.  Air and gas have kappa 7/5
 * and 4/3, so that every power but two is a root. */
#include <math.h>
#include <string.h>

#include "command.h"

static const double R = 287.0, CP_AIR = 3.5 * 287.0, CP_GAS = 4.0 * 287.0; /* J/(kg K) */
static const double P_STD = 101325.0, T_STD = 288.15;                      /* Pa, K */
static const double HEATING_VALUE = 43.1e6, T_REF = 298.15;                /* Jet A-1: J/kg, stated at this K */
static const double RPM = 0.10471975511965977;                             /* rad/s */

typedef enum { OFF, CRANKING, SPOOLING, RUNNING } Phase;

typedef struct {
    double w, fuel;             /* rotor speed [rad/s], fuel flow [kg/s] */
    double reference, integral; /* of the ECU: the speed that the rotor is led along, the integral of its error [kg/s] */
    double asked, error;        /* the fuel that the ECU asked for a step ago [kg/s], and the error of the speed then */
    Command command;
    int32_t phase, waited;
    int32_t was_on;
    double full_rise, idle_share; /* of the parameters alone: T3 / T2 - 1 at full speed, idle over full thrust */
} State;

const size_t engine_state_size = sizeof(State);

/* What does not change within a step: total state of the air before the compressor, and scales. */
typedef struct {
    const Variables *v;
    double pa, V, T2, p2;         /* ambient pressure, air speed; total temperature and pressure */
    double unit_speed, unit_flow; /* of full corrected speed and flow: rad/s, kg/s */
    double full_rise;             /* T3 / T2 - 1 at full corrected speed */
} Plant;

typedef struct {
    double torque, thrust, T5;
} Gas;

static Plant plant(const Variables *v, const State *s)
{
    const double Ta = limit(v->ambient_temperature, 150.0, 400.0), pa = limit(v->ambient_pressure, 1e3, 2e5);
    const double V = limit(v->air_speed, 0.0, 300.0), T2 = Ta + V * V / (2.0 * CP_AIR), ram = T2 / Ta;
    const double p2 = pa * (1.0 + v->ram_recovery * (ram * ram * ram * sqrt(ram) - 1.0));
    const double root = sqrt(T2 / T_STD), unit_flow = v->air_flow * (p2 / P_STD) / root;
    return (Plant){v, pa, V, T2, p2, v->full_speed * RPM * root, unit_flow, s->full_rise};
}

/* Below a fiftieth of full speed the gas path is that at a fiftieth, torque and thrust in proportion to the speed. */
static double turning(const Plant *a, double w) { return limit(w, 0.02 * a->v->full_speed * RPM, HUGE_VAL); }

/* Air flow over its unit at corrected speed n. */
static double corrected_flow(const Plant *a, double n) { return n * (1.0 - a->v->flow_droop * (1.0 - n)); }

static double air_flow(const Plant *a, double w)
{
    return a->unit_flow * corrected_flow(a, turning(a, w) / a->unit_speed);
}

/* The gas path at rotor speed w and fuel flow m_f; `lit` is 1 where it burns. */
static Gas gas_path(const Plant *a, double w, double m_f, double lit)
{
    const Variables *v = a->v;
    const double moving = turning(a, w), n = moving / a->unit_speed;
    const double flow = corrected_flow(a, n), m = a->unit_flow * flow, m_g = m + m_f;
    const double rise = a->full_rise * n * n, x = 1.0 + v->compressor_efficiency * rise;
    const double T3 = a->T2 * (1.0 + rise), p4 = a->p2 * x * x * x * sqrt(x) * (1.0 - v->pressure_loss * flow * flow);

    const double load = (v->full_speed * n - v->idle_speed) / (v->full_speed - v->idle_speed);
    const double burnt = v->idle_combustion_efficiency + (v->combustion_efficiency - v->idle_combustion_efficiency) * load;
    const double heat = lit * burnt * HEATING_VALUE * m_f;
    const double T4 = T_REF + (m * CP_AIR * (T3 - T_REF) + heat) / (m_g * CP_GAS);

    /* T5 = T4 (1 - eta (1 - (p5/p4)^1/4)), (p5/pa)^1/4 = T5/T8, and a jet of speed k T8 with k = m_g R / (pa A):
     * together a quadratic in s = sqrt(1 + 2 k^2 T5 / c_p), with T5 / T8 = (1 + s) / 2 */
    const double k = m_g * R / (a->pa * v->nozzle_area), kappa = 2.0 * k * k / CP_GAS;
    const double kept = T4 * (1.0 - v->turbine_efficiency), half = T4 * v->turbine_efficiency * sqrt(sqrt(a->pa / p4)) / 2.0;
    const double b = kappa * half / 2.0, s = b + sqrt((b + 1.0) * (b + 1.0) + kappa * kept);
    const double T5 = kept + half * (1.0 + s), jet = 2.0 * k * T5 / (1.0 + s);

    const double turbine = m_g * CP_GAS * (T4 - T5), compressor = m * CP_AIR * (T3 - a->T2);
    const double share = w / moving; /* 1 but for the slowest */
    return (Gas){share * (turbine - compressor) / moving, share * (m_g * jet - m * a->V), T5};
}

/* w' */
static double rotor(const Plant *a, double w, double m_f, Phase phase)
{
    const Variables *v = a->v;
    const double full = v->full_speed * RPM, gas = gas_path(a, w, m_f, phase >= SPOOLING).torque;
    const double starter = v->starter_torque * limit(1.0 - w / (v->starter_speed * RPM), 0.0, 1.0);
    const double windage = v->windage_power * w / (full * full);
    return (gas - windage + (phase == CRANKING || phase == SPOOLING ? starter : 0.0)) / v->rotor_inertia;
}

/* The speed at which the static thrust is a straight line between idle and full throttle. */
static double demanded_speed(const Variables *v, const State *s, double throttle)
{
    return v->full_speed * RPM * pow(s->idle_share + (1.0 - s->idle_share) * throttle, 1.0 / v->thrust_exponent);
}

static double damping(const Variables *v, const State *s) { return v->speed_gain * s->w / (v->full_speed * RPM); }

/* The reference is led no faster than a share of itself a second, nor than so many rpm a second (0: no such limit). */
static double led(const Variables *v, double reference, double step)
{
    const double rise = ENGINE_STEP * v->acceleration * reference, fall = ENGINE_STEP * v->deceleration * reference;
    const double most = ENGINE_STEP * v->reference_rise * RPM, least = ENGINE_STEP * v->reference_fall * RPM;
    return limit(step, -(least > 0.0 && least < fall ? least : fall), most > 0.0 && most < rise ? most : rise);
}

/* Fuel on or off, and the reference of the speed loop. */
static void sequence(const Plant *a, State *s, double throttle)
{
    const Variables *v = a->v;
    const int32_t on = v->run >= 0.5;
    if (!on)
        s->phase = OFF;
    else if (!s->was_on)
        s->phase = CRANKING;
    s->was_on = on;
    const double idle = v->idle_speed * RPM;
    switch ((Phase)s->phase) {
    case OFF:
        s->fuel = 0.0; /* the valve shuts at once */
        s->waited = 0;
        break;
    case CRANKING:
        if (s->w < v->light_speed * RPM || ++s->waited < v->ignition_time / ENGINE_STEP)
            break;
        s->phase = SPOOLING;
        s->fuel = v->leanest_command * air_flow(a, s->w);
        s->reference = s->w;
        s->integral = s->fuel + damping(v, s);
        break;
    case SPOOLING:
        s->reference = limit(s->reference + ENGINE_STEP * idle / v->spooling_time, 0.0, limit(s->reference, idle, HUGE_VAL));
        if (s->w >= 0.99 * idle)
            s->phase = RUNNING;
        break;
    case RUNNING: {
        const double step = demanded_speed(v, s, throttle) - s->reference;
        s->reference += led(v, s->reference, step);
    }
    }
}

/* The ECU's least and most fuel at speed w. */
static double leanest_fuel(const Plant *a, double w) { return a->v->leanest_command * air_flow(a, w); }

/* The most, for who asks for `command`: a richest mixture and, where it is limited, the temperature behind the turbine. */
static double most_fuel(const Plant *a, double w, double command)
{
    const Variables *v = a->v;
    const double richest = v->richest_command * air_flow(a, w);
    double low = leanest_fuel(a, w), high = limit(command, low, richest);
    if (v->exhaust_limit == 0.0 || gas_path(a, w, high, 1.0).T5 <= v->exhaust_limit)
        return richest;
    /* the fuel that burns at the limit, by halving: T5 rises with the fuel */
    for (int i = 0; i < 60; i++) {
        const double middle = (low + high) / 2.0;
        if (gas_path(a, w, middle, 1.0).T5 <= v->exhaust_limit)
            low = middle;
        else
            high = middle;
    }
    return low;
}

static double richest_fuel(const Plant *a, double w) { return most_fuel(a, w, HUGE_VAL); }

/* Fuel by schedule: it rises and falls in shares of itself, by the error and the level, and with what the error itself
 * does; less so for who is too slow, and within the ECU's ramps.  turbine-220/README.md. */
static double scheduled_fuel(const Variables *v, State *s, double error)
{
    const double h = ENGINE_STEP, f = s->asked, n = s->w / (v->full_speed * RPM);
    const double most = v->fuel_rise == 0.0 ? HUGE_VAL : v->fuel_rise, least = v->fuel_fall == 0.0 ? HUGE_VAL : v->fuel_fall;
    const double share = error > 0.0 ? v->fuel_rise_share : 1.0;
    const double ramp = limit(share * v->fuel_gain * n * error, -least, most);
    const double change = h * f * ramp + share * v->fuel_response * (error - s->error);
    s->error = error;
    return f + limit(change, -h * f * least, HUGE_VAL);
}

/* Fuel by error: the error of the speed and its change move the fuel, the first by a power of the level, within two ramps
 * that hold both, the one in kg/s, the other a share of the fuel.  turbine-220/README.md. */
static double led_fuel(const Variables *v, State *s, double error)
{
    const double h = ENGINE_STEP, f = s->asked, n = s->w / (v->full_speed * RPM);
    const double most = v->fuel_ramp == 0.0 ? HUGE_VAL : h * v->fuel_ramp;
    const double least = v->fuel_fall == 0.0 ? HUGE_VAL : h * f * v->fuel_fall;
    const double gain = h * v->fuel_integral * pow(n, v->fuel_integral_exponent);
    const double change = gain * error + v->fuel_response * (error - s->error);
    s->error = error;
    return f + limit(change, -least, most);
}

/* Fuel: by error, by schedule, or the integral of the speed's error less a share of the speed, within the least and the most
 * fuel; the integral stands while the command is held. */
static double fuel_command(const Plant *a, State *s)
{
    const Variables *v = a->v;
    if (s->phase < SPOOLING)
        return 0.0;
    const double low = leanest_fuel(a, s->w), off = (s->reference - s->w) / (v->full_speed * RPM);
    const double error = fabs(off) <= v->speed_dead_band ? 0.0 : off - copysign(v->speed_dead_band, off);
    if ((v->fuel_integral > 0.0 || v->fuel_gain > 0.0) && s->phase == RUNNING) {
        const double command = v->fuel_integral > 0.0 ? led_fuel(v, s, error) : scheduled_fuel(v, s, error);
        return s->asked = limit(command, low, most_fuel(a, s->w, command));
    }
    const double command = s->integral - damping(v, s), high = most_fuel(a, s->w, command);
    if ((command > low || error > 0.0) && (command < high || error < 0.0))
        s->integral += ENGINE_STEP * v->integral_gain * error;
    return s->asked = limit(command, low, high);
}

static void outputs(Variables *v, const Plant *a, const State *s)
{
    const Gas gas = gas_path(a, s->w, s->fuel, s->phase >= SPOOLING);
    v->thrust = gas.thrust;
    v->spool_speed = s->w / RPM;
    v->exhaust_temperature = gas.T5;
    v->fuel_flow = s->fuel;
}

/* Fuel for a balance of torques at speed w, by halving between two mixtures. */
static double balancing_fuel(const Plant *a, double w, double low, double high)
{
    for (int i = 0; i < 60; i++) { /* then nothing is left to halve */
        const double middle = (low + high) / 2.0;
        if (rotor(a, w, middle, RUNNING) < 0.0)
            low = middle;
        else
            high = middle;
    }
    return low;
}

/* Speed for a balance of torques at a limit of the fuel, likewise. */
static double balancing_speed(const Plant *a, double (*fuel)(const Plant *, double), double slow, double fast)
{
    for (int i = 0; i < 60; i++) {
        const double middle = (slow + fast) / 2.0;
        if (rotor(a, middle, fuel(a, middle), RUNNING) > 0.0)
            slow = middle;
        else
            fast = middle;
    }
    return slow;
}

/* The equilibrium at throttle_start: the speed demanded, or the nearest that the ECU's mixtures allow. */
static void settle(const Plant *a, State *s, double throttle)
{
    const Variables *v = a->v;
    const double demand = demanded_speed(v, s, throttle);
    s->w = s->reference = demand;
    if (rotor(a, demand, richest_fuel(a, demand), RUNNING) < 0.0) { /* too little air, or too hot, to hold it */
        s->w = balancing_speed(a, richest_fuel, v->light_speed * RPM, demand);
        s->fuel = richest_fuel(a, s->w);
    } else if (rotor(a, demand, leanest_fuel(a, demand), RUNNING) > 0.0) { /* too much to stay down */
        s->w = balancing_speed(a, leanest_fuel, demand, 2.0 * demand);
        s->fuel = leanest_fuel(a, s->w);
    } else {
        s->fuel = balancing_fuel(a, demand, leanest_fuel(a, demand), v->richest_command * air_flow(a, demand));
    }
    s->asked = s->fuel;
    s->integral = s->fuel + damping(v, s);
    s->phase = RUNNING;
    s->was_on = 1;
}

void engine_start(Variables *v, void *state)
{
    State *s = state;
    memset(s, 0, sizeof(*s)); /* padding too: saved states are compared byte by byte */
    s->full_rise = (pow(v->pressure_ratio, 2.0 / 7.0) - 1.0) / v->compressor_efficiency;
    s->idle_share = pow(v->idle_speed / v->full_speed, v->thrust_exponent);
    const double throttle = command_start(v, &s->command, v->throttle_start);
    const Plant a = plant(v, s);
    if (v->cold_start == 0 && v->run >= 0.5)
        settle(&a, s, throttle);
    outputs(v, &a, s);
}

void engine_step(Variables *v, void *state)
{
    State *s = state;
    const Plant a = plant(v, s);
    const double h = ENGINE_STEP, tau = v->pump_time_constant;
    sequence(&a, s, command_step(v, &s->command, v->throttle));
    const double command = fuel_command(&a, s);
    const Phase phase = (Phase)s->phase;

    /* Runge-Kutta of fourth order, one step; without fire there is no fuel to follow a command */
    const double w = s->w, f = s->fuel, pump = phase >= SPOOLING ? 1.0 / tau : 0.0;
    const double w1 = rotor(&a, w, f, phase), f1 = (command - f) * pump;
    const double w2 = rotor(&a, w + h / 2.0 * w1, f + h / 2.0 * f1, phase), f2 = (command - f - h / 2.0 * f1) * pump;
    const double w3 = rotor(&a, w + h / 2.0 * w2, f + h / 2.0 * f2, phase), f3 = (command - f - h / 2.0 * f2) * pump;
    const double w4 = rotor(&a, w + h * w3, f + h * f3, phase), f4 = (command - f - h * f3) * pump;
    s->w = w + h / 6.0 * (w1 + 2.0 * w2 + 2.0 * w3 + w4);
    s->fuel = f + h / 6.0 * (f1 + 2.0 * f2 + 2.0 * f3 + f4);

    /* too lean to burn */
    if (s->phase >= SPOOLING && s->fuel < v->lean_limit * air_flow(&a, s->w))
        s->phase = OFF;
    outputs(v, &a, s);
}
