"""What flies: the airframe in JSBSim and what acts on it and measures it."""
