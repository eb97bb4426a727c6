#pragma once
typedef struct { float P, I, D, F, S, Sum; } pidAxisData_t;
extern pidAxisData_t pidData[3];
