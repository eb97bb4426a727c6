"""The folder of runs as a page: what is in it, found quickly, and a server of it on this machine alone."""
