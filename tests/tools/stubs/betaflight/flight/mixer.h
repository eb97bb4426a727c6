#pragma once
float mixerGetThrottle(void);
