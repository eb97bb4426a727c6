"""What is measured of ours."""
