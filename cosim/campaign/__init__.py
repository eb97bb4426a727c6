"""Thousands of flights of one scenario: drawn, flown by many processes, kept, and looked at.

from cosim.campaign import open_study, run_campaign

study = open_study("roll-doublet", vary=["vehicle.mass_kg=5:6.5"], controllers=["smith", "baseline"], runs=1000)
campaign = run_campaign(study, "runs/mass")
campaign.columns["success"], campaign.columns["vehicle.mass_kg"]
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cosim.campaign.run import fly_again, run_campaign
    from cosim.campaign.store import Campaign, open_campaign
    from cosim.campaign.study.options import open_study
    from cosim.campaign.study.study import Study
    from cosim.campaign.workers.local import LocalWorkers
    from cosim.campaign.workers.tasks import as_finished
    from hexjet_prove.proof.source import proof_study

_WHERE = {  # module of each lazily imported name
    "Campaign": "store",
    "LocalWorkers": "workers.local",
    "Study": "study.study",
    "as_finished": "workers.tasks",
    "fly_again": "run",
    "open_campaign": "store",
    "open_study": "study.options",
    "run_campaign": "run",
}

__all__ = [
    "Campaign", "LocalWorkers", "Study", "as_finished", "fly_again", "open_campaign", "open_study", "proof_study",
    "run_campaign",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Load what is asked for and nothing else: a process that flies needs no tables."""
    if name in _WHERE:
        from importlib import import_module

        return getattr(import_module(f"{__name__}.{_WHERE[name]}"), name)
    if name in __all__:
        from cosim.base.plugins.entry_points import load_tool_member

        return load_tool_member(f"campaign.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
