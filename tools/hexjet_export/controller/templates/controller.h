[[ licence ]]
/* [[ title ]]
 *
 * Made by hexjet export controller ([[ maker ]]); parameters and origin are in [[ n ]]_parameters.c.
{% if f.accelerations %}
 * Body axes are forward-right-down, angles in rad, everything else in SI units; the rate loop's output is angular
 * accelerations, a collective a share of an engine's range of thrust, 0 to 1.
{% else %}
 * Body axes are forward-right-down, angles in rad, everything else in SI units; a command of roll and a collective are
 * shares of an engine's range of thrust, 0 to 1.
{% endif %}
 * Where an input that a step needs is not finite, outputs and state stay as they are, and `held` says so.
 * Call [[ n ]]_reset once, then [[ n ]]_step every [[ step ]] s.
 *
 * Compile with -ffp-contract=off (no fused multiply-add) and without -ffast-math to get the bits of the simulation.
 * Define [[ N ]]_FLOAT for single precision. No heap, no recursion, no state but the struct that the caller keeps.
 *
{% if f.loops %}
 * The loops alone: torque and collective go to a mixer of your own, and what it could not give comes back with the next
 * step, so that no integral winds up.
 *
{% endif %}
 * Not in it, which the simulation may fly around it: the engine monitor and the plans around lost engines, changes of
 * gains by a ground station, navigation and flight modes.
 */
#ifndef [[ N ]]_H
#define [[ N ]]_H

#include <stdbool.h>
{% if f.uses_line %}
#include <stdint.h>
{% endif %}

{% if single %}
#ifndef [[ N ]]_FLOAT
#define [[ N ]]_FLOAT /* as the autopilot computes */
#endif
{% endif %}
#ifdef [[ N ]]_FLOAT
typedef float [[ n ]]_Real;
#else
typedef double [[ n ]]_Real;
#endif

#define [[ N ]]_JETS [[ f.jets ]]
#define [[ N ]]_STEP_S [[ step ]]
{% if f.allocation.kind == "effectiveness" %}
#define [[ N ]]_SERVOS [[ f.servos|length ]] /* [[ f.servos|join(", ")|wordwrap(90, wrapstring="\n * ") ]] */
#define [[ N ]]_LINKS [[ f.allocation.links ]] /* hinges of one jet, at most */
#define [[ N ]]_EFFECTORS ([[ N ]]_JETS + [[ N ]]_SERVOS)
#define [[ N ]]_ROWS 6 /* roll, pitch, lift, yaw, ahead, right */
{% endif %}

/* What the step does with the engines. */
typedef enum {
    [[ N ]]_FLY = 0,  /* as the loops ask */
    [[ N ]]_IDLE = 1, /* least throttle, no torque, and nothing is remembered */
    [[ N ]]_OFF = 2   /* the same with every jet marked off */
} [[ n ]]_Engines;

typedef struct {
    /* what is asked for */
    [[ n ]]_Real attitude_setpoint[3]; /* rad: roll, pitch, yaw, in the order yaw-pitch-roll from NED to body */
    [[ n ]]_Real altitude_setpoint;    /* m above the ground */
    [[ n ]]_Real rate_setpoint[3];     /* rad/s; replaces the attitude loop where rates_commanded */
    [[ n ]]_Real collective_setpoint;  /* replaces the altitude loop where collective_commanded */
    bool rates_commanded;
    bool collective_commanded;
    [[ n ]]_Engines engines;
    /* what is measured */
    [[ n ]]_Real rate[3];       /* rad/s, body */
    [[ n ]]_Real attitude[4];   /* unit quaternion w, x, y, z: body to NED */
    [[ n ]]_Real velocity_down; /* m/s */
    [[ n ]]_Real altitude;      /* m above the ground */
    [[ n ]]_Real fuel_burnt;    /* kg since the full tank, at the end of the step before */
{% if f.loops %}
    [[ n ]]_Real unallocated[4]; /* roll, pitch, yaw, collective: what your mixer could not give in the step before */
{% endif %}
} [[ n ]]_Input;

