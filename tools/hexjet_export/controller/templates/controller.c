[[ licence ]]
/* [[ title ]]: see [[ n ]].h. The order of operations is that of the simulation. */
#include "[[ n ]].h"

#include <math.h>
{% if single %}

#ifdef __GNUC__
#pragma GCC diagnostic ignored "-Wfloat-equal" /* what is compared with zero is zero, or was never set */
#endif
{% endif %}

typedef [[ n ]]_Real Real;

#define R(x) ((Real)(x))
#define GRAVITY R([[ gravity ]])   /* m/s^2 */
#define LEAST_UPRIGHT R([[ least_upright ]]) /* thrust is not raised further for a lean beyond 60 degrees */
{% if f.allocation.kind == "tilt" %}
#define LEAST_SHARE R([[ least_share ]])  /* of hover thrust, below which tilts are not enlarged further */
{% endif %}
{% set hinged = f.allocation.kind == "effectiveness" %}
#ifdef [[ N ]]_FLOAT
#define SIN sinf
#define COS cosf
{% if f.lead_orders or hinged %}
#define SQRT sqrtf
{% endif %}
{% if hinged %}
#define RANK 1e-11f /* what is less is rounding, here and below */
#define DONE 1e-6f
#define LET_GO 1e-5f
#define SETTLED 1e-5f
{% endif %}
#else
#define SIN sin
#define COS cos
{% if f.lead_orders %}
#define EXP exp
{% endif %}
{% if f.lead_orders or hinged %}
#define SQRT sqrt
{% endif %}
{% if hinged %}
#define RANK 1e-20 /* what is less is rounding, here and below */
#define DONE 1e-13
#define LET_GO 1e-9
#define SETTLED 1e-9
{% endif %}
#endif
{% if hinged %}

[[ solver_functions ]]
{%- endif %}

static Real clamp(Real value, Real most)
{
    return (value > most) ? most : ((value < -most) ? -most : value);
}

static Real between(Real value, Real low, Real high)
{
    return (value < low) ? low : ((value > high) ? high : value);
}

{% if f.schedule or f.allocation.kind == "rotor" %}
static Real magnitude(Real value)
{
    return (value < R(0.0)) ? -value : value;
}

{% endif %}
static void clear(Real values[], int count)
{
    for (int i = 0; i < count; i++) {
        values[i] = R(0.0);
    }
}

{% if f.uses_sent %}
/* A scalar product, summed in order. */
static Real dot(const Real a[], const Real b[], int count)
{
    Real total = R(0.0);
    for (int i = 0; i < count; i++) {
        total += a[i] * b[i];
    }
    return total;
}

/* The commands on their way, the oldest first. */
static void send(Real sent[], int count, Real applied)
{
    for (int i = 1; i < count; i++) {
        sent[i - 1] = sent[i];
    }
    sent[count - 1] = applied;
}

{% endif %}
{% if f.uses_line %}
/* What went in `samples` updates ago. */
static Real delay_line(Real line[], int32_t *at, int32_t samples, Real value)
{
    const Real old = line[*at];
    line[*at] = value;
    *at = ((*at + 1) < samples) ? (*at + 1) : 0;
    return old;
}

{% endif %}
{% if f.uses_discrete %}
/* A strictly proper transfer function, transposed direct form: past[i] is what is known of the output i steps ahead. */
static Real discrete_model(const Real b[], const Real a[], Real past[], int order, Real applied)
{
    const Real value = past[0] + b[0] * applied;
    const int last = order - 1;
    for (int i = 0; i < last; i++) {
        past[i] = past[i + 1] + b[i + 1] * applied - a[i] * value;
    }
    past[last] = -a[last] * value;
    return value;
}

{% endif %}
{% for axis in f.axes if axis.predictor.kind != "none" %}
{% set q = axis.predictor %}
{% set A = axis.name|capitalize %}
/* [[ q.title ]], [[ axis.name ]] */
static void reset_[[ axis.name ]]_predictor([[ n ]]_[[ A ]]PredictorState *s)
{
{% for name, size in q.states %}
{% if size %}
    clear(s->[[ name ]], [[ size ]]);
{% else %}
    s->[[ name ]] = R(0.0);
{% endif %}
{% endfor %}
{% if q.line %}
    s->at = 0;
{% endif %}
}

