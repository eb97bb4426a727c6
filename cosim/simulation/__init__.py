"""One flight step by step: commands, disturbances, faults, and the wiring of blocks."""
