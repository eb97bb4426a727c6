#pragma once
#define XYZ_AXIS_COUNT 3
