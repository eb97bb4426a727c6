"""The commands of ``hexjet`` that this package adds."""
