"""The probability of failures that are too rare to be counted."""
