/* The thrust dynamics of one identification of the P220, for p220.c: T'' as a function of T [N], T' [N/s] and the drive v,
 * which is a function of the ECU's command in percent. */
#ifndef P220_H
#define P220_H

#include "engine.h"

/* What the command, 0 to 100 percent, is in the equation. */
ENGINE_LOCAL double thrust_drive(double percent);

/* T'' [N/s^2] */
ENGINE_LOCAL double thrust_acceleration(double T, double D, double v);

/* The stable thrust [N] at which nothing moves. */
ENGINE_LOCAL double thrust_at_rest(double v);

#endif
