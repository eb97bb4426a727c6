"""hexjet validate: a model beside a flight."""

from __future__ import annotations

from cosim.commands import Command, one_thread
from hexjet_identify.commands import LOG_METAVARS, LOG_OPTIONS

validate = Command(
    "validate",
    "hexjet_identify.api.logs:validate",
    "roll-model other-flight.ulg",
    options=LOG_OPTIONS,
    metavars={"model": "MODEL", "log": "LOG", **LOG_METAVARS},
    folder=lambda arguments: "validation",
    before=lambda arguments: one_thread(),
    ends="Status 0, however well it fits.",
)
