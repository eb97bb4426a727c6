"""hexjet search: a search among flights, and failures too rare to count."""

from cosim.commands import Command

search = Command(
    "search",
    "hexjet_prove.api.searches:search",
    "roll-doublet --vary mismatch.delay_samples=0:60",
    modes={"rare": "hexjet_prove.api.searches:rare"},
    metavars={"name": "SCENARIO|STUDY|DESIGN", "vary": "KEY=LO:HI[:N]", "within": "SD|ranges", "over": "KEY=LO:HI:N",
              "tolerance": "[KEY=]X", "correlate": "KEY,KEY=R", "success": "METRIC<=X|FORMULA", "target": "P",
              "cluster": "ADDRESS|local"},
    goes_on="the same command with --out {folder} --resume",
    succeeded=lambda result: result.confirmed,
    ends="Status 0: searched, whatever was found; 1: it was stopped before, or a flight that shows it came out "
    "otherwise when it was flown again.",
)  # fmt: skip
