/* Thrusts, hinges and surfaces for a wrench that is asked for: the equations of cosim.control.allocation.effectiveness.
 *
 * C99 without Python, heap or state, so that the simulation (_effectiveness.c) and an exported controller compute by
 * the same lines.  Who includes this defines before it
 *
 *     Real, R(x), SIN, COS, SQRT     double or float, a literal of it, and its functions;
 *     MOST_JETS, MOST_MOVERS, MOST_LINKS     jets, hinges with surfaces, and hinges of one jet, at most, each 1 or more;
 *     RANK     the square of what a row has of its own, over the row's, below which it has nothing;
 *     DONE     what is missing of a scaled row less than this is not missing;
 *     LET_GO   of a row: an effector that would move it by less stays at its limit;
 *     SETTLED  of a hinge's range: it goes nowhere any more.
 *
 * Compile with -ffp-contract=off and without -ffast-math: then every processor gives the same bits.
 *
 * --- What is solved ---
 *
 * Thrusts [N] and angles u give the wrench f(u), of rows roll, pitch, lift, yaw, ahead, right [N m, N], by the layout of
 * cosim.base.layout, exactly.  f(u) = wanted is solved by Newton's method from the commands of the step before.  With
 * x = u / scale, rows scaled by `norm`, and A the scaled change of f at u, each pass brings A x to
 * (wanted - f(u)) norm + A u / scale within limits low <= x <= high, the more important rows first.
 *
 * --- By priority ---
 *
 * Rows stand in levels of one row or two.  Each level is brought as near to what is wanted of it as the effectors can
 * while what the levels before it were given stays as it is.  A level of two rows keeps the direction of what is missing
 * as far as it goes; then each row goes on alone or, where it is asked for, both go as far along that direction as they
 * can, whatever comes across it.
 *
 * The method is the redistributed pseudo-inverse with priorities (Bodson, "Evaluation of Optimization Methods for
 * Control Allocation", J. Guidance, Control, and Dynamics 25, 2002), made exact by an active set (Harkegard, "Efficient
 * Active Set Algorithms for Solving Constrained Least Squares Problems in Aircraft Control Allocation", 41st IEEE CDC,
 * 2002): for each row the effectors move along that row's part that is square to all rows that are held, an effector
 * that meets its limit is left there, and where nothing moves any more one whose multiplier has the wrong sign is let go
 * again.  That is a linear program along a line, solved by the steepest feasible direction; it ends, after a bounded
 * number of moves, where no effector can do more.  While no limit is met the answer is the least one beside the start,
 * x0 + A^+ (wanted - A x0).
 */
#ifndef EFFECTIVENESS_H
#define EFFECTIVENESS_H

#include <math.h>
#include <stdbool.h>

#define ROWS 6 /* roll, pitch, lift, yaw, ahead, right */
#define MOST_EFFECTORS (MOST_JETS + MOST_MOVERS)

typedef struct {
    Real x, y, z; /* body: forward, right, down */
} Vector;

/* A hinge of a jet's chain, and what it does to the jet. */
typedef struct {
    int hinge;
    Real effect; /* angle of the thrust over that of the hinge */
    bool carries; /* station and thrust; otherwise it turns the thrust alone */
} Link;

/* A jet with all hinges at zero, and its hinges from the body outwards. */
typedef struct {
    Vector place, axis;
    Real twist; /* moment about the axis per thrust, m */
    int links;
    Link chain[MOST_LINKS];
} JetStation;

/* A hinge or a surface. */
typedef struct {
    Vector point, axis; /* of a hinge */
    Real wrench[ROWS];  /* of a surface: what it gives of each row per unit and Pa of dynamic pressure */
    Real least, most;
    Real step; /* by how much its command may change in a step */
    Real lead; /* by how much more where it is in a hurry */
} ServoMover;

/* Rows that are of equal importance. */
typedef struct {
    int rows; /* 1 or 2 */
    int row[2];
} RowLevel;

