"""Effects on the airframe beside thrust, each a class of its own; :mod:`.make` lists those of a vehicle."""
