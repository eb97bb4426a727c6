"""The page of a proof: the sentence first, then what it rests on."""

from __future__ import annotations

from pathlib import Path

from cosim.pages import render
from hexjet_prove.proof.credibility import CAPABILITY, RESULTS
from hexjet_prove.proof.result import Proof

TEMPLATE = Path(__file__).parent / "templates" / "proof.html"
BADGES = {"shown": "completed", "refuted": "", "open": "failed"}
WORDS = {"shown": "shown", "refuted": "refuted", "open": "not decided"}
METHOD = (
    "Flights with independent draws are counted in the order of their numbers, by a test whose boundaries were fixed "
    "before the first: it says shown, or refuted, of what is not so with a probability of at most {error:g} %, however "
    "often it is looked at. At most {most:,} flights. Noise and turbulence of each flight have a seed of their own."
)


def describe_method(proof: Proof) -> str:
    """Return how the flights were drawn and counted."""
    return METHOD.format(error=100.0 * proof.claim.claim.error, most=proof.study["most_flights"])


def write_page(proof: Proof, path: Path) -> None:
    """Write the page.  Raises FlightError if that fails."""
    groups = {CAPABILITY: "The model", RESULTS: "This use of it"}
    render(
        TEMPLATE,
        path,
        {},
        proof=proof,
        badge=BADGES[proof.decision],
        word=WORDS[proof.decision],
        method=describe_method(proof),
        claims=list(proof.claim.lines()),
        requirements=list(proof.requirement_rows()),
        limits=[(axis, limit) for axis, limit in proof.limits.items() if not isinstance(limit, str)],
        no_limits=[(axis, limit) for axis, limit in proof.limits.items() if isinstance(limit, str)],
        groups=[(title, [one for one in proof.credibility if one.assessment == key]) for key, title in groups.items()],
    )