typedef struct {
{% if f.loops %}
    [[ n ]]_Real torque[3];         /* [[ torque_unit ]], for your mixer */
    [[ n ]]_Real collective;        /* for your mixer: the share of an engine's range of thrust, the same of all */
{% else %}
    [[ n ]]_Real throttle[ [[- N ]]_JETS]; /* 0 to 1, jets 1 to [[ f.jets ]] */
{% if f.allocation.kind == "effectiveness" %}
    [[ n ]]_Real tilt[ [[- N ]]_SERVOS];   /* rad, hinges in their order */
{% else %}
    [[ n ]]_Real tilt[2];                  /* rad, left and right servo, positive tilts the thrust forward */
{% endif %}
    bool off[ [[- N ]]_JETS];              /* jets to be shut off on purpose */
    [[ n ]]_Real unallocated[4];           /* roll, pitch, yaw, collective: asked for, less given */
{% endif %}
    /* to look at */
    [[ n ]]_Real rate_setpoint[3];  /* rad/s, body */
    [[ n ]]_Real rate_predicted[3]; /* rad/s, body: what the rate loop is fed with */
{% if not f.loops %}
    [[ n ]]_Real torque[3];         /* the rate loop's output */
    [[ n ]]_Real collective;        /* asked for */
    [[ n ]]_Real allocated;         /* given */
{% endif %}
    bool held;                      /* an input was not finite: all else is that of the step before */
} [[ n ]]_Output;
{% if f.allocation.kind == "effectiveness" %}

/* What allocation knows of the vehicle; [[ n ]].c has the equations. */

[[ solver_types ]]
{%- endif %}

typedef struct {
    [[ n ]]_Real p, i, d; /* i times the step */
    [[ n ]]_Real limit;   /* of the integral */
    [[ n ]]_Real share;   /* of a new slope in the filtered one */
} [[ n ]]_RateGains;

typedef struct {
    [[ n ]]_Real predicted, integral, slope, command;
    bool started;
} [[ n ]]_RateState;
{% if f.uses_lead %}

/* most + c1 L + c2 L^2 with the low-pass L = q / (z - p) */
typedef struct {
    [[ n ]]_Real most, p, q, c1, c2;
} [[ n ]]_Lead;

typedef struct {
    [[ n ]]_Real once, twice;
} [[ n ]]_LeadState;
{% endif %}
{% for axis in f.axes if axis.predictor.kind != "none" %}
{% set q = axis.predictor %}

typedef struct {
{% for name, size in q.constants %}
    [[ n ]]_Real [[ name ]]{% if size %}[ [[- size ]]]{% endif %};
{% endfor %}
} [[ n ]]_[[ axis.name|capitalize ]]Predictor;

typedef struct {
{% for name, size in q.states %}
    [[ n ]]_Real [[ name ]]{% if size %}[ [[- size ]]]{% endif %};
{% endfor %}
{% if q.line %}
    int32_t at;
{% endif %}
} [[ n ]]_[[ axis.name|capitalize ]]PredictorState;
{% endfor %}
{% if f.schedule %}

/* Factors on the gains at one thrust level, and the engine that the lead divides out there. */
typedef struct {
    [[ n ]]_Real angle, p, i, d;
    [[ n ]]_Real natural_rad_s, damping, pole_rad_s;
} [[ n ]]_Level;
{% endif %}

