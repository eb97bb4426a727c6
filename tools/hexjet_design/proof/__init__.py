"""The proof of a design: the engine measured past the crossover, and flights at the corners of the tolerances."""
