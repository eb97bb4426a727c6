"""hexjet prove: a claim about a study or a design, shown or refuted, on one page."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from cosim.cli.old.sweep import FLEET, CampaignOptions, sweep_progress
from cosim.commands import DONE, FLIGHT_FAILED, example, opt, output_to_stderr, say, show_table

if TYPE_CHECKING:
    from hexjet_prove.proof.result import Proof


class Prove(CampaignOptions):
    """Options of ``hexjet prove``."""

    metrics: tuple[str, ...] = ()
    wind: str | None = None
    name = opt.argument(metavar="STUDY|DESIGN|DIR")
    claim = opt.word(
        "--claim", "P%@C%", "What is to be shown: a probability at a confidence, as 99.9%@95%.  [default: the study's]"
    )
    budget = opt.whole("--budget", "N", "Flights at most.  [default: ten times what the claim needs at least]", min=1)
    controllers = opt.words("--controller", "NAME|FILE", "The controller that is meant, of a study with several.")
    aircraft = opt.word("--aircraft", "NAME|DIR", "Overrides the scenario's, with the engine that it is made for.")
    engine = opt.word("--engine", "NAME|FILE", "As in hexjet sweep.")
    nominal_engine, settings = opt.NOMINAL_ENGINE, opt.SETTINGS
    seed = opt.whole("--seed", None, "Seed of the draws.")
    search = opt.whole(
        "--search", "N", "Flights for each search: of the most likely failure, and of the worst case; 0: none.",
        min=0, default=500,
    )  # fmt: skip
    rare = opt.whole(
        "--rare", "N", "Flights for the probability of failures too rare to count, as hexjet rare; 0: none.",
        min=0, default=0,
    )  # fmt: skip
    limit: bool = opt.option(
        "--limit/--no-limit", default=True,
        help="Compare the controller with the best that any linear one could do; a minute.  [default: --limit]",
    )  # fmt: skip
    replays = opt.option(
        "--replay", type=click.Path(path_type=Path, exists=True), metavar="FILE", multiple=True,
        help="What hexjet replay said of a recorded flight of this vehicle: replay.json, or its folder.",
    )  # fmt: skip
    workers = opt.whole("--workers", "N", "Processes.  [default: one a processor]", min=1)
    cluster = opt.word("--cluster", "ADDRESS|local", "As in hexjet sweep.")
    time_limit_s = opt.positive("--time-limit", "S", "Time of the clock for a flight.")
    out = opt.OUT
    resume = opt.flag("--resume", "Go on with what the folder holds; no flight is repeated.")
    as_json = opt.json("Print one JSON object at the end and nothing else.")


@click.command(epilog=example("hexjet prove roll-doublet-claim --out runs/proof"))
@opt.takes(Prove)
def prove(options: Prove) -> int:
    """Show or refute that a vehicle keeps its requirements, with what a review asks beside it, on one page.

    STUDY is a study's name or file, or a scenario's where the engine states its uncertainty; DESIGN a controller file
    of hexjet design or its folder; DIR a proof's folder, to be resumed.  Flies until the claim is decided, flies the
    worst again, compares the controller with the best linear one, and says what is not covered and what is on
    record of the model.  Status 0: shown; 1: refuted, open, or stopped before; 2: wrong input.
    """
    from hexjet_prove.api.prove import prove as show_claim

    chosen = ("claim", "budget", "controllers", "seed", "search", "rare", "limit", "replays")
    with (
        output_to_stderr(options.as_json),
        sweep_progress(quiet=options.as_json, goes_on="hexjet prove") as progress,
    ):
        proven = show_claim(
            options.name,
            progress=progress,
            **options.chosen(*chosen),
            **options.chosen("aircraft", "engine", "nominal_engine", "settings", *FLEET),
        )
    options.answer(proven.to_dict, lambda: print_proof(proven.proof))
    return DONE if proven.decision == "shown" else FLIGHT_FAILED


def print_proof(proof: Proof) -> None:
    """Print the sentence, what belongs to it, the requirements, what it was compared with, and where the page is."""
    from hexjet_prove.proof.credibility import VALIDATION

    say(proof.sentence)
    for about, text in proof.facts.items():
        say(f"{about}: {text}")
    show_table(["", "requirement", "broken", "smallest margin"], list(proof.requirement_rows()), [2, 3])
    (validation,) = [one for one in proof.credibility if one.name == VALIDATION]
    for line in (
        f"compared with the real vehicle: {validation.evidence}",
        "credibility: no level is computed; the report has the form of NASA-STD-7009B with what is on record",
        *(f"not covered: {text}" for text in proof.not_covered),
        f"again: {proof.repeat['command']}",
        f"folder: {proof.folder}",
        f"report: {proof.folder / 'proof.html'}",
    ):
        say(line, wrap=False)
