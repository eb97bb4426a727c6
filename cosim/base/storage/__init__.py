"""What is read from files and written to them, and where they are."""
