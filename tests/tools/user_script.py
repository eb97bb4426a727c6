"""A user's script: mypy, which reads this file too, finds what is wrong in it where it is, and nothing that is right.

What is wrong is marked, and an error that is not found makes its mark one that is not used, which is an error then.
"""

from __future__ import annotations

from pathlib import Path

from cosim import (
    Command,
    Scenario,
    Stepper,
    check_engine,
    compare,
    design,
    export,
    faults,
    fly,
    identify,
    identify_log,
    margins,
    open_run,
    show,
    sweep,
)
from cosim.base.protocols import Parameter


def study(folder: Path) -> float:
    """What is right."""
    scenario = Scenario.load("roll-doublet").replace(engine="edf", vehicle={"mass_kg": 6.0}, duration_s=2.5)
    run = fly(scenario, folder / "run", controller="smith")
    error = run.metrics["roll"].rmse_rad
    again = open_run(folder / "run")
    highest = float(again.log["roll_rad"].max())
    swept = sweep("hover", vary={"vehicle.mass_kg": "5:6.5"}, controllers=["smith"], runs=4, workers=2, out=folder)
    won = sum(1 for each in swept.columns["success"] if each)
    designed = design("turbojet", proof=False)
    if designed.ok and designed.write(folder / "turbojet.toml").controller is not None:
        highest += len(design("turbojet", start=designed.controller).lines())
    measured = margins(scenario, ["roll"], limit=True).axes["roll"].response.margins["phase_deg"]
    identified = identify("roll", "edf", from_hz=0.5).model.delay_samples
    held = sum(row.verdict == "held" for row in faults(kinds=["flame-out"]).survey.rows)
    won += held if check_engine("edf", settings={"gain": 0.3}).is_fit else len(identify_log(folder, "roll").tables())
    apart = compare(run, "hover", shift={"B": 0.1}).compared[0].same
    path: Path = export(run, "mcap")
    with Stepper("hover") as flight:
        flight.step(Command((0.1, 0.0, 0.0), 10.0))
    texts = [*show("edf").lines(), str(path), str(apart), Parameter("share", 1.0, "", "of all", 0.0, 2.0).name]
    return highest + won + identified + len(texts) + (error or 0.0) + (measured.value if measured else 0.0)


def mistakes(scenario: Scenario) -> None:
    """What is wrong."""
    scenario.replace(engin="edf")  # type: ignore[call-arg]
    scenario.replace(duration_s="2.5")  # type: ignore[arg-type]
    fly(scenario, out=5)  # type: ignore[arg-type]
    fly(scenario).metric  # type: ignore[attr-defined]  # noqa: B018
    sweep("hover", runs="4")  # type: ignore[arg-type]
    sweep("hover", controller=["smith"])  # type: ignore[call-arg]
    identify("rol")  # type: ignore[arg-type]
    faults("hexjet", kind=["flame-out"])  # type: ignore[call-arg]
    identify_log("a.ulg", "rol")  # type: ignore[arg-type]
    check_engine("edf").is_ok  # type: ignore[attr-defined]  # noqa: B018
    len(margins("hover"))  # type: ignore[arg-type]
