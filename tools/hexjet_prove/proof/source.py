"""What is proven: a study with one controller, whose draws are independent and which ends at a claim."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cosim.base.errors import InputError
from cosim.base.storage.toml import read_toml
from cosim.studies import (
    MAX_TESTED,
    NothingVariesError,
    Study,
    default_runs,
    find_study,
    only_controller,
    open_study,
    parse_claim,
    study_names,
)
from hexjet_prove.proof.design_study import design_study, find_design


def proof_study(name: str, claim: str | None, budget: int | None = None, **options: Any) -> Study:
    """Return the study that proves ``claim`` for ``name``: a study, a scenario, or a design.

    ``claim``: such as ``99.9%@95%``; None: that of the study.  ``budget``: the most flights, by default ten times as
    many as the claim needs at least.  ``options`` are those of ``open_study``.  Draws of any other design than
    ``random`` become random ones: a claim counts independent draws.  Raises InputError: one line.
    """
    designed = find_design(Path(name))
    if designed is not None:
        if claim is None:
            raise InputError(f"{name}: a design states no claim; claim says what is to be shown, such as 99.9%@95%")
        runs = _max_flights(claim, "claim", budget)
        return _check_single_controller(design_study(designed, claim, runs, **options))
    table = _study_table(name)
    stated = table.get("until")
    if not claim and stated is None:
        _open_study(name, **options)  # an unknown name is reported first
        raise InputError(f"{name}: states no claim (until); claim says what is to be shown, such as 99.9%@95%")
    where = "claim" if claim else f"{name}: until ="
    claim = str(claim or stated)
    runs = _max_flights(claim, where, budget)
    study = _open_study(name, until=claim, design="random", runs=runs, **options)
    if not any(
        options.get(key) for key in ("settings", "controllers", "success", "vary")
    ):  # the title must state what flies
        said = {key: table[key] for key in ("title", "description") if key in table}
        if "title" in said and stated is not None and claim != str(stated):  # the file's title is on its own claim
            said = {"title": f"{table['name']}: {claim} in place of the {stated} that its file states"}
        study = study.changed(**said)
    return _check_single_controller(study)


def _open_study(name: str, **options: Any) -> Study:
    """Open a study as ``open_study``, without ``vary``."""
    try:
        return open_study(name, **options)
    except NothingVariesError:
        what = "a proof is of a study, a .toml file that names the scenario and says in [[vary]] what does"
        raise InputError(f"{name}: nothing varies; {what}") from None


def _max_flights(claim: str, where: str, budget: int | None) -> int:
    """Return the largest number of flights of the proof.

    Raises InputError for a claim that compares controllers, and where so many flights cannot show it.
    """
    parsed = parse_claim(claim, where)
    if parsed.pair is not None:
        raise InputError(f"{where} {claim}: compares two controllers, which hexjet sweep --until does")
    needed = parsed.fewest
    most = budget or default_runs(claim)
    if most > MAX_TESTED:
        raise InputError(f"budget {most}: at most {MAX_TESTED:,}")
    if most < needed:
        subject = f"budget {budget}" if budget else f"{where} {claim}"
        raise InputError(
            f"{subject}: {most:,} flights do not show it, even if all succeed; {claim} takes {needed:,} without a "
            "failure, and more with one"
        )
    return most


def _study_table(name: str) -> dict[str, Any]:
    """Return the table of a study's file; empty for a scenario's name."""
    return read_toml(find_study(name)) if Path(name).is_file() or name in study_names() else {}


def _check_single_controller(study: Study) -> Study:
    """Raise InputError for a study with more than one controller."""
    only_controller(study, "a proof")
    return study
