"""hexjet search and rare: a search among flights, and failures too rare to count."""

from cosim.commands import Command

METAVARS = {"correlate": "KEY,KEY=R", "success": "METRIC<=X|FORMULA", "cluster": "ADDRESS|local"}
AGAIN = "the same command with --out {folder} --resume"

search = Command(
    "search",
    "hexjet_prove.api.searches:search",
    "roll-doublet --vary mismatch.delay_samples=0:60",
    metavars=METAVARS | {"name": "SCENARIO|STUDY|DESIGN", "vary": "KEY=LO:HI[:N]", "within": "SD|ranges",
                         "over": "KEY=LO:HI:N", "tolerance": "[KEY=]X"},
    goes_on=AGAIN,
    succeeded=lambda result: result.confirmed,
    ends="Status 0: searched, whatever was found; 1: it was stopped before, or a flight that shows it came out "
    "otherwise when it was flown again.",
)  # fmt: skip
rare = Command(
    "rare",
    "hexjet_prove.api.searches:rare",
    "roll-doublet --vary 'mismatch.delay_samples=normal(0,4,-20,40)'",
    metavars=METAVARS | {"name": "SCENARIO|STUDY", "vary": "KEY=...", "target": "P"},
    goes_on=AGAIN,
    succeeded=lambda result: result.confirmed,
    ends="Status 0: done, whatever was found; 1: it was stopped before, or a failure came out otherwise when it was "
    "flown again.",
)
