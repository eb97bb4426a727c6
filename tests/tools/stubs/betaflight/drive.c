/* Betaflight around the adapter: rows of set-point, rate [rad/s, forward-right-down], throttle and whether it flies come
 * in, pidData[].Sum about the same axes goes out. The loop runs four times in a control step, the clock turns over. */
#include <stdio.h>

#include "flight/mixer.h"
#include "flight/ours_betaflight.h"
#include "flight/pid.h"
#include "sensors/gyro.h"

pidAxisData_t pidData[3];
gyro_t gyro;
static float throttle;

float mixerGetThrottle(void)
{
    return throttle;
}

int main(void)
{
    const float turned[3] = {1.0f, -1.0f, -1.0f};
    const float degrees = 57.29577951308232f;
    timeUs_t now = 0xffffffffu - 20000u;
    float asked[3], measured[3], engines;
    int flies;
    while (scanf("%f %f %f %f %f %f %f %d", &asked[0], &asked[1], &asked[2], &measured[0], &measured[1], &measured[2],
               &engines, &flies) == 8) {
        throttle = (engines - 0.05f) / 0.95f;
        for (int part = 0; part < 4; part++) {
            for (int axis = 0; axis < 3; axis++) {
                /* what comes between the controller's steps is not heard */
                ours_ask(axis, degrees * turned[axis] * (part ? 1.0f : asked[axis]));
                gyro.gyroADCf[axis] = degrees * turned[axis] * (part ? -1.0f : measured[axis]);
                pidData[axis].Sum = 1e6f;
            }
            ours_answer(now, flies);
            now += 1000;
        }
        printf("%.9g %.9g %.9g\n", (double)pidData[0].Sum, (double)-pidData[1].Sum, (double)-pidData[2].Sum);
    }
    return 0;
}
