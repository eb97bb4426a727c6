"""The log of a flight: its columns, how rows are made and kept, and its digest."""
