/* ArduPilot around the adapter, rows as for Betaflight. The loop runs twice in a control step; the first argument is its
 * period, the second the least throttle of a motor. */
#include <cstdlib>

#include "AC_CustomControl_Ours.h"

static AP_Scheduler the_scheduler;

AP_Scheduler &AP::scheduler()
{
    return the_scheduler;
}

int main(int argc, char **argv)
{
    if (argc != 3) {
        return 1;
    }
    the_scheduler.period = strtof(argv[1], nullptr);
    const float idle = strtof(argv[2], nullptr);
    AC_CustomControl frontend;
    AP_AHRS_View view, *ahrs = &view;
    AC_AttitudeControl control, *attitude = &control;
    AP_MotorsMulticopter mixer, *motors = &mixer;
    AC_CustomControl_Ours ours(frontend, ahrs, attitude, motors, 0.0f);
    AC_CustomControl_Backend &backend = ours;
    backend.reset();
    Vector3f asked, rate;
    float engines;
    int flies;
    while (std::scanf("%f %f %f %f %f %f %f %d", &asked.x, &asked.y, &asked.z, &rate.x, &rate.y, &rate.z, &engines, &flies) == 8) {
        mixer.throttle = (engines - idle) / (1.0f - idle);
        mixer.state = flies ? AP_Motors::SpoolState::THROTTLE_UNLIMITED : AP_Motors::SpoolState::GROUND_IDLE;
        control.target = asked;
        view.gyro = rate;
        backend.update();
        control.target = Vector3f(1, 1, 1); // what comes between the controller's steps is not heard
        view.gyro = Vector3f(-1, -1, -1);
        const Vector3f out = backend.update();
        std::printf("%.9g %.9g %.9g\n", double(out.x), double(out.y), double(out.z));
    }
    return 0;
}
