[[ licence ]]
/* Flies [[ n ]] with the inputs of a recorded flight and compares what it answers.
 *
 *   cc -std=c99 -O2 -ffp-contract=off -o test_[[ n ]] test_[[ n ]].c [[ n ]].c [[ n ]]_parameters.c [[ n ]]_vectors.c -lm
 *
 * In double every number must have the bits of the flight. With -D[[ N ]]_FLOAT throttles and tilts may differ by less
 * than half a step of a 12-bit command. With an argument the time of each step is measured too.
 */
#include "[[ n ]].h"
#include "[[ n ]]_vectors.h"

#include <stdio.h>
#include <string.h>
#if !(defined(__GNUC__) && (defined(__x86_64__) || defined(__i386__)))
#include <time.h>
#endif

#define INPUTS [[ inputs ]]
#define REPEATS 20
{% if f.loops %}
#define RESET(state) [[ n ]]_reset(&[[ n ]]_parameters, &(state), ([[ n ]]_Real)[[ N ]]_FUEL_BURNT_AT_START)
{% else %}
#define SERVOS [[ f.servos|length ]]
#define RESET(state) \
    [[ n ]]_reset(&[[ n ]]_parameters, &(state), [[ N ]]_STARTS_ON_GROUND, ([[ n ]]_Real)[[ N ]]_FUEL_BURNT_AT_START, throttle)
{% endif %}
#ifdef [[ N ]]_FLOAT
#define FLOAT_LIMIT (0.5 / 4096.0)
#endif

static double worst[ [[- columns|length - inputs ]]]; /* deviation of each output */

static void read_input(const double row[], [[ n ]]_Input *in)
{
    for (int i = 0; i < 3; i++) {
        in->attitude_setpoint[i] = ([[ n ]]_Real)row[i];
        in->rate_setpoint[i] = ([[ n ]]_Real)row[4 + i];
        in->rate[i] = ([[ n ]]_Real)row[11 + i];
    }
    for (int i = 0; i < 4; i++) {
        in->attitude[i] = ([[ n ]]_Real)row[14 + i];
    }
    in->altitude_setpoint = ([[ n ]]_Real)row[3];
    in->collective_setpoint = ([[ n ]]_Real)row[7];
    in->rates_commanded = row[8] > 0.5;
    in->collective_commanded = row[9] > 0.5;
    in->engines = (row[10] > 1.5) ? [[ N ]]_OFF : ((row[10] > 0.5) ? [[ N ]]_IDLE : [[ N ]]_FLY);
    in->velocity_down = ([[ n ]]_Real)row[18];
    in->altitude = ([[ n ]]_Real)row[19];
    in->fuel_burnt = ([[ n ]]_Real)row[20];
{% if f.loops %}
    for (int i = 0; i < 4; i++) {
        in->unallocated[i] = ([[ n ]]_Real)row[21 + i];
    }
{% endif %}
}

{% if f.loops %}
/* In the order of the columns behind the inputs; torques and the collective first. */
{% else %}
/* In the order of the columns behind the inputs; throttles and tilts first. */
{% endif %}
static int write_output(const [[ n ]]_Output *out, double row[])
{
    int k = 0;
{% if f.loops %}
    for (int i = 0; i < 3; i++) {
        row[k++] = (double)out->torque[i];
    }
    row[k++] = (double)out->collective;
{% else %}
    for (int i = 0; i < [[ N ]]_JETS; i++) {
        row[k++] = (double)out->throttle[i];
    }
    for (int i = 0; i < SERVOS; i++) {
        row[k++] = (double)out->tilt[i];
    }
    for (int i = 0; i < 4; i++) {
        row[k++] = (double)out->unallocated[i];
    }
{% endif %}
    for (int i = 0; i < 3; i++) {
        row[k++] = (double)out->rate_setpoint[i];
    }
    for (int i = 0; i < 3; i++) {
        row[k++] = (double)out->rate_predicted[i];
    }
{% if not f.loops %}
    for (int i = 0; i < 3; i++) {
        row[k++] = (double)out->torque[i];
    }
    row[k++] = (double)out->collective;
    row[k++] = (double)out->allocated;
    for (int i = 0; i < [[ N ]]_JETS; i++) {
        row[k++] = out->off[i] ? 1.0 : 0.0;
    }
{% endif %}
    return k;
}

static long compare(const double found[], const double wanted[], int count)
{
    long other = 0;
    for (int i = 0; i < count; i++) {
        const double off = (found[i] > wanted[i]) ? (found[i] - wanted[i]) : (wanted[i] - found[i]);
        if (!(off <= worst[i])) {
            worst[i] = off;
        }
        if (memcmp(&found[i], &wanted[i], sizeof(double)) != 0) {
            other++;
        }
    }
    return other;
}

