[[ licence ]]
/* [[ title ]] in ArduPilot: rate set-point, gyro and throttle of its loops go in, the mixer's roll, pitch and yaw come out.
 *
 * ArduPilot's axes are the controller's: forward, right, down, in rad/s. The controller runs every [[ step ]] s, a whole number
 * of ArduPilot's loops; where that is none the main controller's output is handed on, and it says so when it is switched on.
 */
#include "AC_CustomControl_[[ Class ]].h"

#if AP_CUSTOMCONTROL_ENABLED

#include <AP_Scheduler/AP_Scheduler.h>
#include <GCS_MAVLink/GCS.h>

#define IDLE [[ idle ]]f // throttle of a motor at the throttle 0 of the mixer: MOT_SPIN_MIN

AC_CustomControl_[[ Class ]]::AC_CustomControl_[[ Class ]](AC_CustomControl& frontend, AP_AHRS_View*& ahrs,
        AC_AttitudeControl*& att_control, AP_MotorsMulticopter*& motors, float dt) :
    AC_CustomControl_Backend(frontend, ahrs, att_control, motors, dt),
    _every(0),
    _left(0)
{
    [[ n ]]_rates_reset(&_rates);
}

Vector3f AC_CustomControl_[[ Class ]]::update()
{
    if (_every == 0) {
        return Vector3f{_motors->get_roll(), _motors->get_pitch(), _motors->get_yaw()};
    }
    bool flies = true;
    switch (_motors->get_spool_state()) {
        case AP_Motors::SpoolState::SHUT_DOWN:
        case AP_Motors::SpoolState::GROUND_IDLE:
            flies = false; // nothing is remembered from the ground
            break;
        case AP_Motors::SpoolState::THROTTLE_UNLIMITED:
        case AP_Motors::SpoolState::SPOOLING_UP:
        case AP_Motors::SpoolState::SPOOLING_DOWN:
            break;
    }
    if (_left == 0) {
        const Vector3f asked = _att_control->rate_bf_targets();
        const Vector3f gyro = _ahrs->get_gyro_latest();
        const [[ n ]]_Real setpoint[3] = {asked.x, asked.y, asked.z};
        const [[ n ]]_Real measured[3] = {gyro.x, gyro.y, gyro.z};
        [[ n ]]_Real torque[3];
        [[ n ]]_rates_step(&_rates, setpoint, measured, IDLE + (1.0f - IDLE) * _motors->get_throttle(), flies, torque);
        _answer = Vector3f{torque[0], torque[1], torque[2]};
        _left = _every;
    }
    _left--;
    return flies ? _answer : Vector3f{0.0f, 0.0f, 0.0f};
}

// When it is switched on.
void AC_CustomControl_[[ Class ]]::reset()
{
    const float dt = 1.0f / AP::scheduler().get_loop_rate_hz(); // the period in it may be that of another rate
    _every = static_cast<int>([[ step ]]f / dt + 0.5f);
    const float off = _every * dt - [[ step ]]f;
    if (off > 0.01f * [[ step ]]f || off < -0.01f * [[ step ]]f) {
        _every = 0;
        GCS_SEND_TEXT(MAV_SEVERITY_CRITICAL, "[[ n ]]: [[ step ]] s is no whole number of loops: main controller flies");
    }
    [[ n ]]_rates_reset(&_rates);
    _left = 0;
}

#endif // AP_CUSTOMCONTROL_ENABLED
