[[ licence ]]
/* [[ title ]] in Betaflight: its own rate loop goes on for the log, and the mixer hears ours.
 *
 * Betaflight's axes are forward, left and up, in deg/s; those of the controller forward, right and down, in rad/s. The
 * controller runs every [[ step ]] s, by the time that Betaflight gives its loop, and its answer is held in between.
 */
#include "platform.h"

#include "common/axis.h"

#include "flight/mixer.h"
#include "flight/pid.h"

#include "sensors/gyro.h"

#include "flight/[[ n ]]_betaflight.h"
#include "flight/[[ n ]]_rates.h"

#define STEP_US [[ step_us ]]
#define IDLE [[ idle ]]f /* throttle of a motor at the throttle 0 of the mixer: motor_idle */
#define RADIANS 0.017453292519943295f

static const float turned[XYZ_AXIS_COUNT] = {1.0f, -1.0f, -1.0f};
static [[ n ]]_Rates rates;
static float asked[XYZ_AXIS_COUNT];  /* deg/s */
static float answer[XYZ_AXIS_COUNT]; /* of pidData[].Sum */
static timeUs_t due;
static bool begun;

void [[ n ]]_ask(int axis, float setpoint)
{
    asked[axis] = setpoint;
}

static void step(bool flies)
{
    float setpoint[XYZ_AXIS_COUNT];
    float measured[XYZ_AXIS_COUNT];
    float torque[XYZ_AXIS_COUNT];
    for (int axis = 0; axis < XYZ_AXIS_COUNT; axis++) {
        setpoint[axis] = RADIANS * turned[axis] * asked[axis];
        measured[axis] = RADIANS * turned[axis] * gyro.gyroADCf[axis];
    }
    [[ n ]]_rates_step(&rates, setpoint, measured, IDLE + (1.0f - IDLE) * mixerGetThrottle(), flies, torque);
    for (int axis = 0; axis < XYZ_AXIS_COUNT; axis++) {
        answer[axis] = turned[axis] * torque[axis];
    }
}

void [[ n ]]_answer(timeUs_t now, bool flies)
{
    if (!begun) {
        [[ n ]]_rates_reset(&rates);
        due = now;
        begun = true;
    }
    if (cmpTimeUs(now, due) >= 0) {
        due += STEP_US;
        if (cmpTimeUs(now, due) >= 0) { /* the loop stood for a whole step and more */
            due = now + STEP_US;
        }
        step(flies);
    }
    for (int axis = 0; axis < XYZ_AXIS_COUNT; axis++) {
        pidData[axis].Sum = flies ? answer[axis] : 0.0f;
    }
}
