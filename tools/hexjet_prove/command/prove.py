"""hexjet prove: a claim about a study or a design, shown or refuted, on one page."""

from cosim.commands import Command

prove = Command(
    "prove",
    "hexjet_prove.api.prove:prove",
    "roll-doublet-claim --out runs/proof",
    options={"claim": "--claim", "replays": "--replay"},
    metavars={
        "name": "STUDY|DESIGN|DIR",
        "claim": "P%@C%",
        "success": "METRIC<=X|FORMULA",
        "replays": "FILE",
        "cluster": "ADDRESS|local",
    },
    succeeded=lambda result: result.decision == "shown",
    ends="Status 0: shown; 1: refuted, open, or stopped before; 2: wrong input.",
)
