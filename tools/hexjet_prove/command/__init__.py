"""hexjet search, rare, prove, faults and failsafes."""
