"""What is proven: a study with one controller, whose draws are independent and which ends at a claim."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cosim.base.errors import InputError
from cosim.base.storage.toml import read_toml
from cosim.campaign.proof.design_study import design_study, find_design
from cosim.campaign.study.options import open_study
from cosim.campaign.study.plan import only_controller
from cosim.campaign.study.sequential import default_runs, parse_claim
from cosim.campaign.study.study import Study, find_study, study_names


def proof_study(name: str, claim: str | None, budget: int | None = None, **options: Any) -> Study:
    """Return the study that proves ``claim`` of what ``name`` is: a study, a scenario, or a design.

    ``claim``: such as ``99.9%@95%``; None: that of the study.  ``budget``: the most flights, by default ten times as
    many as the claim needs at least.  ``options`` are those of ``open_study``.  Draws of any other design than
    ``random`` become random ones: a claim counts independent draws.  Raises InputError: one line.
    """
    designed = find_design(Path(name))
    if designed is not None:
        if claim is None:
            raise InputError(f"{name}: a design states no claim; --claim says what is to be shown, such as 99.9%@95%")
        return _checked(design_study(designed, claim, budget or default_runs(claim), **options), claim)
    table = _study_table(name)
    claim = claim or table.get("until")
    if claim is None:
        open_study(name, **options)  # a name that is not known is reported before
        raise InputError(f"{name}: states no claim (until); --claim says what is to be shown, such as 99.9%@95%")
    study = open_study(name, until=claim, design="random", runs=budget or default_runs(claim), **options)
    if not any(options.get(key) for key in ("settings", "controllers", "vary")):  # what flies is what the title says
        study = study.changed(**{key: table[key] for key in ("title", "description") if key in table})
    return _checked(study, claim)


def _study_table(name: str) -> dict[str, Any]:
    """Return the table of a study's file; empty for a scenario's name."""
    return read_toml(find_study(name)) if Path(name).is_file() or name in study_names() else {}


def _checked(study: Study, claim: str) -> Study:
    """Raise InputError for a claim that compares controllers, and a study with more than one of them."""
    if parse_claim(claim).pair is not None:
        raise InputError(f"--claim {claim}: compares two controllers, which hexjet sweep --until does")
    only_controller(study, "a proof")
    return study