typedef struct {
    [[ n ]]_Real step; /* s */
    [[ n ]]_Real mass; /* kg, tank full */
    [[ n ]]_Real attitude_gain[3];  /* 1/s */
    [[ n ]]_Real attitude_limit[3]; /* rad/s */
{% if f.law %}
    [[ n ]]_Real rate_scale[3];     /* of the rates asked for: the law's own attitude gain over that above */
{% endif %}
{% for axis in f.axes %}
    [[ n ]]_RateGains [[ axis.name ]];
{% if axis.predictor.kind != "none" %}
    [[ n ]]_[[ axis.name|capitalize ]]Predictor [[ axis.name ]]_predictor;
{% endif %}
{% if axis.lead and not axis.scheduled %}
    [[ n ]]_Lead [[ axis.name ]]_lead;
{% endif %}
{% endfor %}
    [[ n ]]_Real position, up, down;      /* 1/s, m/s, m/s (down is negative) */
    [[ n ]]_Real velocity, integral;      /* 1/s, 1/s^2 times the step */
    [[ n ]]_Real integral_limit;          /* m/s^2 */
{% if f.altitude.lead and not f.schedule %}
    [[ n ]]_Lead altitude_lead;
{% endif %}
{% if f.schedule %}
    [[ n ]]_Real level_share[ [[- f.schedule.share|length ]]];
    [[ n ]]_Level roll_level[ [[- f.schedule.share|length ]]];
    [[ n ]]_Level altitude_level[ [[- f.schedule.share|length ]]];
    [[ n ]]_Real level_follow; /* of the way to the share given, each step */
    [[ n ]]_Real level_fine;   /* so far the level moves before the gains do */
{% endif %}
    [[ n ]]_Real throttle_min, throttle_max, hover;
{% if f.allocation.kind == "tilt" %}
    [[ n ]]_Real idle;         /* thrust without throttle, over what full throttle adds to it */
    [[ n ]]_Real hover_thrust; /* hover + idle */
    [[ n ]]_Real tilt_range;   /* rad */
    [[ n ]]_Real pitch_sign;
{% elif f.allocation.kind == "effectiveness" %}
    [[ n ]]_Effectors effectors;
    int levels;
    [[ n ]]_RowLevel level[ [[- N ]]_ROWS]; /* of rows, the most important first */
    [[ n ]]_Real tensor[3][3], inverse[3][3]; /* of inertia, kg m^2 */
    [[ n ]]_Real share_low[ [[- N ]]_JETS], share_high[ [[- N ]]_JETS];
    [[ n ]]_Real end_low[ [[- N ]]_JETS], end_high[ [[- N ]]_JETS];       /* N */
    [[ n ]]_Real preferred[ [[- N ]]_JETS];                               /* N: as the thrusts carry the weight */
    [[ n ]]_Real reach_low[ [[- N ]]_SERVOS], reach_high[ [[- N ]]_SERVOS]; /* rad */
    [[ n ]]_Real rest[ [[- N ]]_SERVOS];                                  /* rad */
{% elif f.allocation.kind == "rotor" %}
    [[ n ]]_Real signs[ [[- f.jets ]]][3]; /* of each rotor in roll, pitch and yaw */
{% endif %}
    [[ n ]]_Real thrust_low, thrust_span; /* N, of an engine at rest */
{% for curve in f.thrust.curves %}
    [[ n ]]_Real curve_[[ loop.index0 ]]_thrust[ [[- curve.thrust|length ]]]; /* N */
    [[ n ]]_Real curve_[[ loop.index0 ]]_throttle[ [[- curve.thrust|length ]]];
    [[ n ]]_Real curve_[[ loop.index0 ]]_slope[ [[- curve.slope|length ]]];
{% endfor %}
} [[ n ]]_Parameters;

typedef struct {
    [[ n ]]_Real euler[3], setpoint[4]; /* of the last attitude asked for */
{% for axis in f.axes %}
    [[ n ]]_RateState [[ axis.name ]];
{% if axis.predictor.kind != "none" %}
    [[ n ]]_[[ axis.name|capitalize ]]PredictorState [[ axis.name ]]_predictor;
{% endif %}
{% if axis.lead %}
    [[ n ]]_LeadState [[ axis.name ]]_lead;
{% endif %}
{% endfor %}
    [[ n ]]_Real altitude_integral;
{% if f.altitude.lead %}
    [[ n ]]_LeadState altitude_lead;
    bool altitude_started;
{% endif %}
{% if f.schedule %}
    [[ n ]]_Real level, told;
    [[ n ]]_Real attitude_gain; /* of roll, at this level, as everything that follows */
    [[ n ]]_RateGains roll_gains;
    [[ n ]]_Real position, velocity, integral;
{% if f.axes[0].lead %}
    [[ n ]]_Lead roll_lead_now;
{% endif %}
{% if f.altitude.lead %}
    [[ n ]]_Lead altitude_lead_now;
{% endif %}
{% endif %}
{% if f.delay %}
    [[ n ]]_Real added_delay[ [[- f.delay ]]];
    int32_t added_at;
{% endif %}
{% if f.allocation.kind == "effectiveness" %}
    [[ n ]]_Real last[ [[- N ]]_EFFECTORS]; /* commands of the step before: N, rad */
{% endif %}
{% if f.loops %}
    [[ n ]]_Real collective; /* asked for in the step before */
    bool begun;
{% endif %}
    [[ n ]]_Real unallocated[4];
    [[ n ]]_Output held; /* of the step before */
} [[ n ]]_State;

/* As designed; in read-only memory. */
extern const [[ n ]]_Parameters [[ n ]]_parameters;

{% if f.loops %}
/* A flight begins. */
void [[ n ]]_reset(const [[ n ]]_Parameters *parameters, [[ n ]]_State *state, [[ n ]]_Real fuel_burnt);
{% else %}
/* A flight begins, standing or hovering; `throttle` gets those at which the engines stand before the first step. */
void [[ n ]]_reset(const [[ n ]]_Parameters *parameters, [[ n ]]_State *state, bool on_ground,
    [[ n ]]_Real fuel_burnt, [[ n ]]_Real throttle[ [[- N ]]_JETS]);
{% endif %}

/* One control step. */
void [[ n ]]_step(const [[ n ]]_Parameters *parameters, [[ n ]]_State *state, const [[ n ]]_Input *input,
    [[ n ]]_Output *output);

#endif
