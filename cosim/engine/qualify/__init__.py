"""Whether a foreign FMU is fit to fly: checked in a process of its own."""
