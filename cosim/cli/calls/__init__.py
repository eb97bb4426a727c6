"""What some commands do beside the functions of the package that they call."""
