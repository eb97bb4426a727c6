"""Commands that read what has flown."""
