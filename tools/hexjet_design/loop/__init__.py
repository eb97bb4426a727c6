"""The linear loop: the channel, its delays, the controller around it, and its responses."""