static Real predict_[[ axis.name ]](const [[ n ]]_[[ A ]]Predictor *p, [[ n ]]_[[ A ]]PredictorState *s, Real measured,
    Real applied)
{
{% if q.kind == "early-late" %}
    const Real now = discrete_model(p->now_b, p->now_a, s->now, [[ q.now_a|length ]], applied);
{% if q.then_a is defined %}
{% set late = "discrete_model(p->then_b, p->then_a, s->then, " ~ q.then_a|length ~ ", applied)" %}
{% else %}
{% set late = "now" %}
{% endif %}
    const Real then = {% if q.line %}delay_line(s->line, &s->at, [[ q.line ]], [[ late ]]){% else %}[[ late ]]{% endif %};
    return measured + (now - then);
{% elif q.kind == "early-late-filtered" %}
{% set late = "discrete_model(p->then_b, p->then_a, s->then, " ~ q.then_a|length ~ ", applied)" %}
    const Real then = {% if q.line %}delay_line(s->line, &s->at, [[ q.line ]], [[ late ]]){% else %}[[ late ]]{% endif %};
    const Real difference = measured - then;
    Real filtered = p->through * difference;
{% if q.rest_a is defined %}
    filtered += discrete_model(p->rest_b, p->rest_a, s->rest, [[ q.rest_a|length ]], s->before);
    s->before = difference;
{% endif %}
    const Real now = discrete_model(p->now_b, p->now_a, s->now, [[ q.now_a|length ]], applied);
    return measured + (now - then) + (filtered - difference);
{% elif q.kind == "linear" %}
    send(s->sent, [[ q.weights|length ]], applied);
    const Real late = s->sent[0];
    Real ahead[ [[- q.of_state|length ]]];
    for (int i = 0; i < [[ q.of_state|length ]]; i++) {
        ahead[i] = dot(p->transition[i], s->x, [[ q.of_state|length ]]) + p->of_rate[i] * measured + p->of_command[i] * late;
    }
    for (int i = 0; i < [[ q.of_state|length ]]; i++) {
        s->x[i] = ahead[i];
    }
    return dot(p->of_state, s->x, [[ q.of_state|length ]]) + dot(p->weights, s->sent, [[ q.weights|length ]]);
{% else %}
    send(s->sent, [[ q.weights|length ]], applied);
    const Real before = s->sent[0];
    const Real now = s->sent[1];
{% if q.kind == "double-integrator" %}
    const Real late = p->f * before + (R(1.0) - p->f) * now;
    const Real x = s->x[0];
    const Real v = s->x[1];
    const Real *const t = p->transition;
    s->x[0] = t[0] * x + t[1] * v + p->of_rate[0] * measured + p->of_command[0] * late;
    s->x[1] = t[2] * x + t[3] * v + p->of_rate[1] * measured + p->of_command[1] * late;
    return p->of_state[0] * s->x[0] + p->of_state[1] * s->x[1] + dot(p->weights, s->sent, [[ q.weights|length ]]);
{% elif q.kind == "model-observer" %}
    Real ahead[ [[- q.gain|length ]]];
    for (int i = 0; i < [[ q.gain|length ]]; i++) {
        ahead[i] = dot(p->transition[i], s->x, [[ q.gain|length ]]);
    }
    ahead[0] += p->push[0] * before + p->push[1] * now;
    ahead[1] += p->push[2] * before + p->push[3] * now;
    const Real error = measured - ahead[0];
    for (int i = 0; i < [[ q.gain|length ]]; i++) {
        s->x[i] = ahead[i] + p->gain[i] * error;
    }
    return p->of_state[0] * s->x[0] + p->of_state[1] * s->x[1] + dot(p->weights, s->sent, [[ q.weights|length ]])
{%- if q.of_disturbance is defined %}

        + p->of_disturbance * s->x[2]
{%- endif %};
{% else %}
{% set plus_d = " + s->disturbance" if q.gathered is defined else "" %}
    Real estimated = R(0.0);
    for (int i = 0; i < [[ q.poles|length ]]; i++) {
{% if q.poles_im is defined %}
        const Real re = s->x[i];
        const Real im = s->x_im[i];
        s->x[i] = p->poles[i] * re - p->poles_im[i] * im[[ plus_d ]]
            + p->shares[i] * now + (R(1.0) - p->shares[i]) * before;
        s->x_im[i] = p->poles[i] * im + p->poles_im[i] * re + p->shares_im[i] * now - p->shares_im[i] * before;
        estimated += s->x[i] * p->residues[i] - s->x_im[i] * p->residues_im[i];
{% else %}
        s->x[i] = p->poles[i] * s->x[i][[ plus_d ]] + p->shares[i] * now + (R(1.0) - p->shares[i]) * before;
        estimated += p->residues[i] * s->x[i];
{% endif %}
    }
    const Real error = measured - estimated;
    Real answer = R(0.0);
    for (int i = 0; i < [[ q.poles|length ]]; i++) {
        s->x[i] += p->gain[i] * error;
{% if q.poles_im is defined %}
        s->x_im[i] += p->gain_im[i] * error;
        answer += p->ahead[i] * s->x[i] - p->ahead_im[i] * s->x_im[i];
{% else %}
        answer += p->ahead[i] * s->x[i];
{% endif %}
    }
{% if q.gathered is defined %}
    s->disturbance += p->gain[ [[- q.poles|length ]]] * error;
{% endif %}
    return answer + dot(p->weights, s->sent, [[ q.weights|length ]]){% if q.gathered is defined %} + p->gathered * s->disturbance{% endif %};
{% endif %}
{% endif %}
}

{% endfor %}
{% if f.uses_lead %}
static void settle_lead([[ n ]]_LeadState *s, Real value)
{
    s->once = value;
    s->twice = value;
}

/* What allocation could not give of the answer before is taken back from the lead's past. */
static Real lead(const [[ n ]]_Lead *c, [[ n ]]_LeadState *s, Real wanted, Real unallocated)
{
    Real once = s->once;
    if (unallocated != R(0.0)) {
        once -= c->q * unallocated / c->most;
    }
    const Real twice = s->twice;
    s->twice = c->p * twice + c->q * once;
    s->once = c->p * once + c->q * wanted;
    return c->most * wanted + c->c1 * once + c->c2 * twice;
}

