"""What a vehicle's thrust and tilt come from and act through."""
