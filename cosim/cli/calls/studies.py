"""What ``hexjet sweep`` does beside ``cosim.sweep``: it lists what can be varied."""

from __future__ import annotations

from typing import Any

from cosim.api.call import Result, Table
from cosim.api.studies import study_settings
from cosim.api.studies import sweep as fly_all


class KeysResult(Result):
    """What can be varied."""

    def __init__(self, keys: list[dict[str, Any]]) -> None:
        self.keys = keys
        self.files = {}

    def to_dict(self) -> dict[str, Any]:
        """Return each key with its value now, its unit, and what it may be."""
        return {"keys": self.keys}

    def lines(self) -> list[str]:
        """Return how many there are."""
        return [f"{len(self.keys)} keys"]

    def tables(self) -> list[Table]:
        """Return the keys."""
        rows = []
        for key in self.keys:
            value = str(key["value"]).lower() if isinstance(key["value"], bool) else key["value"]
            rows.append((key["key"], "-" if value is None else f"{value}", key["unit"], key["allowed"]))
        return [Table("", ("key", "value", "unit", "allowed"), rows)]


def sweep(name: str, *, keys: str | None = None, **choices: Any) -> Result:
    """Fly a scenario many times with what varies drawn for each flight, or a study, or go on with a campaign.

    Parameters
    ----------
    name : str
        A scenario, a study, or the folder of a campaign to go on with.
    keys : str or None
        List what can be varied, all or what a pattern names, and fly nothing.
    """
    if keys is None:
        return fly_all(name, **choices)
    from cosim.campaign.study.keys import all_keys, matching
    from cosim.campaign.study.study import Study, study_names
    from cosim.spec.scenario import Scenario

    texts = study_settings(
        choices.get("settings", ()), choices.get("aircraft"), choices.get("engine"), choices.get("metrics", ()),
        choices.get("wind"),
    )  # fmt: skip
    base = Study.load(name).base() if name in study_names() else Scenario.load(name, texts)
    found = matching(all_keys(base), keys)
    return KeysResult(
        [{"key": each.path, "value": each.nominal, "unit": each.unit, "allowed": each.allowed} for each in found]
    )