{% endif %}
{% if f.lead_orders %}
#ifdef [[ N ]]_FLOAT
/* In single precision what is left of 1 is computed, not 1 less something: with d_i = 1 - z_i and q = 1 - p
 * the lead's gain is q^n / prod d_i, and its parts behind one low-pass and two follow from d_i - q. */
{% for order in f.lead_orders %}
{% if order == 2 %}
static void design_lead_2([[ n ]]_Lead *c, Real natural, Real damping, Real pole, Real step)
{
    const Real under = damping * damping - R(1.0);
    const Real turn = natural * SQRT(magnitude(under)) * step;
    const Real q = -expm1f(-pole * step);
    Real sum;
    Real product;
    Real apart; /* (d_1 - q) (d_2 - q) */
    if (under >= R(0.0)) {
        const Real d_1 = -expm1f(-damping * natural * step + turn);
        const Real d_2 = -expm1f(-damping * natural * step - turn);
        sum = d_1 + d_2;
        product = d_1 * d_2;
        apart = (d_1 - q) * (d_2 - q);
    } else {
        const Real less = -expm1f(-damping * natural * step);
        const Real half = SIN(R(0.5) * turn);
        const Real re = less + R(2.0) * (R(1.0) - less) * half * half;
        const Real im = (R(1.0) - less) * SIN(turn);
        sum = R(2.0) * re;
        product = re * re + im * im;
        apart = (re - q) * (re - q) + im * im;
    }
    c->most = q * q / product;
    c->p = R(1.0) - q;
    c->q = q;
    c->c1 = c->most * (sum - R(2.0) * q) / q;
    c->c2 = apart / product;
}
{% else %}
static void design_lead_1([[ n ]]_Lead *c, Real natural, Real pole, Real step)
{
    const Real d = -expm1f(-natural * step);
    const Real q = -expm1f(-pole * step);
    c->most = q / d;
    c->p = R(1.0) - q;
    c->q = q;
    c->c1 = (d - q) / d;
    c->c2 = R(0.0);
}
{% endif %}
{% endfor %}
#else
{% for order in f.lead_orders %}
{% if order == 2 %}
/* The lead that divides two engine lags out, by natural frequency and damping, and puts two at -pole in their place. */
static void design_lead_2([[ n ]]_Lead *c, Real natural, Real damping, Real pole, Real step)
{
    const Real under = damping * damping - R(1.0);
    const Real eighth = magnitude(under) / R(8.0);
    const Real turn = natural * (R(2.0) * SQRT(eighth + eighth));
    const Real turn_re = (under >= R(0.0)) ? turn : R(0.0);
    const Real turn_im = (under >= R(0.0)) ? R(0.0) : turn;
    const Real size_1 = EXP((-damping * natural + turn_re) * step);
    const Real size_2 = EXP((-damping * natural - turn_re) * step);
    const Real re_1 = size_1 * COS(turn_im * step);
    const Real im_1 = size_1 * SIN(turn_im * step);
    const Real re_2 = size_2 * COS(-turn_im * step);
    const Real im_2 = size_2 * SIN(-turn_im * step);
    const Real p = EXP(-pole * step);
    const Real over_1 = -re_1 - re_2;
    const Real over_2 = re_2 * re_1 - im_2 * im_1;
    const Real gain = (R(1.0) + (-p - p) + p * p) / (R(1.0) + over_1 + over_2);
    const Real b1 = gain * over_1;
    const Real b2 = gain * over_2;
    c->most = gain;
    c->p = p;
    c->q = R(1.0) - p;
    c->c1 = (b1 + R(2.0) * p * gain) / c->q;
    c->c2 = (gain * p * p + b1 * p + b2) / (c->q * c->q);
}

{% else %}
/* The lead that divides one engine lag out and puts one at -pole in its place. */
static void design_lead_1([[ n ]]_Lead *c, Real natural, Real pole, Real step)
{
    const Real z = EXP(-natural * step);
    const Real p = EXP(-pole * step);
    const Real gain = (R(1.0) - p) / (R(1.0) - z);
    c->most = gain;
    c->p = p;
    c->q = R(1.0) - p;
    c->c1 = (gain * -z + p * gain) / c->q;
    c->c2 = R(0.0);
}

{% endif %}
{% endfor %}
#endif

{% endif %}
{% if f.schedule %}
{% set L = f.schedule.share|length %}
static Real of(Real a, Real b, Real part)
{
    return a + part * (b - a);
}

static [[ n ]]_Level level_between(const [[ n ]]_Level *low, const [[ n ]]_Level *high, Real part)
{
    [[ n ]]_Level found;
    found.angle = of(low->angle, high->angle, part);
    found.p = of(low->p, high->p, part);
    found.i = of(low->i, high->i, part);
    found.d = of(low->d, high->d, part);
    found.natural_rad_s = of(low->natural_rad_s, high->natural_rad_s, part);
    found.damping = of(low->damping, high->damping, part);
    found.pole_rad_s = of(low->pole_rad_s, high->pole_rad_s, part);
    return found;
}

