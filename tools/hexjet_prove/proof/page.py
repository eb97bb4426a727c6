"""The page of a proof: the sentence first, then what it rests on."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from markupsafe import Markup

from cosim.pages import Card, Page, code, link, marked, sentence
from cosim.studies import referee_cards, with_referee
from hexjet_prove.proof.credibility import CAPABILITY, RESULTS
from hexjet_prove.proof.result import Proof, WorstFlight

BADGES = {"shown": "completed", "refuted": "", "open": "failed"}  # CSS class of each decision
DECISION_WORDS = {"shown": "shown", "refuted": "refuted", "open": "not decided"}  # words for each decision
METHOD_NOTE = (  # note on the test
    "Flights with independent draws are counted in the order of their numbers, by a test whose boundaries were fixed "
    "before the first. It is wrong in at most {error:g} % of such proofs, however often you look. "
    "At most {most:,} flights. Noise and turbulence of each flight have a seed of their own."
)
MARGIN_NOTE = (  # note on margins
    "A margin is what is left to the nearest limit by that limit's size; below 0 the flight failed. Each folder flies "
    "again as it is: hexjet fly FOLDER/scenario.toml."
)
LIMIT_NOTE = (  # note on the limit of performance
    "Integrated absolute error after a unit step of load, rad s per unit of the command, of the nominal vehicle's "
    "linear loop; the least of any stabilising linear controller with the same peak sensitivity, noise and step error."
)
CREDIBILITY_NOTE = (  # note on the table of credibility
    "A form: the factors of NASA-STD-7009B (2024) with what is on record. The levels, from 0, not enough evidence, to "
    "4, are for a person to state; none is computed."
)


def describe_method(proof: Proof) -> str:
    """Return how the flights were drawn and counted."""
    return METHOD_NOTE.format(error=100.0 * proof.claim.claim.error, most=proof.study["most_flights"])


def write_page(proof: Proof, path: Path) -> None:
    """Write the page.  Raises FlightError if that fails."""
    study, repeat = proof.study, proof.repeat
    groups = {CAPABILITY: "the model", RESULTS: "this use of it"}
    drawn = [(code(r["path"]), r["drawn"], r["nominal"], r["observed"], r["unit"]) for r in proof.uncertainty]
    kept = [(label, says, broken, margin or "–") for label, says, broken, margin in proof.requirement_rows()]
    rare = [proof.rare.says] if proof.rare.result else []
    shown = [f"{line}." for line in proof.claim.lines()]
    campaign = Markup("{} {} has every flight.").format(
        describe_method(proof), link("The campaign", "campaign/report.html")
    )
    recorded = [(groups[one.assessment], one.name, one.evidence, "", "") for one in proof.credibility]
    cards = [
        Card("What a flight must keep", ("", "requirement", "broken", "smallest margin"), kept),
        Card("How it is shown", text=campaign, lines=[*shown, *rare]),
        Card("The worst flights, flown again", ("flight", "why", "ended", "margin", "drawn", "again"),
             [_worst_row(one) for one in proof.worst], MARGIN_NOTE, lines=list(_search_rows(proof))),
        *referee_cards(proof.referee),
        _limits_card(proof),
        Card("What is not known, and where that is from", ("key", "drawn from", "nominal", "flown", "unit"), drawn,
             lines=[f"The probability is over {proof.over}."]),
        Card("What is not covered", lines=proof.not_covered),
        Card("Credibility", ("of", "factor", "what is on record", "level", "why, by whom"), recorded, CREDIBILITY_NOTE),
        Card("Again, bit for bit", ("made with", "version"), list(repeat["versions"].items()),
             f"It is the same where its rows_sha256 is {repeat['rows_sha256']}.", code=repeat["command"]),
    ]  # fmt: skip
    page = Page(
        "proof",
        study["title"] or study["name"],
        cards,
        verdict=f"{proof.claim.text}: {DECISION_WORDS[proof.decision]}",
        badge=BADGES[proof.decision],
        answer=with_referee([proof.sentence], proof.referee),
        evidence=[f"{about[:1].upper()}{about[1:]}: {text}" for about, text in proof.facts.items()],
        facts=[(name, str(study[name])) for name in ("scenario", "aircraft", "engine", "controller", "seed")],
    )
    page.write(path)


def _search_rows(proof: Proof) -> Iterator[Markup]:
    """Yield a row for each search of the worst flights: its result, its flights and a link to its page."""
    for part in (proof.likely, proof.worst_case):
        if part.result:
            run = part.result["run"]
            flight, search = f"{run}/report.html", f"{run.rpartition('/cases/')[0]}/search.html"
            links = link("Its flight", flight), link("the search", search)
            yield Markup("{} {}, {}.").format(sentence(part.says), *links)


def _worst_row(one: WorstFlight) -> tuple[str, ...]:
    values = ", ".join(f"{key} {v:.4g}" if isinstance(v, float) else f"{key} {v}" for key, v in one.values.items())
    again = one.again if one.is_same else marked("not the same", "unmet")
    flight = link(str(one.flight), f"{one.run}/report.html" if one.run else "")
    return flight, one.why, f"{one.outcome}, {one.reason}", f"{one.margin:.3g}", values, again


def _limits_card(proof: Proof) -> Card:
    """Return the card that compares the controller with the best possible one by axis, or says why it cannot."""
    rows, missing = [], []
    for axis, limit in proof.limits.items():
        if isinstance(limit, str):
            missing.append(f"{axis.capitalize()}: {limit.removeprefix(f'{axis}: ')}.")
            continue
        tolerant = "–" if limit.times_tolerant is None else f"{limit.times_tolerant:.2f}"
        numbers = f"{limit.load_error:.4g}", f"{limit.least.load_error:.4g}", f"{limit.times:.2f}", tolerant
        rows.append((axis, *numbers))
    columns = ("axis", "error after a load", "the least", "times the least", "with its tolerance of the delay")
    return Card("How far the controller is from the best", columns, rows, LIMIT_NOTE if rows else "", lines=missing)
