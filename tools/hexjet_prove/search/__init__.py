"""How far a vehicle can be pushed: line searches over flights."""