/* The gains and leads of a thrust level from the next step on. */
static void follow(const [[ n ]]_Parameters *p, [[ n ]]_State *s, Real level)
{
    const Real share = between(level, p->level_share[0], p->level_share[ [[- L - 1 ]]]);
    int k = 1;
    while ((k < [[ L - 1 ]]) && (share > p->level_share[k])) {
        k++;
    }
    const Real part = (share - p->level_share[k - 1]) / (p->level_share[k] - p->level_share[k - 1]);
    const [[ n ]]_Level roll_at = level_between(&p->roll_level[k - 1], &p->roll_level[k], part);
    const [[ n ]]_Level altitude_at = level_between(&p->altitude_level[k - 1], &p->altitude_level[k], part);
    s->attitude_gain = roll_at.angle * p->attitude_gain[0];
    s->roll_gains.p = roll_at.p * p->roll.p;
    s->roll_gains.i = roll_at.i * p->roll.i;
    s->roll_gains.d = roll_at.d * p->roll.d;
    s->roll_gains.limit = p->roll.limit;
    s->roll_gains.share = p->roll.share;
    s->position = altitude_at.angle * p->position;
    s->velocity = altitude_at.p * p->velocity;
    s->integral = altitude_at.i * p->integral;
{% for name, lead in (("roll", f.axes[0].lead), ("altitude", f.altitude.lead)) if lead %}
{% if lead.order == 2 %}
    design_lead_2(&s->[[ name ]]_lead_now, [[ name ]]_at.natural_rad_s, [[ name ]]_at.damping, [[ name ]]_at.pole_rad_s,
        p->step);
{% else %}
    design_lead_1(&s->[[ name ]]_lead_now, [[ name ]]_at.natural_rad_s, [[ name ]]_at.pole_rad_s, p->step);
{% endif %}
{% endfor %}
}

static void schedule(const [[ n ]]_Parameters *p, [[ n ]]_State *s, Real allocated)
{
    const Real given = between(allocated, p->level_share[0], p->level_share[ [[- L - 1 ]]]);
    s->level = s->level + p->level_follow * (given - s->level);
    if (!(magnitude(s->level - s->told) < p->level_fine)) {
        s->told = s->level;
        follow(p, s, s->level);
    }
}

{% endif %}
{% if f.thrust.curves %}
/* Throttle by thrust: straight lines between the points of an engine's static curve, and beyond its ends. */
static Real inverse(const Real thrusts[], const Real throttles[], const Real slopes[], int points, Real thrust)
{
    int i = 0;
    int end = points - 2;
    while (i < end) {
        const int middle = (i + end) / 2;
        if (thrusts[middle + 1] < thrust) {
            i = middle + 1;
        } else {
            end = middle;
        }
    }
    return throttles[i] + slopes[i] * (thrust - thrusts[i]);
}

{% endif %}
/* The share of an engine's range that asks it for a thrust in N. */
static Real share_of(const [[ n ]]_Parameters *p, Real thrust)
{
{% if f.thrust.reference is none %}
    return (thrust - p->thrust_low) / p->thrust_span;
{% else %}
{% set c = "curve_" ~ f.thrust.reference %}
    return inverse(p->[[ c ]]_thrust, p->[[ c ]]_throttle, p->[[ c ]]_slope,
        [[ f.thrust.curves[f.thrust.reference].thrust|length ]], thrust);
{% endif %}
}
{% if not f.thrust.identity and not f.loops %}

/* Throttles that ask each engine for its share. */
static void throttles_of(const [[ n ]]_Parameters *p, Real throttle[ [[- N ]]_JETS])
{
{% for m in f.thrust.mapped %}
{% set c = "curve_" ~ m.curve %}
    throttle[ [[- m.jet ]]] = between(inverse(p->[[ c ]]_thrust, p->[[ c ]]_throttle, p->[[ c ]]_slope, [[ m.points ]],
        p->thrust_low + throttle[ [[- m.jet ]]] * p->thrust_span), R(0.0), R(1.0));
{% endfor %}
}
{% endif %}

static void quaternion_of(const Real euler[3], Real q[4])
{
    const Real cr = COS(R(0.5) * euler[0]);
    const Real sr = SIN(R(0.5) * euler[0]);
    const Real cp = COS(R(0.5) * euler[1]);
    const Real sp = SIN(R(0.5) * euler[1]);
    const Real cy = COS(R(0.5) * euler[2]);
    const Real sy = SIN(R(0.5) * euler[2]);
    const Real cc = cr * cp;
    const Real ss = sr * sp;
    const Real sc = sr * cp;
    const Real cs = cr * sp;
    q[0] = cc * cy + ss * sy;
    q[1] = sc * cy - cs * sy;
    q[2] = cs * cy + sc * sy;
    q[3] = cc * sy - ss * cy;
}

/* Rate set-point: proportional to the error of the quaternion, taken the short way round, limited on each axis. */
static void attitude(const [[ n ]]_Parameters *p, [[ n ]]_State *s, const [[ n ]]_Input *in, Real rate[3])
{
    const Real *const wanted = in->attitude_setpoint;
    if ((wanted[0] != s->euler[0]) || (wanted[1] != s->euler[1]) || (wanted[2] != s->euler[2])) {
        for (int i = 0; i < 3; i++) {
            s->euler[i] = wanted[i];
        }
        quaternion_of(s->euler, s->setpoint);
    }
    const Real *const a = in->attitude;
    const Real *const b = s->setpoint;
    const Real twice = ((a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]) >= R(0.0)) ? R(2.0) : R(-2.0);
    const Real ex = twice * (a[0] * b[1] - a[1] * b[0] - a[2] * b[3] + a[3] * b[2]);
    const Real ey = twice * (a[0] * b[2] + a[1] * b[3] - a[2] * b[0] - a[3] * b[1]);
    const Real ez = twice * (a[0] * b[3] - a[1] * b[2] + a[2] * b[1] - a[3] * b[0]);
    rate[0] = clamp({% if f.schedule %}s->attitude_gain{% else %}p->attitude_gain[0]{% endif %} * ex, p->attitude_limit[0]);
    rate[1] = clamp(p->attitude_gain[1] * ey, p->attitude_limit[1]);
    rate[2] = clamp(p->attitude_gain[2] * ez, p->attitude_limit[2]);
}

