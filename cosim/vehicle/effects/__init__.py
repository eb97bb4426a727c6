"""What acts on the airframe beside thrust: each effect is a class of its own, and :mod:`.make` lists a vehicle's."""
