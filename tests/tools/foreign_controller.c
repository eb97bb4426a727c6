/* A rate loop of P and I as an FMU written by hand, FMI 2.0: three set-points, three rates, a share of the gains.  With
 * ANSWERS, of which the first JETS are throttles, a whole controller that answers with a table instead, and fails where it
 * is not told its own tilts of the step before.  Functions that are not written here the tests add as stubs.
 */
#include <stdlib.h>
#include <string.h>

typedef struct {
    double value[64]; /* by value reference: 1 to 6 inputs, 11 to 13 outputs, 14 the integral of roll, 20 the share */
    double integral[3];
} Loop;

void *fmi2Instantiate(const char *name, int type, const char *guid, const char *folder, const void *callbacks, int visible,
                      int logging)
{
    Loop *loop = calloc(1, sizeof(Loop));
    loop->value[20] = 1.0;
    (void)name, (void)type, (void)guid, (void)folder, (void)callbacks, (void)visible, (void)logging;
    return loop;
}

void fmi2FreeInstance(void *loop) { free(loop); }
int fmi2SetupExperiment(void *l, int a, double b, double c, int d, double e) { (void)l, (void)a, (void)b, (void)c, (void)d, (void)e; return 0; }
int fmi2EnterInitializationMode(void *l) { (void)l; return 0; }
int fmi2ExitInitializationMode(void *l) { (void)l; return 0; }
int fmi2Terminate(void *l) { (void)l; return 0; }

int fmi2Reset(void *instance)
{
    memset(((Loop *)instance)->integral, 0, sizeof ((Loop *)instance)->integral);
    return 0;
}

int fmi2SetReal(void *instance, const unsigned reference[], size_t count, const double value[])
{
    for (size_t i = 0; i < count; i++)
        ((Loop *)instance)->value[reference[i]] = value[i];
    return 0;
}

int fmi2GetReal(void *instance, const unsigned reference[], size_t count, double value[])
{
    for (size_t i = 0; i < count; i++)
        value[i] = ((Loop *)instance)->value[reference[i]];
    return 0;
}

#ifdef ANSWERS /* 1 and on: tilts applied; 31 and on: answers */
static const double table[][ANSWERS] = {
#include "table.h"
};

int fmi2DoStep(void *instance, double now, double step, int again)
{
    Loop *loop = instance;
    const int k = (int)(now / step + 0.5);
    (void)again;
    for (int i = JETS; i < ANSWERS; i++)
        if (k > 0 && loop->value[1 + i - JETS] != table[k - 1][i])
            return 3;
    memcpy(loop->value + 31, table[k], sizeof table[k]);
    return 0;
}
#else
int fmi2DoStep(void *instance, double now, double step, int again)
{
    static const double gain[3] = {0.05, 0.2, 0.2};
    Loop *loop = instance;
    (void)now, (void)again;
    for (int axis = 0; axis < 3; axis++) {
        const double error = loop->value[1 + axis] - loop->value[4 + axis];
        if (error > 1e6)
            abort();
        loop->integral[axis] += 0.5 * step * error;
        loop->value[11 + axis] = loop->value[20] * gain[axis] * (error + loop->integral[axis]);
    }
    loop->value[14] = loop->integral[0];
    return 0;
}
#endif
