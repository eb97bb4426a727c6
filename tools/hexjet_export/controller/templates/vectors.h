[[ licence ]]
/* A flight of [[ title ]], step by step: what went into the controller and what came out of it. */
#ifndef [[ N ]]_VECTORS_H
#define [[ N ]]_VECTORS_H

#define [[ N ]]_STEPS [[ rows|length ]]
#define [[ N ]]_COLUMNS [[ columns|length ]]

#define [[ N ]]_STARTS_ON_GROUND [[ "true" if on_ground else "false" ]]
#define [[ N ]]_FUEL_BURNT_AT_START [[ burnt ]]

extern const double [[ n ]]_start[ [[- start|length ]]]; /* throttles before the first step */

/* Columns of a row: [[ columns|join(", ")|wordwrap(100, wrapstring="\n * ") ]] */
extern const double [[ n ]]_vectors[ [[- N ]]_STEPS][ [[- N ]]_COLUMNS];

#endif
