[[ licence ]]
/* [[ title ]] in Betaflight: see [[ n ]]_betaflight.c. */
#pragma once

#include <stdbool.h>

#include "common/time.h"

/* The rate that Betaflight's loops ask for about an axis, in deg/s. */
void [[ n ]]_ask(int axis, float setpoint);

/* Put our answer in the place of pidData[].Sum. `flies`: armed, and neither on the ground nor without stabilisation. */
void [[ n ]]_answer(timeUs_t now, bool flies);
