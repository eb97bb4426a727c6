"""Surveys of one vehicle: every fault, every failsafe, every engine lost, and a look at the aircraft itself."""
