"""The machine that the program runs on: processes, threads, what others have installed."""
