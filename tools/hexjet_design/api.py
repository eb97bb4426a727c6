"""A controller for an engine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any, Literal

from cosim.api.call import FolderResult, Limits, Progress, Table, check_types
from cosim.api.call.choices import engine_for, list_fmu_defects
from cosim.base.errors import InputError
from cosim.base.plugins.entry_points import load_hook
from cosim.base.storage.files import read_text
from cosim.base.storage.settings import as_settings
from cosim.base.trust import trust_named_code

if TYPE_CHECKING:
    from hexjet_design.design import Design
    from hexjet_design.loop.firmware import Firmware


class DesignResult(FolderResult):
    """Designed controller with its model, gains, margins and proof; ``designed`` has all the details."""

    def __init__(self, designed: Design, autopilot: str | None = None, chosen: Sequence[tuple[str, str]] = ()) -> None:
        self.designed = designed
        self.files = {}
        self._autopilot = autopilot
        self._chosen = chosen

    @property
    def ok(self) -> bool:
        """Whether the design meets the requirements and the proof succeeded."""
        return self.designed.ok

    @property
    def controller(self) -> Path | None:
        """The controller file, for :func:`cosim.fly`, also of an unproved design; None if not written."""
        return self.files.get("controller")

    @property
    def fly_command(self) -> str:
        """Command that flies the design with its aircraft, engine and settings; empty for an autopilot, or no file."""
        if self.controller is None or self._autopilot is not None:
            return ""
        chosen = "".join(f" --{option} {quote(value)}" for option, value in self._chosen)
        return f"hexjet fly SCENARIO{chosen} --controller {quote(str(self.controller))}"

    def _write(self, folder: Path) -> dict[str, Path]:
        """Write the controller file, if there is a design, and the page."""
        from hexjet_design.result import write

        file = prepare(folder)
        files = write(self.designed, file)
        if self._autopilot is not None and self.ok:
            write_parameters = _load_autopilot_hook("autopilot_parameters", self._autopilot)
            files |= write_parameters(self._autopilot, self.designed.scenario, file)
        return files

    def to_dict(self) -> dict[str, Any]:
        """Return the result without the curves."""
        from hexjet_design.result import to_dict

        return to_dict(self.designed, self.files)

    def lines(self) -> list[str]:
        """Return the result and the evidence for it."""
        from hexjet_design.result import summary_lines

        return [f"{self.designed.vehicle.name} with engine {self.designed.engine.name}", *summary_lines(self.designed)]

    def tables(self) -> list[Table]:
        """Return the linear margins, and proof flights compared with shipped gains."""
        from hexjet_design.proof.comparison import comparison_columns, comparison_rows
        from hexjet_design.result import COLUMNS, rows

        proof = self.designed.proof
        tables = [Table("", COLUMNS, rows(self.designed))]
        if proof is not None and proof.compared:
            tables.append(Table("", comparison_columns(proof.compared), comparison_rows(proof.compared)))
        return tables

    def _figures(self) -> Mapping[str, Any]:
        from hexjet_design.figures import design_figures

        return design_figures(self.designed)


@check_types(
    amplitude=Limits(0.0, 0.5, is_open=True),
    max_sensitivity=Limits(1.05, 10.0),
    delay_tolerance=Limits(0.0, 1.0),
    gain_tolerance=Limits(0.0, 0.95),
    engine_spread=Limits(0.0, 0.95),
    min_bandwidth_hz=Limits(0.0),
    noise_share=Limits(0.0, 1.0, is_open=True),
)
def design(
    engine: str | Path | None = None,
    aircraft: str | Path = "hexjet",
    *,
    controller: str = "auto",
    model: str | Path | None = None,
    amplitude: float | None = None,
    max_sensitivity: float = 1.7,
    delay_tolerance: float | None = None,
    gain_tolerance: float | None = None,
    engine_spread: float | None = None,
    min_bandwidth_hz: float = 0.16,
    noise_share: float = 0.0833,
    autopilot: Literal["betaflight", "px4", "ardupilot"] | None = None,
    lead: bool = True,
    scheduled: bool = True,
    start: str | Path | None = None,
    proof: bool = True,
    limit: bool = False,
    settings: Sequence[str] | Mapping[str, object] = (),
    out: str | Path | None = None,
    progress: Progress | None = None,
) -> DesignResult:
    """Design a controller for an engine on an aircraft: predictor, its model, and the gains of all axes.

    A design ends with its proof: the loops with the engine's own response, and hover, gust, and doublets to the lean
    that the pilot may ask for, flown with noise, at the corners of the tolerances and with one engine off.  A
    controller that flies as designed is written though its proof failed, marked as not proved.

    Parameters
    ----------
    engine : str or Path or None
        A name, an FMU or its mapping file; None: the aircraft's own.
    aircraft : str or Path
        A name or a folder.
    controller : str
        One of the predictors, ``auto`` for the best of them, or ``optimal``: the controller at the limit of
        performance, of low order.
    model : str or Path or None
        A TOML file with identified models, taken instead of what engine and airframe make together.
    amplitude : float or None
        Amplitude of the engine's chirp, in throttle, more where the flight will reach its limits; None: 0.005.
    max_sensitivity : float
        The largest peak of |S|.
    delay_tolerance : float or None
        Share of the delay that it may be off, both ways; None: as the engine's ``[uncertainty]``, or 0.3.
    gain_tolerance : float or None
        Share of the gain that it may be off, both ways; None: as of the delay.
    engine_spread : float or None
        Share of gain and lag by which one engine is off in the proof; None: as the engine's ``[uncertainty]``, or 0.3,
        at most the gain's tolerance where that is not the engine's.
    min_bandwidth_hz : float
        Least bandwidth of roll and pitch [Hz].
    noise_share : float
        One standard deviation of sensor noise in a command, as a share of its room.
    autopilot : str or None
        Design gains for that autopilot's own loops, with their filters, delays and units.
    lead : bool
        Try a lead against the engine's lag.
    scheduled : bool
        Let gains follow the thrust where fuel burns and a full tank's do not fit.
    start : str or Path or None
        A controller file: the search begins at its gains, for its candidate alone.
    proof : bool
        End with the proof: measured past the crossover, flown at the corners of the tolerances.
    limit : bool
        Compare each axis with the best that any linear controller could do; a minute.
    settings : sequence of str or mapping
        Written over a plain hover.
    out : str or Path or None
        A folder, or the name of the controller file, ``.toml``, with the page beside it; None: nothing is written.
    progress : Progress or None
        Hears what is being done.

    Returns
    -------
    DesignResult
        Whether there is one, its margins and its proof.

    Raises
    ------
    InputError
        For an unknown name, a vehicle that the engines do not lift, or an engine that does not answer.
    """
    from cosim.simulation.controllers.controller_file import LAW, Requirements
    from hexjet_design.design import add_limits
    from hexjet_design.design import design as make
    from hexjet_design.loop.programme import need_solver
    from hexjet_design.proof.run import add_proof

    hears, texts = progress or Progress(), as_settings(settings)
    trust_named_code([*texts, engine], Path())
    if out is not None:
        prepare(Path(out))
    limit = limit or controller == LAW
    if limit:
        need_solver()
    name, vehicle = engine_for(str(aircraft), None if engine is None else str(engine)), str(aircraft)
    for line in list_fmu_defects(name):
        hears.note(line)
    firmware: Firmware | None = None
    if autopilot is not None:
        firmware, controller = _load_firmware(autopilot, vehicle, texts, controller, start)
        lead = scheduled = proof = False
    spans = {"delay_tolerance": delay_tolerance, "gain_tolerance": gain_tolerance, "engine_spread": engine_spread}
    need = Requirements(
        **{key: value for key, value in spans.items() if value is not None},
        max_sensitivity=max_sensitivity,
        min_bandwidth_hz=min_bandwidth_hz,
        noise_share=noise_share,
    )

    def report_progress(text: str) -> None:
        hears.update(text, 0, 1)

    seek = partial(
        make,
        name,
        vehicle,
        controller=controller,
        need=need,
        settings=texts,
        model=None if model is None else Path(model),
        amplitude=amplitude,
        lead=lead,
        scheduled=scheduled,
        start=None if start is None else Path(start),
        firmware=firmware,
        say=report_progress,
    )
    designed = seek()
    if proof:
        designed = add_proof(designed, report_progress, lambda unsure: seek(unsure=unsure))
    if limit and designed.is_written:
        designed = add_limits(designed, report_progress)
    chosen = [("aircraft", vehicle)] if vehicle != "hexjet" else []
    chosen += [] if engine is None else [("engine", str(engine))]
    result = DesignResult(designed, autopilot, [*chosen, *(("set", text) for text in texts)])
    return result if out is None else result.write(out)


def _load_firmware(
    autopilot: str, aircraft: str, settings: Sequence[str], controller: str, start: str | Path | None
) -> tuple[Firmware, str]:
    """Return an autopilot's own loops, and the controller that is designed for them.  Raises InputError."""
    from cosim.control.predictors.registry import BASELINE

    if controller not in ("auto", BASELINE.name) or start is not None:
        raise InputError(f"autopilot {autopilot}: has no predictor of ours; leave controller and start out")
    return _load_autopilot_hook("autopilot_loops", autopilot)(autopilot, aircraft, settings), BASELINE.name


def _load_autopilot_hook(hook: str, autopilot: str) -> Any:
    """Return a function of the tool for autopilots.  Raises InputError if the tool is not installed."""
    if (function := load_hook(hook)) is None:
        raise InputError(f"autopilot {autopilot}: hexjet_sitl is not installed, which knows its loops and parameters")
    return function


def prepare(out: Path) -> Path:
    """Make the folder of a controller file, ``out`` or ``controller.toml`` in it, and return the file.

    Raises InputError where it cannot be made, and for a file that no design left there.
    """
    from cosim.base.storage.toml import read_toml

    file = out if out.suffix.lower() == ".toml" else out / "controller.toml"
    page = file.with_suffix(".html")
    if file.exists() and not {"controller", "design"} <= read_toml(file).keys():
        raise InputError(f"out: {file}: is there already, and is no file of hexjet design; choose another name")
    if page.exists() and " control design</title>" not in read_text(page)[:4096]:
        raise InputError(f"out: {page}: is there already, and is no page of hexjet design; choose another name")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"out: {file}: cannot be written to: {error.strerror or error}") from error
    return file
