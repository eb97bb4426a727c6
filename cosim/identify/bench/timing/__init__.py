"""What bench logs do not say of time: which clock is true, how stretches differ, when commands moved in lost rows."""
