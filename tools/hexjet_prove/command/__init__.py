"""hexjet search, prove and faults."""
