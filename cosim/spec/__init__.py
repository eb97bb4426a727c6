"""What files say: scenarios and vehicles as typed, checked models."""
