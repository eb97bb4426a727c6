"""Code of the user and of installed packages: found by its name, and run once it is trusted."""
