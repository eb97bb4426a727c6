"""The phases of a flight, each a law of its own; :mod:`cosim.control.cascade` flies the first that applies."""
