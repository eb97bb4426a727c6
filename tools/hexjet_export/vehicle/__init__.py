"""The vehicle as FMUs and as SSP archives, which fly in a process of their own."""
