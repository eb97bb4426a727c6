[[ licence ]]
/* [[ title ]] in ArduPilot: a backend of AC_CustomControl, see AC_CustomControl_[[ Class ]].cpp. */
#pragma once

#include "AC_CustomControl_config.h"

#if AP_CUSTOMCONTROL_ENABLED

#include "AC_CustomControl_Backend.h"
#include "[[ n ]]_rates.h"

class AC_CustomControl_[[ Class ]] : public AC_CustomControl_Backend {
public:
    AC_CustomControl_[[ Class ]](AC_CustomControl& frontend, AP_AHRS_View*& ahrs, AC_AttitudeControl*& att_control,
        AP_MotorsMulticopter*& motors, float dt);

    // roll, pitch and yaw of the mixer, -1 to 1
    Vector3f update() override;

    void reset() override;

private:
    [[ n ]]_Rates _rates;
    Vector3f _answer;
    int _every; // loops of ArduPilot in a step of the controller; 0: no whole number
    int _left;  // until the next step
};

#endif // AP_CUSTOMCONTROL_ENABLED