static long fly(void)
{
    static [[ n ]]_State state;
{% if f.loops %}
    double found[ [[- N ]]_COLUMNS];
    long other = 0;
    RESET(state);
{% else %}
    [[ n ]]_Real throttle[ [[- N ]]_JETS];
    double found[ [[- N ]]_COLUMNS];
    long other = 0;
    RESET(state);
    for (int i = 0; i < [[ N ]]_JETS; i++) {
        found[i] = (double)throttle[i];
    }
    other += compare(found, [[ n ]]_start, [[ N ]]_JETS);
{% endif %}
    for (int k = 0; k < [[ N ]]_STEPS; k++) {
        [[ n ]]_Input input;
        [[ n ]]_Output output;
        read_input([[ n ]]_vectors[k], &input);
        [[ n ]]_step(&[[ n ]]_parameters, &state, &input, &output);
        const int count = write_output(&output, found);
        const long here = compare(found, &[[ n ]]_vectors[k][INPUTS], count);
#ifndef [[ N ]]_FLOAT
        if ((here > 0) && (other == 0)) {
            (void)printf("first at step %d:\n", k);
            for (int i = 0; i < count; i++) {
                if (memcmp(&found[i], &[[ n ]]_vectors[k][INPUTS + i], sizeof(double)) != 0) {
                    (void)printf("  output %d: %.17g in place of %.17g\n", i, found[i], [[ n ]]_vectors[k][INPUTS + i]);
                }
            }
        }
#endif
        other += here;
    }
    return other;
}

/* The least of several flights at each step leaves the interruptions out; what is printed is the worst step. */
static void measure(void)
{
    static [[ n ]]_State state;
{% if not f.loops %}
    [[ n ]]_Real throttle[ [[- N ]]_JETS];
{% endif %}
    [[ n ]]_Input input;
    [[ n ]]_Output output;
#if defined(__GNUC__) && (defined(__x86_64__) || defined(__i386__))
    static unsigned long long least[ [[- N ]]_STEPS];
    for (int repeat = 0; repeat < REPEATS; repeat++) {
        RESET(state);
        for (int k = 0; k < [[ N ]]_STEPS; k++) {
            read_input([[ n ]]_vectors[k], &input);
            const unsigned long long begin = __builtin_ia32_rdtsc();
            [[ n ]]_step(&[[ n ]]_parameters, &state, &input, &output);
            const unsigned long long cycles = __builtin_ia32_rdtsc() - begin;
            if ((repeat == 0) || (cycles < least[k])) {
                least[k] = cycles;
            }
        }
    }
    unsigned long long most = 0;
    unsigned long long sum = 0;
    for (int k = 0; k < [[ N ]]_STEPS; k++) {
        sum += least[k];
        most = (least[k] > most) ? least[k] : most;
    }
    (void)printf("cycles of the time-stamp counter: worst step %llu, mean %llu\n", most, sum / [[ N ]]_STEPS);
#else
    const clock_t begin = clock();
    for (int repeat = 0; repeat < REPEATS; repeat++) {
        RESET(state);
        for (int k = 0; k < [[ N ]]_STEPS; k++) {
            read_input([[ n ]]_vectors[k], &input);
            [[ n ]]_step(&[[ n ]]_parameters, &state, &input, &output);
        }
    }
    const double seconds = (double)(clock() - begin) / (double)CLOCKS_PER_SEC;
    (void)printf("mean of a step: %.3g us\n", 1e6 * seconds / (REPEATS * (double)[[ N ]]_STEPS));
#endif
}

int main(int count, char *arguments[])
{
    (void)arguments;
    const long other = fly();
{% if f.loops %}
    const double throttle = worst[3];
    double tilt = 0.0;
    for (int i = 0; i < 3; i++) {
        tilt = (worst[i] > tilt) ? worst[i] : tilt;
    }
    (void)printf("[[ n ]]: %d steps, %ld numbers differ in their bits; greatest deviation: collective %.3g, torque %.3g\n",
        [[ N ]]_STEPS, other, throttle, tilt);
{% else %}
    double throttle = 0.0;
    double tilt = 0.0;
    for (int i = 0; i < [[ N ]]_JETS; i++) {
        throttle = (worst[i] > throttle) ? worst[i] : throttle;
    }
    for (int i = [[ N ]]_JETS; i < ([[ N ]]_JETS + SERVOS); i++) {
        tilt = (worst[i] > tilt) ? worst[i] : tilt;
    }
    (void)printf("[[ n ]]: %d steps, %ld numbers differ in their bits; greatest deviation: throttle %.3g, tilt %.3g rad\n",
        [[ N ]]_STEPS, other, throttle, tilt);
{% endif %}
    if (count > 1) {
        (void)printf("state %lu bytes\n", (unsigned long)sizeof([[ n ]]_State));
        measure();
    }
#ifdef [[ N ]]_FLOAT
    return ((throttle < FLOAT_LIMIT){% if not f.loops %} && (tilt < FLOAT_LIMIT){% endif %}) ? 0 : 1;
#else
    return (other == 0) ? 0 : 1;
#endif
}
