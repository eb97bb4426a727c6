"""What an autopilot of a run was asked and said."""
