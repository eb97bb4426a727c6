"""A study proven: what a review board asks of it, in one folder, on one page and in one JSON."""