static void reset_rate([[ n ]]_RateState *s)
{
    s->predicted = R(0.0);
    s->integral = R(0.0);
    s->slope = R(0.0);
    s->command = R(0.0);
    s->started = false;
}

/* A PID with the derivative on the rate; the integral stops where allocation refused a command of the error's sign. */
static Real pid(const [[ n ]]_RateGains *g, [[ n ]]_RateState *s, Real setpoint, Real rate, Real unallocated, Real step)
{
    const Real error = setpoint - rate;
    if ((unallocated * error) <= R(0.0)) {
        s->integral = clamp(s->integral + g->i * error, g->limit);
    }
    if (s->started) {
        s->slope += g->share * ((rate - s->predicted) / step - s->slope);
    }
    s->started = true;
    s->predicted = rate;
    return g->p * error + s->integral - g->d * s->slope;
}

/* The torque command of each axis. */
static void rates(const [[ n ]]_Parameters *p, [[ n ]]_State *s, const Real setpoint[3], const Real measured[3])
{
{% for axis in f.axes %}
{% set i = loop.index0 %}
{% set a = axis.name %}
{% set left = a ~ "_left" if f.law else "s->unallocated[" ~ i ~ "]" %}
{% if f.law %}
    /* a rate law is told what was applied, from which comes what was not */
    const Real [[ a ]]_left = s->[[ a ]].command - (s->[[ a ]].command - s->unallocated[ [[- i ]]]);
{% endif %}
{% if axis.predictor.kind == "none" %}
    const Real [[ a ]] = measured[ [[- i ]]];
{% else %}
    const Real [[ a ]] = predict_[[ a ]](&p->[[ a ]]_predictor, &s->[[ a ]]_predictor, measured[ [[- i ]]],
        s->[[ a ]].command - [[ left ]]);
{% endif %}
    s->[[ a ]].command = pid({% if axis.scheduled %}&s->roll_gains{% else %}&p->[[ a ]]{% endif %}, &s->[[ a ]], {% if f.law %}p->rate_scale[ [[- i ]]] * {% endif %}setpoint[ [[- i ]]], [[ a ]],
        [[ left ]], p->step);
{% if axis.lead %}
    s->[[ a ]].command = lead({% if axis.scheduled %}&s->roll_lead_now{% else %}&p->[[ a ]]_lead{% endif %}, &s->[[ a ]]_lead, s->[[ a ]].command, s->unallocated[ [[- i ]]]);
{% endif %}
{% endfor %}
}

/* Height to climb rate to vertical acceleration to thrust, against gravity and lean. */
static Real altitude(const [[ n ]]_Parameters *p, [[ n ]]_State *s, const [[ n ]]_Input *in)
{
{% set own = "s" if f.schedule else "p" %}
    const Real off = in->altitude_setpoint - in->altitude;
    const Real climb = between([[ own ]]->position * off, p->down, p->up);
    const Real error = climb + in->velocity_down;
    if ((s->unallocated[3] * error) <= R(0.0)) {
        s->altitude_integral = clamp(s->altitude_integral + [[ own ]]->integral * error, p->integral_limit);
    }
    Real upright = R(1.0) - R(2.0) * (in->attitude[1] * in->attitude[1] + in->attitude[2] * in->attitude[2]);
    if (upright < LEAST_UPRIGHT) {
        upright = LEAST_UPRIGHT;
    }
    const Real acceleration = GRAVITY + [[ own ]]->velocity * error + s->altitude_integral;
    const Real thrust = (p->mass - in->fuel_burnt) * acceleration / upright;
{% if f.altitude.lead %}
    const Real throttle = share_of(p, thrust / R([[ N ]]_JETS));
    Real unallocated = s->unallocated[3];
    if (!s->altitude_started) {
        settle_lead(&s->altitude_lead, throttle);
        unallocated = R(0.0);
        s->altitude_started = true;
    }
    return lead({% if f.schedule %}&s->altitude_lead_now{% else %}&p->altitude_lead{% endif %}, &s->altitude_lead, throttle, unallocated);
{% else %}
    return share_of(p, thrust / R([[ N ]]_JETS));
{% endif %}
}

