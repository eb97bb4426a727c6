"""From moments and thrust to throttles and tilts."""