/* What is known of a vehicle. Effectors are its jets, its hinges, then its surfaces. */
typedef struct {
    int jets, hinges, movers; /* movers: hinges and surfaces */
    JetStation jet[MOST_JETS];
    ServoMover mover[MOST_MOVERS];
    Real scale[MOST_EFFECTORS]; /* of an effector's unit in which all are alike */
    Real norm[ROWS];
    Real weight; /* N */
    Real given;  /* of a scaled row: what is missing less is rounding */
} Effectors;

/* --- functions, and what they alone know --- */

enum { ROLL_ROW, PITCH_ROW, LIFT_ROW, YAW_ROW, AHEAD_ROW, RIGHT_ROW };
enum { MOST_HELD = ROWS + 1 };

/* One problem. */
typedef struct {
    Real wanted[ROWS];
    Real lift;     /* N, which decides where thrusts are left */
    Real pressure; /* Pa, dynamic */
    int passes;    /* of Newton's method at most */
    bool rated;    /* commands no faster than servos go; otherwise from far away */
    bool hurried;  /* so far ahead of the servos that they go at their full rate; roll and pitch together */
    Real last[MOST_EFFECTORS];
    Real thrust_low[MOST_JETS], thrust_high[MOST_JETS], preferred[MOST_JETS];       /* N */
    Real reach_low[MOST_MOVERS], reach_high[MOST_MOVERS], stand[MOST_MOVERS]; /* rad */
    int levels;
    RowLevel level[ROWS];
} Problem;

/* A linear problem: rows of the scaled effectors within their limits; and which are free to move. */
typedef struct {
    int count;
    Real row[ROWS][MOST_EFFECTORS];
    Real low[MOST_EFFECTORS], high[MOST_EFFECTORS], x[MOST_EFFECTORS];
    bool movable[MOST_EFFECTORS];
} Bounded;

/* The wrench and its change at one place, but for surfaces: where a problem ended the next one begins. */
typedef struct {
    bool known;
    Real at[MOST_EFFECTORS];
    Real total[ROWS];
    Real row[ROWS][MOST_EFFECTORS];
} Tangent;

/* --- bounded effectors by priority --- */

static Real row_dot(const Real a[], const Real b[], int count)
{
    Real total = R(0.0);
    for (int i = 0; i < count; i++) {
        total += a[i] * b[i];
    }
    return total;
}

/* The sum of the squares of a row over the free effectors. */
static Real free_square(const Real row[], const bool movable[], int count)
{
    Real total = R(0.0);
    for (int i = 0; i < count; i++) {
        if (movable[i]) {
            total += row[i] * row[i];
        }
    }
    return total;
}

/* Take from a row its part along each of an orthonormal basis; twice, which is enough for rounding. */
static void remove_parts(Real part[], Real basis[][MOST_EFFECTORS], int units, const bool movable[], int count)
{
    for (int turn = 0; turn < 2; turn++) {
        for (int unit = 0; unit < units; unit++) {
            Real along = R(0.0);
            for (int i = 0; i < count; i++) {
                if (movable[i]) {
                    along += basis[unit][i] * part[i];
                }
            }
            for (int i = 0; i < count; i++) {
                part[i] -= along * basis[unit][i];
            }
        }
    }
}

/* A row less its part in the rows that are held, as the free effectors see them. Of effectors that are not free it is
 * what the row would gain by them with the held rows held: their multipliers. */
static void square_to(const Bounded *b, const Real row[], const Real *const held[], int rows, Real along[])
{
    const int count = b->count;
    Real basis[MOST_HELD][MOST_EFFECTORS];
    int units = 0;
    for (int r = 0; r < rows; r++) {
        Real *const part = basis[units];
        for (int i = 0; i < count; i++) {
            part[i] = held[r][i];
        }
        remove_parts(part, basis, units, b->movable, count);
        const Real square = free_square(part, b->movable, count);
        if (square > (RANK * free_square(held[r], b->movable, count))) {
            const Real scale = R(1.0) / SQRT(square);
            for (int i = 0; i < count; i++) {
                part[i] *= scale;
            }
            units++;
        }
    }
    for (int i = 0; i < count; i++) {
        along[i] = row[i];
    }
    remove_parts(along, basis, units, b->movable, count);
}

