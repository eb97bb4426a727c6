"""Claims shown or refuted by flights: search, rare failures, proofs, surveys of faults and failsafes."""
