"""What ``cosim.prove``, ``search``, ``rare``, ``faults`` and ``failsafes`` call, and what each gives back."""
