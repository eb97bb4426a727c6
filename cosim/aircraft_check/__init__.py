"""A vehicle of one's own looked over: forces, masses, authority, and a flight in hover."""