/* Free the effector at a limit that `along` moves most from it, more than `least`; whether there is one. */
static bool release(Bounded *b, const Real along[], Real least)
{
    Real best = least;
    int freed = -1;
    for (int i = 0; i < b->count; i++) {
        if (!b->movable[i] && (b->low[i] < b->high[i])) {
            Real inward = R(0.0);
            if (b->x[i] <= b->low[i]) {
                inward = along[i];
            } else if (b->x[i] >= b->high[i]) {
                inward = -along[i];
            } else {
                /* it stands between its limits */
            }
            if (inward > best) {
                best = inward;
                freed = i;
            }
        }
    }
    if (freed >= 0) {
        b->movable[freed] = true;
    }
    return freed >= 0;
}

/* How far x goes along a direction: no further than to the first limit, whose effector is `met`, else -1. Effectors that
 * are at such a limit already are fixed there, and the answer is false. */
static bool goes_as_far(Bounded *b, const Real along[], Real *far, int *met)
{
    bool shut = false;
    *met = -1;
    for (int i = 0; i < b->count; i++) {
        const Real speed = along[i];
        if (b->movable[i] && (speed != R(0.0))) {
            const Real room = (((speed > R(0.0)) ? b->high[i] : b->low[i]) - b->x[i]) / speed;
            if (room <= R(0.0)) {
                b->movable[i] = false;
                shut = true;
            } else if (room < *far) {
                *far = room;
                *met = i;
            } else {
                /* another one comes first */
            }
        }
    }
    return !shut;
}

static Real limited(Real value, Real low, Real high)
{
    return (value < low) ? low : ((value > high) ? high : value);
}

/* Raise row . x by `amount` or as far as it goes, with `held` rows as they are; by how much it was. */
static Real raise_row(Bounded *b, const Real row[], Real amount, const Real *const held[], int rows)
{
    const int count = b->count;
    const Real whole = row_dot(row, row, count);
    Real raised = R(0.0);
    if (whole == R(0.0)) {
        return raised;
    }
    for (int i = 0; i < count; i++) {
        b->movable[i] = b->low[i] < b->high[i];
    }
    for (int move = 0; move < ((4 * count) + 4); move++) {
        Real along[MOST_EFFECTORS];
        square_to(b, row, held, rows, along);
        const Real size = free_square(along, b->movable, count);
        if (size <= (RANK * whole)) {
            /* nothing that is free moves it: what stands at a limit, and would, comes free again */
            if (!release(b, along, LET_GO * SQRT(whole))) {
                return raised;
            }
            continue;
        }
        Real far = (amount - raised) / size;
        int met;
        if (!goes_as_far(b, along, &far, &met)) {
            continue;
        }
        for (int i = 0; i < count; i++) {
            if (b->movable[i]) {
                b->x[i] = limited(b->x[i] + far * along[i], b->low[i], b->high[i]);
            }
        }
        raised += far * size;
        if (met < 0) {
            return raised;
        }
        b->x[met] = (along[met] > R(0.0)) ? b->high[met] : b->low[met];
        b->movable[met] = false;
    }
    return raised;
}

/* Bring one row as near to what is wanted of it as it goes while `held` keep their values. */
static void raise_alone(Bounded *b, const Real row[], Real wanted, const Real *const held[], int rows)
{
    const Real missing = wanted - row_dot(row, b->x, b->count);
    if (missing > DONE) {
        (void)raise_row(b, row, missing, held, rows);
    } else if (missing < -DONE) {
        Real opposite[MOST_EFFECTORS];
        for (int i = 0; i < b->count; i++) {
            opposite[i] = -row[i];
        }
        (void)raise_row(b, opposite, -missing, held, rows);
    } else {
        /* nothing is missing */
    }
}

