"""Pages: a run as one file that opens offline."""
