/* Steps an engine of FMI 2.0 on Windows: driver DLL TOKEN STEP THROTTLE THRUST, the last two value references.
 * Prints the thrust after each of some steps of full throttle as hexadecimal floating point. */
#include <stdio.h>
#include <stdlib.h>
#include <windows.h>

#include "fmi2FunctionTypes.h"

static HMODULE library;

static FARPROC find(const char *name)
{
    FARPROC found = GetProcAddress(library, name);
    if (!found) {
        fprintf(stderr, "no %s\n", name);
        exit(2);
    }
    return found;
}

#define CALL(name) ((name##TYPE *)(void *)find(#name))

static void logger(void *e, fmi2String n, fmi2Status s, fmi2String c, fmi2String m, ...) { (void)e, (void)n, (void)s, (void)c, (void)m; }

int main(int argc, char **argv)
{
    if (argc != 6 || !(library = LoadLibraryA(argv[1])))
        return 2;
    const double step = atof(argv[3]);
    const fmi2ValueReference throttle = (fmi2ValueReference)atoi(argv[4]), thrust = (fmi2ValueReference)atoi(argv[5]);
    const fmi2CallbackFunctions callbacks = {logger, calloc, free, NULL, NULL};
    fmi2Component fmu = CALL(fmi2Instantiate)("windows", fmi2CoSimulation, argv[2], "", &callbacks, fmi2False, fmi2False);
    if (!fmu)
        return 3;
    CALL(fmi2SetupExperiment)(fmu, fmi2False, 0.0, 0.0, fmi2False, 0.0);
    CALL(fmi2EnterInitializationMode)(fmu);
    CALL(fmi2ExitInitializationMode)(fmu);
    for (int k = 0; k < 100; k++) {
        const double full = 1.0;
        double newton;
        CALL(fmi2SetReal)(fmu, &throttle, 1, &full);
        if (CALL(fmi2DoStep)(fmu, k * step, step, fmi2True) != fmi2OK)
            return 4;
        CALL(fmi2GetReal)(fmu, &thrust, 1, &newton);
        printf("%a\n", newton);
    }
    CALL(fmi2Terminate)(fmu);
    CALL(fmi2FreeInstance)(fmu);
    return 0;
}
