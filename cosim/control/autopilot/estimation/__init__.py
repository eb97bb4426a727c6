"""What the vehicle is thought to do: attitude, rates, place, height and speeds, and how sure they are."""
