"""A model from a sweep, of an axis in flight or of an engine: what ``hexjet identify`` calls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from cosim.api.call import FolderResult, Limits, Table, check_types, note_lines
from cosim.base.errors import InputError
from cosim.base.storage.settings import as_settings
from cosim.base.trust import trust_named_code

if TYPE_CHECKING:
    from cosim.identify.sweep import Identification
    from cosim.spec.vehicle import RateModel

Subject = Literal["roll", "pitch", "yaw", "engine"]


class IdentifyResult(FolderResult):
    """Measured response and the models fitted to it.

    ``identification`` has everything; ``write`` leaves ``identification.json``, ``response.csv``, ``report.html`` and,
    of an axis, ``model.toml``.
    """

    def __init__(self, identification: Identification) -> None:
        self.identification = identification
        self.files = {}

    @property
    def found(self) -> bool:
        """Whether a model could be identified from the response."""
        return not self.identification.refused

    @property
    def model(self) -> RateModel:
        """Chosen model of the response, in discrete time."""
        return self.identification.model

    def _write(self, folder: Path) -> dict[str, Path]:
        from cosim.identify.sweep import write

        return write(self.identification, folder)

    def to_dict(self) -> dict[str, Any]:
        return self.identification.to_dict()

    def lines(self) -> list[str]:
        """Return lines on the sweep, on the model or why there is none, and on the delay ledger's comparison."""
        from cosim.identify.sweep.result import equations

        found = self.identification
        sweep = found.sweep
        swept = (
            f"{found.subject}: {found.channel}, {sweep.from_hz:.3g} to {sweep.to_hz:.3g} Hz in {sweep.duration_s:g} s"
        )
        model = [f"no model: {reason}" for reason in found.refused] or [f"G(z) = {text}" for text in equations(found)]
        ledger = []
        if found.ledger_samples is not None:
            ledger = [f"all delay as the delay ledger has it: {found.ledger_samples:.2f} samples"]
        elif found.no_ledger:
            ledger = [f"the delay ledger has no sum for it: {found.no_ledger}"]
        return [swept, *model, *ledger, *note_lines(found.notes)]

    def tables(self) -> list[Table]:
        """Return the parameters of each model with their 95 % bounds."""
        from cosim.identify.page import WITH_BOUNDS
        from cosim.identify.sweep.result import fit_rows

        found = self.identification
        return [Table("", (WITH_BOUNDS, *(fit.label for fit in found.fits)), fit_rows(found))]

    def _figures(self) -> Mapping[str, Any]:
        from cosim.identify.sweep.page import response_figure

        return {"response": response_figure(self.identification)}


@check_types(lags=Limits(0, 2))
def identify(
    subject: Subject,
    engine: str | Path | None = None,
    *,
    aircraft: str | Path = "hexjet",
    controller: str | None = None,
    from_hz: float | None = None,
    to_hz: float | None = None,
    amplitude: float | None = None,
    duration_s: float | None = None,
    lags: int | None = None,
    hold: Mapping[str, float] | None = None,
    substeps: int | None = None,
    seed: int | None = None,
    throttle: float = 0.5,
    step_s: float = 0.004,
    settings: Sequence[str] | Mapping[str, object] = (),
    out: str | Path | None = None,
) -> IdentifyResult:
    """Identify an axis in flight, torque command to measured rate, or an engine alone, throttle to thrust.

    A chirp is added while the vehicle holds still; a pole, lags and a delay are fitted to the response.

    >>> identify("engine", "edf").found
    True

    Parameters
    ----------
    subject : str
        ``roll``, ``pitch``, ``yaw``, or ``engine``.
    engine : str or Path or None
        A name, an FMU or its mapping file; None: the aircraft's own.
    aircraft : str or Path
        Of an axis: what flies.
    controller : str or None
        Of an axis: what flies it; None: smith, or baseline where no model is known.
    from_hz : float or None
        Lowest frequency of the response [Hz]; None: as it suits, as the next three.
    to_hz : float or None
        Highest frequency of the response [Hz].
    amplitude : float or None
        Amplitude of the chirp, in the unit of the command.
    duration_s : float or None
        Duration of the chirp [s].
    lags : int or None
        Beside the slow pole; None: one of an axis, none of an engine.
    hold : mapping or None
        Parameters of the model that are not fitted, by name.
    substeps : int or None
        Of an axis: JSBSim steps in a control step.
    seed : int or None
        Of an axis: seed of the sensor noise.
    throttle : float
        Of an engine: the throttle around which it is swept.
    step_s : float
        Of an engine: its sample time [s].
    settings : sequence of str or mapping
        Of an axis: written over the scenario; of an engine: its parameters.
    out : str or Path or None
        A folder for model, page and data; without it nothing is written.

    Returns
    -------
    IdentifyResult
        The models with their bounds; whether there is one that may be used.

    Raises
    ------
    InputError
        For a band, an amplitude, an engine or a loop that does not serve.
    """
    from cosim.base.storage.files import check_results_folder
    from cosim.base.storage.toml import parse_numbers
    from cosim.identify.files import FILES, RECORD
    from cosim.identify.sweep import identify_axis, identify_engine

    check_results_folder(out, RECORD, *FILES)
    texts, name = as_settings(settings), None if engine is None else str(engine)
    trust_named_code([*texts, name], Path())
    swept: dict[str, Any] = {"from_hz": from_hz, "to_hz": to_hz, "amplitude": amplitude, "duration": duration_s}
    swept |= {"hold": hold} | ({} if lags is None else {"lags": lags})
    if subject != "engine":
        if lags == 0:
            raise InputError("identify: lags: 0; allowed: at least 1 of an axis")
        swept |= {"controller": controller, "substeps": substeps, "seed": seed, "settings": texts}
        result = IdentifyResult(identify_axis(subject, str(aircraft), name, **swept))
    elif name is None:
        raise InputError("identify: engine: name which")
    else:
        numbers = parse_numbers(tuple(texts), "settings")
        result = IdentifyResult(identify_engine(name, numbers, throttle=throttle, step=step_s, **swept))
    return result if out is None else result.write(out)
