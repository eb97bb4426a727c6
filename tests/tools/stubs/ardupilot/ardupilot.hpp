/* Of ArduPilot (Copter 4.5 to 4.7) what a backend of AC_CustomControl uses: declarations, and values that a test sets. */
#pragma once

#include <cstdint>
#include <cstdio>

#define AP_CUSTOMCONTROL_ENABLED 1
#define MAV_SEVERITY_CRITICAL 2
#define GCS_SEND_TEXT(severity, ...) std::fprintf(stderr, __VA_ARGS__)

struct Vector3f {
    float x, y, z;
    Vector3f() : x(0), y(0), z(0) {}
    Vector3f(float a, float b, float c) : x(a), y(b), z(c) {}
};

class AP_AHRS_View {
public:
    Vector3f gyro;
    const Vector3f &get_gyro_latest() const { return gyro; }
};

class AC_AttitudeControl {
public:
    Vector3f target;
    Vector3f rate_bf_targets() const { return target; }
};

class AP_Motors {
public:
    enum class SpoolState : uint8_t { SHUT_DOWN = 0, GROUND_IDLE = 1, SPOOLING_UP = 2, THROTTLE_UNLIMITED = 3, SPOOLING_DOWN = 4 };
    float throttle = 0;
    SpoolState state = SpoolState::SHUT_DOWN;
    SpoolState get_spool_state() const { return state; }
    float get_roll() const { return 0.1f; }
    float get_pitch() const { return 0.2f; }
    float get_yaw() const { return 0.3f; }
    float get_throttle() const { return throttle; }
};

class AP_MotorsMulticopter : public AP_Motors {};

class AP_Scheduler {
public:
    float period = 0;
    uint16_t get_loop_rate_hz() { return static_cast<uint16_t>(1.0f / period + 0.5f); }
    // As in 4.6: kept from before the parameters were read.
    float get_loop_period_s() { return 0.0025f; }
};

namespace AP {
AP_Scheduler &scheduler();
}

class AC_CustomControl {};

class AC_CustomControl_Backend {
public:
    AC_CustomControl_Backend(AC_CustomControl& frontend, AP_AHRS_View*& ahrs, AC_AttitudeControl*& att_control,
        AP_MotorsMulticopter*& motors, float) :
        _ahrs(ahrs), _att_control(att_control), _motors(motors), _frontend(frontend) {}
    virtual ~AC_CustomControl_Backend() {}
    virtual Vector3f update() = 0;
    virtual void reset() = 0;

protected:
    AP_AHRS_View*& _ahrs;
    AC_AttitudeControl*& _att_control;
    AP_MotorsMulticopter*& _motors;
    AC_CustomControl& _frontend;
};