{% if f.allocation.kind == "tilt" %}
/* Roll by differential throttle, pitch and yaw by tilt. Roll is kept before collective, pitch before yaw. */
static void allocate(const [[ n ]]_Parameters *p, Real collective, const Real torque[3], [[ n ]]_Output *out)
{
    const Real half = R(0.5) * (p->throttle_max - p->throttle_min);
    const Real r = clamp(torque[0], half);
    const Real spread = (r >= R(0.0)) ? r : -r;
    const Real c = between(collective, p->throttle_min + spread, p->throttle_max - spread);
    const Real left = c + r;
    const Real right = c - r;
    Real share = (c + p->idle) / p->hover_thrust;
    if (share < LEAST_SHARE) {
        share = LEAST_SHARE;
    }
    const Real limit = p->tilt_range;
    Real left_pitch = R(0.0);
    Real left_yaw = R(0.0);
    Real pitch = p->pitch_sign * torque[1] / share;
    if ((pitch > limit) || (pitch < -limit)) {
        pitch = (pitch > R(0.0)) ? limit : -limit;
        left_pitch = torque[1] - p->pitch_sign * pitch * share;
    }
    const Real room = limit - ((pitch >= R(0.0)) ? pitch : -pitch);
    Real yaw = torque[2] / share;
    if ((yaw > room) || (yaw < -room)) {
        yaw = (yaw > R(0.0)) ? room : -room;
        left_yaw = torque[2] - yaw * share;
    }
{% for on_left in f.allocation.left %}
    out->throttle[ [[- loop.index0 ]]] = [[ "left" if on_left else "right" ]];
{% endfor %}
    out->tilt[0] = pitch + yaw;
    out->tilt[1] = pitch - yaw;
    out->unallocated[0] = torque[0] - r;
    out->unallocated[1] = left_pitch;
    out->unallocated[2] = left_yaw;
    out->unallocated[3] = collective - c;
}
{% elif f.allocation.kind == "rotor" %}
/* All by differential throttle. Roll and pitch are kept before yaw, yaw before collective. */
static void allocate(const [[ n ]]_Parameters *p, Real collective, const Real torque[3], [[ n ]]_Output *out)
{
    const Real low = p->throttle_min;
    const Real high = p->throttle_max;
    const Real room = R(0.5) * (high - low);
    const Real spread = magnitude(torque[0]) + magnitude(torque[1]);
    const Real scale = (spread > room) ? (room / spread) : R(1.0);
    const Real roll = torque[0] * scale;
    const Real pitch = torque[1] * scale;
    const Real left = room - ((room < spread) ? room : spread);
    const Real yaw = clamp(torque[2], left);
    const Real span = magnitude(roll) + magnitude(pitch) + magnitude(yaw);
    const Real c = between(collective, low + span, high - span);
    for (int i = 0; i < [[ N ]]_JETS; i++) {
        const Real *const sign = p->signs[i];
        out->throttle[i] = between(c + sign[0] * roll + sign[1] * pitch + sign[2] * yaw, low, high);
    }
    out->tilt[0] = R(0.0);
    out->tilt[1] = R(0.0);
    out->unallocated[0] = torque[0] - roll;
    out->unallocated[1] = torque[1] - pitch;
    out->unallocated[2] = torque[2] - yaw;
    out->unallocated[3] = collective - c;
}
{% elif hinged %}
/* A problem of the whole vehicle: a lift [N] and moments [N m], from the commands of the step before. */
static void begin_problem(const [[ n ]]_Parameters *p, const [[ n ]]_State *s, Real lift, const Real moment[3], Problem *q)
{
    q->wanted[ROLL_ROW] = moment[0];
    q->wanted[PITCH_ROW] = moment[1];
    q->wanted[LIFT_ROW] = lift;
    q->wanted[YAW_ROW] = moment[2];
    q->wanted[AHEAD_ROW] = R(0.0);
    q->wanted[RIGHT_ROW] = R(0.0);
    q->lift = lift;
    q->pressure = R(0.0);
    q->hurried = false;
    for (int i = 0; i < [[ N ]]_EFFECTORS; i++) {
        q->last[i] = s->last[i];
    }
    for (int i = 0; i < [[ N ]]_JETS; i++) {
        q->thrust_low[i] = p->end_low[i];
        q->thrust_high[i] = p->end_high[i];
        q->preferred[i] = p->preferred[i];
    }
    for (int i = 0; i < [[ N ]]_SERVOS; i++) {
        q->reach_low[i] = p->reach_low[i];
        q->reach_high[i] = p->reach_high[i];
        q->stand[i] = p->rest[i];
    }
    q->levels = p->levels;
    for (int i = 0; i < p->levels; i++) {
        q->level[i] = p->level[i];
    }
}

static void shares_of(const [[ n ]]_Parameters *p, const Real found[], Real share[ [[- N ]]_JETS])
{
    const Real idle_share = p->thrust_low / p->thrust_span;
    for (int i = 0; i < [[ N ]]_JETS; i++) {
        share[i] = between(found[i] / p->thrust_span - idle_share, p->share_low[i], p->share_high[i]);
    }
}

static void times_matrix(const Real m[3][3], const Real v[3], Real to[3])
{
    for (int i = 0; i < 3; i++) {
        to[i] = m[i][0] * v[0] + m[i][1] * v[1] + m[i][2] * v[2];
    }
}

