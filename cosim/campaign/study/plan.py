"""The flights of a study: every draw with every controller, numbered from 0.

Flights of one draw are neighbours: they meet the same numbers, the same noise and the same turbulence.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import TYPE_CHECKING

from cosim.base.errors import InputError, nearest
from cosim.campaign.study.distributions import CASE
from cosim.campaign.study.draws import Draws, LazySequence
from cosim.campaign.study.key import Value
from cosim.campaign.study.keys import with_values
from cosim.campaign.study.sequential import StoppingRule, parse_claim
from cosim.campaign.study.study import Study
from cosim.spec.controller_name import resolve_controller, short_name, split_file_name

if TYPE_CHECKING:
    from cosim.campaign.study.draws import Draw
    from cosim.spec.scenario import Scenario


@dataclass(frozen=True)
class Flight:
    """One flight of a study; ``values`` are absolute, by dotted key.

    A ``controller`` that is a file is named as seen from the study's folder.
    """

    number: int
    draw: int
    controller: str
    seed: int
    values: Mapping[str, Value]


def flight_of(study: Study, row: Mapping[str, Value | None]) -> Flight:
    """Return the flight described by a row; missing values are as in the scenario."""
    values = {name: value for name in study.drawn if (value := row[name]) is not None}
    return Flight(row["flight"], row["draw"], row["controller"], row["seed"], values)  # type: ignore[arg-type]


def flight_key(fingerprint: str, flight: Flight) -> str:
    """Return the hash of what is flown: of scenario and program as in ``fingerprint``, controller, seed and values."""
    flown = json.dumps([fingerprint, flight.controller, flight.seed, flight.values], sort_keys=True)
    return blake2b(flown.encode(), digest_size=8).hexdigest()


class _Flights(LazySequence[Flight]):
    """Every draw with every controller, as a sequence whose flights are made when asked for."""

    def __init__(self, draws: Sequence[Draw], controllers: Sequence[str]) -> None:
        self._draws = draws
        self._controllers = controllers

    def __len__(self) -> int:
        return len(self._draws) * len(self._controllers)

    def _compute_item(self, number: int) -> Flight:
        draw_number, controller = divmod(number, len(self._controllers))
        draw = self._draws[draw_number]
        return Flight(number, draw.number, self._controllers[controller], draw.seed, draw.values)


def flights(study: Study) -> Sequence[Flight]:
    """Return every flight of ``study``, in the order in which they are flown."""
    return _Flights(Draws(study), controllers(study))


def flight_count(study: Study) -> int:
    return study.draws * len(controllers(study))


def controllers(study: Study) -> list[str]:
    """Return each draw's controllers as rows name them: files relative to the study's folder."""
    return [_relative_name(study.folder, name) for name in study.controller_names]


def only_controller(study: Study, what: str) -> str:
    """Return a study's only controller; ``what`` needs one.  Raises InputError if there are several."""
    names = controllers(study)
    if len(names) > 1:
        raise InputError(
            f"study {study.name}: has {len(names)} controllers, and {what} is one's; controller NAME says which: "
            f"{', '.join(map(short_name, names))}"
        )
    return names[0]


def stopping_rule(study: Study) -> StoppingRule | None:
    """Return the stopping rule of ``study`` before any flight; None if it flies all draws.

    Raises InputError if the claim names a controller that the study does not have.
    """
    if study.until is None:
        return None
    claim, names = parse_claim(study.until), controllers(study)
    if claim.pair is not None:
        by_file_name = {Path(name).name: name for name in names}
        for name in claim.pair:
            if Path(name).name not in by_file_name:
                raise InputError(f"until = {study.until}: no controller {name!r} flies here; {nearest(name, names)}")
        first, second = (by_file_name[Path(name).name] for name in claim.pair)
        claim = claim._replace(pair=(first, second))
    return StoppingRule(claim, names, study.draws)


def scenario_of(study: Study, flight: Flight) -> Scenario:
    """Return the scenario of one flight without expectations.  Raises InputError if its values make none."""
    controller = study.tried[0] if study.autopilot is not None else resolve_controller(flight.controller, study.folder)
    values = {key: value for key, value in flight.values.items() if key != CASE}
    return with_values(study.base(case_of(flight.values)), {**values, "controller": controller, "seed": flight.seed})


def case_of(values: Mapping[str, Value | None]) -> str | None:
    """Return the name of the case among the values of a flight or a row, None without cases."""
    case = values.get(CASE)
    return None if case is None else str(case)


def _relative_name(folder: Path, controller: str) -> str:
    """Return the name of a controller's file relative to the folder that holds it, wherever that is."""
    named = split_file_name(controller)
    if named is not None and Path(named.file).is_relative_to(folder.absolute()):
        return named._replace(file=Path(named.file).relative_to(folder.absolute()).as_posix()).text
    return controller