/* Two rows of one level: along what is missing of both, then each alone or what is left of both. */
static void raise_pair(Bounded *b, const RowLevel *level, const Real wanted[], const Real *held[], int rows, bool along_first)
{
    const int count = b->count;
    const Real *const first = b->row[level->row[0]];
    const Real *const second = b->row[level->row[1]];
    const Real wanted_first = wanted[level->row[0]];
    const Real wanted_second = wanted[level->row[1]];
    Real p = wanted_first - row_dot(first, b->x, count);
    Real q = wanted_second - row_dot(second, b->x, count);
    const Real size = SQRT(p * p + q * q);
    if (!(size > DONE)) {
        return;
    }
    Real along[MOST_EFFECTORS];
    Real across[MOST_EFFECTORS];
    p = p / size;
    q = q / size;
    for (int i = 0; i < count; i++) {
        along[i] = p * first[i] + q * second[i];
        across[i] = p * second[i] - q * first[i];
    }
    held[rows] = across;
    const Real left = size - raise_row(b, along, size, held, rows + 1);
    if (left > DONE) {
        if (along_first) {
            (void)raise_row(b, along, left, held, rows);
            held[rows] = along;
            raise_alone(b, across, p * wanted_second - q * wanted_first, held, rows + 1);
        } else {
            held[rows] = second;
            raise_alone(b, first, wanted_first, held, rows + 1);
            held[rows] = first;
            raise_alone(b, second, wanted_second, held, rows + 1);
        }
    }
}

/* From x = start: the wanted rows by priority within the limits. A row that is in no level is ignored. */
static void prioritise(Bounded *b, const Real start[], const Real wanted[], const RowLevel levels[], int count, bool along_first)
{
    const Real *held[MOST_HELD];
    int rows = 0;
    for (int i = 0; i < b->count; i++) {
        b->x[i] = limited(start[i], b->low[i], b->high[i]);
    }
    for (int number = 0; number < count; number++) {
        const RowLevel *const level = &levels[number];
        if (level->rows == 1) {
            raise_alone(b, b->row[level->row[0]], wanted[level->row[0]], held, rows);
        } else {
            raise_pair(b, level, wanted, held, rows, along_first);
        }
        for (int i = 0; i < level->rows; i++) {
            held[rows] = b->row[level->row[i]];
            rows++;
        }
    }
}

/* --- the wrench and its change --- */

