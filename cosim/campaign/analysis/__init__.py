"""What many flights say together."""