/* Thrusts and hinges for a lift and angular accelerations. Roll and pitch are kept before lift, lift before yaw. */
static void allocate(const [[ n ]]_Parameters *p, [[ n ]]_State *s, Real collective, const Real torque[3], [[ n ]]_Output *out)
{
    const [[ n ]]_Effectors *const e = &p->effectors;
    const Real lift = R([[ N ]]_JETS) * (p->thrust_low + p->thrust_span * collective);
    Problem q;
    Tangent tangent;
    Real moment[3];
    Real missing[ [[- N ]]_ROWS];
    times_matrix(p->tensor, torque, moment);
    begin_problem(p, s, lift, moment, &q);
    q.passes = [[ f.allocation.passes ]];
    q.rated = true;
    tangent.known = false;
    solve_wrench(e, &tangent, &q, s->last, missing);
    for (int row = 0; row < [[ N ]]_ROWS; row++) {
        const Real scaled = missing[row] * e->norm[row];
        if ((scaled >= -e->given) && (scaled <= e->given)) {
            missing[row] = R(0.0);
        }
    }
    for (int i = 0; i < 3; i++) {
        out->unallocated[i] = R(0.0);
    }
    if ((missing[ROLL_ROW] != R(0.0)) || (missing[PITCH_ROW] != R(0.0)) || (missing[YAW_ROW] != R(0.0))) {
        const Real left[3] = {missing[ROLL_ROW], missing[PITCH_ROW], missing[YAW_ROW]};
        times_matrix(p->inverse, left, out->unallocated);
    }
    out->unallocated[3] = missing[LIFT_ROW] / (R([[ N ]]_JETS) * p->thrust_span);
    shares_of(p, s->last, out->throttle);
    for (int i = 0; i < [[ N ]]_SERVOS; i++) {
        out->tilt[i] = (i < e->movers) ? s->last[ [[- N ]]_JETS + i] : p->rest[i];
    }
}

/* The thrusts that give a collective in balance, hinges near rest; and no command was given yet. */
static void reset_allocation(const [[ n ]]_Parameters *p, [[ n ]]_State *s, Real collective, Real share[ [[- N ]]_JETS])
{
    const Real none[3] = {R(0.0), R(0.0), R(0.0)};
    Problem q;
    Tangent tangent;
    Real found[ [[- N ]]_EFFECTORS];
    Real missing[ [[- N ]]_ROWS];
    for (int i = 0; i < [[ N ]]_JETS; i++) {
        s->last[i] = p->preferred[i];
    }
    for (int i = 0; i < [[ N ]]_SERVOS; i++) {
        s->last[ [[- N ]]_JETS + i] = p->rest[i];
    }
    begin_problem(p, s, R([[ N ]]_JETS) * (p->thrust_low + p->thrust_span * collective), none, &q);
    q.passes = [[ f.allocation.first_passes ]];
    q.rated = false;
    tangent.known = false;
    solve_wrench(&p->effectors, &tangent, &q, found, missing);
    shares_of(p, found, share);
}
{% endif %}

static bool are_finite(const Real values[], int count)
{
    bool finite = true;
    for (int i = 0; i < count; i++) {
        finite = finite && (isfinite(values[i]) != 0);
    }
    return finite;
}

/* Whether all that a step computes with is finite; what it does not look at may be anything. */
static bool is_usable(const [[ n ]]_Input *in)
{
    bool usable = are_finite(in->rate, 3);
    if (in->rates_commanded) {
        usable = usable && are_finite(in->rate_setpoint, 3);
    } else {
        usable = usable && are_finite(in->attitude_setpoint, 3) && are_finite(in->attitude, 4);
    }
    if (in->collective_commanded) {
        usable = usable && are_finite(&in->collective_setpoint, 1);
    } else {
        const Real height[4] = {in->altitude_setpoint, in->altitude, in->velocity_down, in->fuel_burnt};
        usable = usable && are_finite(height, 4) && are_finite(in->attitude, 4);
    }
    return usable[[ " && are_finite(in->unallocated, 4)" if f.loops ]];
}

static void reset_loops([[ n ]]_State *s)
{
    s->altitude_integral = R(0.0);
{% if f.altitude.lead %}
    s->altitude_started = false;
{% endif %}
{% for axis in f.axes %}
    reset_rate(&s->[[ axis.name ]]);
{% if axis.predictor.kind != "none" %}
    reset_[[ axis.name ]]_predictor(&s->[[ axis.name ]]_predictor);
{% endif %}
{% if axis.lead %}
    settle_lead(&s->[[ axis.name ]]_lead, R(0.0));
{% endif %}
{% endfor %}
{% if f.delay %}
    clear(s->added_delay, [[ f.delay ]]);
    s->added_at = 0;
{% endif %}
}

/* Every engine at its least throttle, [[ "no torque" if f.loops else "hinges at rest" if hinged else "the banks upright" ]], and loops that remember nothing when needed again. */
static void idle({% if not f.loops %}const [[ n ]]_Parameters *p, {% endif %}[[ n ]]_State *s, [[ n ]]_Output *out)
{
    reset_loops(s);
{% if f.loops %}
    for (int i = 0; i < 3; i++) {
        out->torque[i] = R(0.0);
    }
    out->collective = R(0.0);
}
{% else %}
    for (int i = 0; i < [[ N ]]_JETS; i++) {
        out->throttle[i] = p->throttle_min;
    }
    for (int i = 0; i < 3; i++) {
        out->torque[i] = R(0.0);
        out->unallocated[i] = R(0.0);
    }
{% if hinged %}
    for (int i = 0; i < [[ N ]]_SERVOS; i++) {
        out->tilt[i] = p->rest[i];
    }
{% else %}
    out->tilt[0] = R(0.0);
    out->tilt[1] = R(0.0);
{% endif %}
    out->unallocated[3] = -p->throttle_min;
    out->collective = R(0.0);
    out->allocated = p->throttle_min;
}
{% endif %}