static Vector cross_of(Vector a, Vector b)
{
    const Vector made = {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
    return made;
}

static Vector sum_of(Vector a, Vector b)
{
    const Vector made = {a.x + b.x, a.y + b.y, a.z + b.z};
    return made;
}

static Vector difference_of(Vector a, Vector b)
{
    const Vector made = {a.x - b.x, a.y - b.y, a.z - b.z};
    return made;
}

static Vector times(Real factor, Vector a)
{
    const Vector made = {factor * a.x, factor * a.y, factor * a.z};
    return made;
}

typedef struct {
    Real cosine, sine;
} Turned;

/* A vector turned about a unit axis, right-handed: Rodrigues' formula. */
static Vector rotated(Vector axis, Turned angle, Vector v)
{
    const Real c = angle.cosine;
    const Real s = angle.sine;
    const Real along = (axis.x * v.x + axis.y * v.y + axis.z * v.z) * (R(1.0) - c);
    const Vector made = {
        v.x * c + (axis.y * v.z - axis.z * v.y) * s + axis.x * along,
        v.y * c + (axis.z * v.x - axis.x * v.z) * s + axis.y * along,
        v.z * c + (axis.x * v.y - axis.y * v.x) * s + axis.z * along,
    };
    return made;
}

static Vector carried(const ServoMover *hinge, Turned angle, Vector point)
{
    return sum_of(hinge->point, rotated(hinge->axis, angle, difference_of(point, hinge->point)));
}

/* The rows of a force along `axis` at a place, with a moment about it. */
static void rows_of(Vector moment, Vector force, Real row[ROWS])
{
    row[ROLL_ROW] = moment.x;
    row[PITCH_ROW] = moment.y;
    row[LIFT_ROW] = -force.z;
    row[YAW_ROW] = moment.z;
    row[AHEAD_ROW] = force.x;
    row[RIGHT_ROW] = force.y;
}

/* What one more rad of a hinge does per thrust of a jet whose thrust is `axis` at `place`. */
static void hinge_rows(const Effectors *e, const JetStation *jet, const Turned turned[], int number, Vector axis,
    Vector place, Real row[ROWS])
{
    const Link *const link = &jet->chain[number];
    Vector about = e->mover[link->hinge].axis; /* as all hinges outside of it turn the thrust */
    Vector shaft = about;                      /* as those turn it that carry the station too */
    Vector point = e->mover[link->hinge].point;
    for (int outer = number - 1; outer >= 0; outer--) {
        const ServoMover *const hinge = &e->mover[jet->chain[outer].hinge];
        about = rotated(hinge->axis, turned[outer], about);
        if (jet->chain[outer].carries) {
            shaft = rotated(hinge->axis, turned[outer], shaft);
            point = carried(hinge, turned[outer], point);
        }
    }
    /* the thrust turns with the hinge, and the station where it is carried */
    const Vector force = times(link->effect, cross_of(about, axis));
    Vector moment = sum_of(cross_of(place, force), times(jet->twist, force));
    if (link->carries) {
        moment = sum_of(moment, cross_of(cross_of(shaft, difference_of(place, point)), axis));
    }
    rows_of(moment, force, row);
}

/* Cosine and sine of each hinge's own angle. */
static void turn_hinges(const Effectors *e, const Real angles[], Turned whole[])
{
    for (int hinge = 0; hinge < e->hinges; hinge++) {
        whole[hinge].cosine = COS(angles[hinge]);
        whole[hinge].sine = SIN(angles[hinge]);
    }
}

/* Thrust and station of a jet with the hinges at `angles`, and by what each of its own turns the thrust. */
static void turn_jet(const Effectors *e, const JetStation *jet, const Real angles[], const Turned whole[],
    Turned turned[], Vector *axis, Vector *place)
{
    *axis = jet->axis;
    *place = jet->place;
    for (int l = jet->links - 1; l >= 0; l--) {
        const Link *const link = &jet->chain[l];
        if (link->effect == R(1.0)) {
            turned[l] = whole[link->hinge];
        } else {
            const Real angle = link->effect * angles[link->hinge];
            turned[l].cosine = COS(angle);
            turned[l].sine = SIN(angle);
        }
        *axis = rotated(e->mover[link->hinge].axis, turned[l], *axis);
        if (link->carries) {
            *place = carried(&e->mover[link->hinge], turned[l], *place);
        }
    }
}

/* The wrench of the jets at `at`, in the order of the rows, and its scaled change by each effector. */
static void linearise_jets(const Effectors *e, const Real at[], Real total[ROWS], Real rows[][MOST_EFFECTORS])
{
    const int jets = e->jets;
    Turned whole[MOST_MOVERS]; /* by the hinge's own angle */
    for (int row = 0; row < ROWS; row++) {
        total[row] = R(0.0);
        for (int j = 0; j < (jets + e->movers); j++) {
            rows[row][j] = R(0.0);
        }
    }
    turn_hinges(e, &at[jets], whole);
    for (int number = 0; number < jets; number++) {
        const JetStation *const jet = &e->jet[number];
        Turned turned[MOST_LINKS];
        Vector axis;
        Vector place;
        Real each[ROWS];
        turn_jet(e, jet, &at[jets], whole, turned, &axis, &place);
        rows_of(sum_of(cross_of(place, axis), times(jet->twist, axis)), axis, each);
        for (int row = 0; row < ROWS; row++) {
            total[row] += at[number] * each[row];
            rows[row][number] = each[row] * e->scale[number] * e->norm[row];
        }
        for (int l = 0; l < jet->links; l++) {
            const int j = jets + jet->chain[l].hinge;
            const Real size = at[number] * e->scale[j];
            hinge_rows(e, jet, turned, l, axis, place, each);
            for (int row = 0; row < ROWS; row++) {
                rows[row][j] += each[row] * size * e->norm[row];
            }
        }
    }
}

/* What surfaces add to it. */
static void add_surfaces(const Effectors *e, Real pressure, const Real at[], Real total[ROWS], Real rows[][MOST_EFFECTORS])
{
    for (int number = e->hinges; number < e->movers; number++) {
        const Real *const surface = e->mover[number].wrench;
        const int j = e->jets + number;
        const Real size = pressure * e->scale[j];
        const Real deflected = pressure * at[j];
        for (int row = 0; row < ROWS; row++) {
            total[row] += deflected * surface[row];
            rows[row][j] = surface[row] * size * e->norm[row];
        }
    }
}

/* Both; what the jets do is computed once at one place. */
static void linearise(const Effectors *e, Tangent *t, Real pressure, const Real at[], Real total[ROWS],
    Real rows[][MOST_EFFECTORS])
{
    const int count = e->jets + e->movers;
    bool same = t->known;
    for (int j = 0; j < count; j++) {
        same = same && (t->at[j] == at[j]) && (!signbit(t->at[j]) == !signbit(at[j]));
    }
    if (!same) {
        linearise_jets(e, at, t->total, t->row);
        t->known = true;
        for (int j = 0; j < count; j++) {
            t->at[j] = at[j];
        }
    }
    for (int row = 0; row < ROWS; row++) {
        total[row] = t->total[row];
        for (int j = 0; j < count; j++) {
            rows[row][j] = t->row[row][j];
        }
    }
    add_surfaces(e, pressure, at, total, rows);
}

/* --- Newton's method --- */

/* The scaled limits of each effector, and where it is left if there is a choice. */
static void scale_limits(const Effectors *e, const Problem *p, Bounded *b, Real start[])
{
    const Real up = p->lift / e->weight;
    for (int jet = 0; jet < e->jets; jet++) {
        b->low[jet] = p->thrust_low[jet] / e->scale[jet];
        b->high[jet] = p->thrust_high[jet] / e->scale[jet];
        start[jet] = up * p->preferred[jet] / e->scale[jet];
    }
    for (int number = 0; number < e->movers; number++) {
        const int j = e->jets + number;
        Real least = p->reach_low[number];
        Real most = p->reach_high[number];
        if (p->rated) { /* from outside it comes as fast as it can */
            const ServoMover *const mover = &e->mover[number];
            const Real step = p->hurried ? (mover->step + mover->lead) : mover->step;
            const Real slowest = p->last[j] - step;
            const Real fastest = p->last[j] + step;
            least = (slowest > least) ? slowest : ((fastest < least) ? fastest : least);
            most = (fastest < most) ? fastest : ((slowest > most) ? slowest : most);
        }
        b->low[j] = least / e->scale[j];
        b->high[j] = most / e->scale[j];
        start[j] = p->stand[number] / e->scale[j];
    }
}

/* From far away no hinge goes further at once than a line stands for. */
static void stay_near(const Effectors *e, const Problem *p, Bounded *b, const Real here[])
{
    const Real part = R(0.1); /* of a hinge's range, in a pass */
    for (int number = 0; number < e->movers; number++) {
        const int j = e->jets + number;
        const Real far = part * (e->mover[number].most - e->mover[number].least);
        const Real back = here[j] - far;
        const Real on = here[j] + far;
        const Real low = (back > p->reach_low[number]) ? back : p->reach_low[number];
        const Real high = (on < p->reach_high[number]) ? on : p->reach_high[number];
        b->low[j] = ((p->reach_high[number] < low) ? p->reach_high[number] : low) / e->scale[j];
        b->high[j] = ((p->reach_low[number] > high) ? p->reach_low[number] : high) / e->scale[j];
    }
}

static Real larger(Real most, Real value)
{
    return (value > most) ? value : ((-value > most) ? -value : most);
}

/* By how much the wrench, scaled, is off what the linear problem said of it. */
static Real linear_error(const Effectors *e, const Bounded *b, const Real stood[], const Real before[], const Real now[])
{
    Real off = R(0.0);
    for (int row = 0; row < ROWS; row++) {
        Real change = R(0.0);
        for (int j = 0; j < b->count; j++) {
            change += b->row[row][j] * (b->x[j] - stood[j]);
        }
        off = larger(off, (now[row] - before[row]) * e->norm[row] - change);
    }
    return off;
}

/* How far the hinges and surfaces went, of their ranges. */
static Real way_of(const Effectors *e, const Real here[], const Real moved[])
{
    Real far = R(0.0);
    for (int number = 0; number < e->movers; number++) {
        const int j = e->jets + number;
        far = larger(far, (moved[j] - here[j]) / (e->mover[number].most - e->mover[number].least));
    }
    return far;
}

/* Thrusts [N] and angles for a wrench, and what is missing of it [N m, N]. */
static void solve_wrench(const Effectors *e, Tangent *t, const Problem *p, Real found[], Real missing[ROWS])
{
    Bounded b;
    Real start[MOST_EFFECTORS];
    Real here[MOST_EFFECTORS] = {R(0.0)};
    Real given[ROWS];
    b.count = e->jets + e->movers;
    scale_limits(e, p, &b, start);
    for (int j = 0; j < b.count; j++) {
        here[j] = p->last[j];
    }
    linearise(e, t, p->pressure, here, given, b.row);
    for (int pass = 0; pass < p->passes; pass++) {
        Real targets[ROWS];
        Real stood[MOST_EFFECTORS]; /* here, scaled */
        Real moved[MOST_EFFECTORS];
        Real now[ROWS];
        Real change[ROWS][MOST_EFFECTORS];
        if (!p->rated) {
            stay_near(e, p, &b, here);
        }
        for (int j = 0; j < b.count; j++) {
            stood[j] = here[j] / e->scale[j];
        }
        for (int row = 0; row < ROWS; row++) {
            Real steps = R(0.0);
            for (int j = 0; j < b.count; j++) {
                steps += b.row[row][j] * stood[j];
            }
            targets[row] = (p->wanted[row] - given[row]) * e->norm[row] + steps;
        }
        prioritise(&b, start, targets, p->level, p->levels, p->hurried);
        for (int j = 0; j < b.count; j++) {
            moved[j] = b.x[j] * e->scale[j];
        }
        linearise(e, t, p->pressure, moved, now, change);
        const Real off = linear_error(e, &b, stood, given, now);
        const Real far = way_of(e, here, moved);
        for (int j = 0; j < b.count; j++) {
            here[j] = moved[j];
        }
        for (int row = 0; row < ROWS; row++) {
            given[row] = now[row];
            for (int j = 0; j < b.count; j++) {
                b.row[row][j] = change[row][j];
            }
        }
        if ((off <= (R(0.1) * e->given)) && (p->rated || (far <= SETTLED))) {
            break;
        }
    }
    for (int j = 0; j < b.count; j++) {
        found[j] = here[j];
    }
    for (int row = 0; row < ROWS; row++) {
        missing[row] = p->wanted[row] - given[row];
    }
}

#endif
