"""The functions of ``cosim`` that this package adds."""