static void fly(const [[ n ]]_Parameters *p, [[ n ]]_State *s, const [[ n ]]_Input *in, [[ n ]]_Output *out)
{
    rates(p, s, out->rate_setpoint, in->rate);
    out->torque[0] = s->roll.command;
    out->torque[1] = s->pitch.command;
    out->torque[2] = s->yaw.command;
    if (in->collective_commanded) {
{% if f.altitude.lead %}
        s->altitude_started = false;
{% endif %}
        out->collective = in->collective_setpoint;
    } else {
        out->collective = altitude(p, s, in);
    }
{% set with = "p, s" if hinged else "p" %}
{% if f.loops %}
{% elif f.delay %}
    const Real roll = delay_line(s->added_delay, &s->added_at, [[ f.delay ]], out->torque[0]);
    const Real torque[3] = {roll, out->torque[1], out->torque[2]};
    allocate([[ with ]], out->collective, torque, out);
{% else %}
    allocate([[ with ]], out->collective, out->torque, out);
{% endif %}
{% if not f.loops %}
    out->allocated = out->collective - out->unallocated[3];
{% endif %}
}

{% if f.loops %}
void [[ n ]]_reset(const [[ n ]]_Parameters *parameters, [[ n ]]_State *state, Real fuel_burnt)
{% else %}
void [[ n ]]_reset(const [[ n ]]_Parameters *parameters, [[ n ]]_State *state, bool on_ground, Real fuel_burnt,
    Real throttle[ [[- N ]]_JETS])
{% endif %}
{
    clear(state->euler, 3);
    clear(state->setpoint, 4);
    state->setpoint[0] = R(1.0);
    clear(state->unallocated, 4);
    reset_loops(state);
    const [[ n ]]_Output nothing = {0};
    state->held = nothing;
{% if f.loops %}
    state->collective = R(0.0);
    state->begun = false;
{% endif %}
{% if f.loops and not f.schedule %}
    (void)parameters;
    (void)fuel_burnt;
}
{% else %}
    Real hover = parameters->hover;
    if (fuel_burnt != R(0.0)) {
        hover = share_of(parameters, (parameters->mass - fuel_burnt) * GRAVITY / R([[ N ]]_JETS));
    }
{% if f.schedule %}
    state->level = between(hover, parameters->level_share[0], parameters->level_share[ [[- f.schedule.share|length - 1 ]]]);
    state->told = state->level;
    follow(parameters, state, state->level);
{% endif %}
{% if not f.loops %}
{% if hinged %}
    reset_allocation(parameters, state, hover, throttle);
    for (int i = 0; (i < [[ N ]]_JETS) && on_ground; i++) {
        throttle[i] = parameters->throttle_min;
    }
{% else %}
    for (int i = 0; i < [[ N ]]_JETS; i++) {
        throttle[i] = on_ground ? parameters->throttle_min : hover;
    }
{% endif %}
{% if not f.thrust.identity %}
    throttles_of(parameters, throttle);
{% endif %}
    for (int i = 0; i < [[ N ]]_JETS; i++) {
        state->held.throttle[i] = throttle[i];
    }
{% if hinged %}
    for (int i = 0; i < [[ N ]]_SERVOS; i++) {
        state->held.tilt[i] = parameters->rest[i];
    }
{% endif %}
{% endif %}
}
{% endif %}

void [[ n ]]_step(const [[ n ]]_Parameters *parameters, [[ n ]]_State *state, const [[ n ]]_Input *input,
    [[ n ]]_Output *output)
{
    const bool usable = is_usable(input);
    if (!usable && (input->engines == [[ N ]]_FLY)) {
        *output = state->held;
        output->held = true;
        return;
    }
    output->held = !usable;
{% if f.loops %}
    for (int i = 0; i < 4; i++) {
        state->unallocated[i] = usable ? input->unallocated[i] : R(0.0);
    }
{% if f.schedule %}
    if (state->begun) {
        schedule(parameters, state, state->collective - state->unallocated[3]);
    }
{% endif %}
    state->begun = true;
{% endif %}
    if (!usable) {
        clear(output->rate_setpoint, 3);
    } else if (input->rates_commanded) {
        for (int i = 0; i < 3; i++) {
            output->rate_setpoint[i] = input->rate_setpoint[i];
        }
    } else {
        attitude(parameters, state, input, output->rate_setpoint);
    }
    if (input->engines != [[ N ]]_FLY) {
        idle({% if not f.loops %}parameters, {% endif %}state, output);
    } else {
        fly(parameters, state, input, output);
    }
    output->rate_predicted[0] = state->roll.predicted;
    output->rate_predicted[1] = state->pitch.predicted;
    output->rate_predicted[2] = state->yaw.predicted;
{% if f.loops %}
    state->collective = output->collective;
    state->held = *output;
}
{%- else %}
    for (int i = 0; i < 4; i++) {
        state->unallocated[i] = output->unallocated[i];
    }
{% if f.schedule %}
    schedule(parameters, state, output->allocated);
{% endif %}
    for (int i = 0; i < [[ N ]]_JETS; i++) {
        output->off[i] = input->engines == [[ N ]]_OFF;
    }
{% if not f.thrust.identity %}
    throttles_of(parameters, output->throttle);
{% endif %}
    state->held = *output;
}
{%- endif %}

