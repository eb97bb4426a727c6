"""What a scenario has happen: commands, disturbances, wind, faults, and the plant that differs from the model."""
