"""What ``hexjet sweep`` does beside ``cosim.sweep``: it lists what can be varied."""

from __future__ import annotations

from typing import Any

from cosim.api.call import Result, Table
from cosim.api.studies import study_settings
from cosim.api.studies import sweep as fly_all
from cosim.base.errors import InputError


class KeysResult(Result):
    """Keys that a study can vary."""

    def __init__(self, keys: list[dict[str, Any]], scenario: str) -> None:
        self.keys, self.scenario = keys, scenario
        self.files = {}

    def to_dict(self) -> dict[str, Any]:
        """Return each key with its nominal value, unit and allowed values."""
        return {"keys": self.keys}

    def lines(self) -> list[str]:
        """Return the line to print: how many keys there are, and the scenario that their values are from."""
        return [f"{len(self.keys)} keys, with their values in scenario {self.scenario}"]

    def tables(self) -> list[Table]:
        """Return a table of the keys; of keys that differ only in list indices the first."""
        from cosim.campaign.study.keys import LIST_INDEX

        alike: dict[str, list[dict[str, Any]]] = {}
        for key in self.keys:
            alike.setdefault(LIST_INDEX.sub("#", key["key"]), []).append(key)
        rows = []
        for key, *others in alike.values():
            value = str(key["value"]).lower() if isinstance(key["value"], bool) else key["value"]
            name = f"{key['key']}{f' and {len(others)} more' if others else ''}"
            rows.append((name, "-" if value is None else f"{value}", key["unit"], key["meaning"], key["allowed"]))
        return [Table("", ("key", "value", "unit", "meaning", "allowed"), rows)]


def sweep(name: str | None = None, *, keys: str | None = None, **choices: Any) -> Result:
    """Fly a scenario many times with what varies drawn for each flight, or a study, or go on with a campaign.

    Parameters
    ----------
    name : str or None
        A scenario, a study, or the folder of a campaign to go on with; ``keys`` goes without too.
    keys : str or None
        List what can be varied with its meaning, all or what a word or a pattern names, and fly nothing.
    """
    if keys is None and name is None:
        raise InputError("name a scenario, a study or the folder of a campaign (hexjet sweep --help)")
    if keys is None:
        return fly_all(str(name), **choices)
    from cosim.campaign.study.keys import all_keys, matching
    from cosim.campaign.study.study import Study, study_names
    from cosim.spec.scenario import Scenario

    texts = study_settings(
        choices.get("settings", ()), choices.get("aircraft"), choices.get("engine"), choices.get("metrics", ()),
        choices.get("wind"),
    )  # fmt: skip
    name = name or "roll-doublet"
    base = Study.load(name).base() if name in study_names() else Scenario.load(name, texts)
    found = [
        {"key": key.path, "value": key.nominal, "unit": key.unit, "meaning": key.meaning, "allowed": key.allowed}
        for key in matching(all_keys(base), keys)
    ]
    return KeysResult(found, base.name)
