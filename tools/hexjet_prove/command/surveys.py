"""hexjet faults: what a vehicle survives, and how it comes down."""

from cosim.commands import Command

faults = Command(
    "faults",
    "hexjet_prove.api.surveys:faults",
    "--kind flame-out --kind thrust",
    modes={"autopilot": "hexjet_prove.api.surveys:failsafes"},
    options={"aircraft": "--aircraft", "engine": "--engine", "kinds": "--kind --failsafe", "heights": "--height",
             "winds": "--wind-speed --wind"},
    metavars={"kinds": "NAME", "heights": "M", "winds": "M/S", "moving": "M/S"},
)  # fmt: skip
