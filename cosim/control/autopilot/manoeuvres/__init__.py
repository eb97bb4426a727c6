"""What the vehicle can be asked to fly: from the ground and back, a mission, home, a circle, sticks and set-points."""
