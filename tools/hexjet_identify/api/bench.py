"""An engine from its bench logs: what ``hexjet identify bench`` calls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from cosim.api.call import FolderResult, Limits, Table, checked
from cosim.api.call.choices import as_settings
from cosim.base.errors import InputError
from cosim.base.trust import mention
from cosim.identify.page import WITH_BOUNDS

if TYPE_CHECKING:
    from hexjet_identify.bench import BenchIdentification, BenchRecord, Choices
    from hexjet_identify.bench.grey_box import GreyIdentification


class BenchIdentifyResult(FolderResult):
    """An engine from its bench logs.

    ``write`` leaves ``identification.json``, ``report.html`` and, where there is one, an engine with its uncertainty.

    Attributes
    ----------
    identification : BenchIdentification or GreyIdentification
        Everything; the second of an engine whose own parameters were fitted.
    """

    def __init__(self, identification: BenchIdentification | GreyIdentification) -> None:
        self.identification = identification
        self.files = {}

    @property
    def found(self) -> bool:
        """Whether the logs tell a model that explains them."""
        from hexjet_identify.bench import BenchIdentification

        found = self.identification
        return not found.refused if isinstance(found, BenchIdentification) else found.leaves_engine

    def _write(self, folder: Path) -> dict[str, Path]:
        from hexjet_identify.bench import BenchIdentification, grey_box_result, result

        found = self.identification
        if isinstance(found, BenchIdentification):
            return result.write(found, folder)
        return grey_box_result.write(found, folder)

    def to_dict(self) -> dict[str, Any]:
        """Return what ``hexjet identify bench --json`` prints."""
        return self.identification.to_dict()

    def lines(self) -> list[str]:
        """Return what the logs came to, what they do not tell, and notes."""
        from hexjet_identify.bench import BenchIdentification, grey_box_result, result

        found = self.identification
        notes = [f"note: {note}" for note in found.notes]
        untold = [f"not told: {line}" for line in found.untold]
        if not isinstance(found, BenchIdentification):
            refused = [] if found.leaves_engine else ["no engine: with these parameters it does not explain the log"]
            return [grey_box_result.summary(found), *notes, *untold, *refused]
        reason = result.why_no_engine(found)
        return [result.summary(found), *notes, *untold, *([f"no engine: {reason}"] if reason else [])]

    def tables(self) -> list[Table]:
        """Return the parameters of each form with their bounds."""
        from hexjet_identify.bench import BenchIdentification, grey_box_result, result

        found = self.identification
        if not isinstance(found, BenchIdentification):
            return [Table("", (WITH_BOUNDS, found.choices.engine), grey_box_result.rows(found))]
        return [Table("", (WITH_BOUNDS, *(each.form.label for each in found.estimates)), result.rows(found))]

    def _figures(self) -> Mapping[str, Any]:
        from hexjet_identify.bench import BenchIdentification, grey_box_result, result

        found = self.identification
        page = result.page(found) if isinstance(found, BenchIdentification) else grey_box_result.page(found)
        return page.figures


@checked(longest_delay_s=Limits(0.0, 4.0, is_open=True))
def identify_bench(
    *logs: str | Path,
    command: str | None = None,
    output: str | None = None,
    throttle_range: tuple[float, float] | None = None,
    between: Literal["auto", "held", "straight"] = "auto",
    longest_delay_s: float = 2.0,
    engine: str | Path | None = None,
    fit: Sequence[str] = (),
    settings: Sequence[str] | Mapping[str, object] = (),
    time_column: str | None = None,
    time_unit: str | None = None,
    begin: float | None = None,
    end: float | None = None,
    out: str | Path | None = None,
) -> BenchIdentifyResult:
    """Identify an engine from its bench logs: delay, one lag or two, gain and static curve, with bounds.

    With ``engine`` the parameters of that one are fitted instead: a turbine and its ECU.

    Parameters
    ----------
    *logs : str or Path
        CSV, Parquet or TDMS, of one engine: whatever moved the throttle.
    command : str or None
        Throttle or set-point; None: the column called so.
    output : str or None
        Thrust or speed; None: the column called so.
    throttle_range : tuple of float or None
        What throttle 0 and 1 are in the log.
    between : str
        What the command does between two rows: ``held``, ``straight``, or ``auto``, by how it moves.
    longest_delay_s : float
        Longest delay that is looked for [s].
    engine : str or Path or None
        Engine whose parameters are fitted: a name, an FMU or its mapping file.
    fit : sequence of str
        Which, beside the delay, which always is.
    settings : sequence of str or mapping
        Parameters that are set, or where they begin.
    time_column : str or None
        A table's column of time.
    time_unit : str or None
        Unit of that column: s, ms, us, ns, min, h or d.
    begin : float or None
        The logs are used from here on, in their own time [s].
    end : float or None
        And to here [s].
    out : str or Path or None
        A folder for engine, page and data; without it nothing is written.

    Returns
    -------
    BenchIdentifyResult
        The models with their bounds, and whether one explains the logs.

    Raises
    ------
    InputError
        For logs that cannot be read, or that do not move enough.
    """
    from cosim.base.storage.files import check_results_folder
    from cosim.identify.files import FILES, RECORD
    from hexjet_identify.bench import Choices, Columns, read_records
    from hexjet_identify.bench import identify_bench as identify
    from hexjet_identify.bench.beyond_lags import fit_beyond_lags

    check_results_folder(out, RECORD, *FILES)
    if not logs:
        raise InputError("identify_bench: logs: name one at least")
    if engine is None and (fit or settings):
        raise InputError("--fit and settings (--set) are for an engine's parameters; name it with --engine")
    records = read_records([*map(Path, logs)], Columns(command, output, time_column, time_unit, begin, end))
    choices = Choices(throttle_range, between, longest_delay_s)
    found: BenchIdentification | GreyIdentification
    if engine is not None:
        texts = as_settings(settings)
        mention([*texts, engine], Path())
        found = _fit_engine(records, str(engine), fit, texts, choices)
    else:
        lags = identify(records, choices)
        found = fit_beyond_lags(lags, longest_delay_s) or lags
    result = BenchIdentifyResult(found)
    return result if out is None else result.write(out)


def _fit_engine(
    records: list[BenchRecord], engine: str, fitted: Sequence[str], settings: Sequence[str], choices: Choices
) -> GreyIdentification:
    """Return the parameters of an engine as fitted.  Raises InputError where no throttle range is known."""
    from cosim.files import parse_numbers
    from hexjet_identify.bench.grey_box import fit_engine
    from hexjet_identify.bench.grey_model import GreyChoices
    from hexjet_identify.bench.identify import is_straight, throttle_limits
    from hexjet_identify.bench.running import SPEED_UNITS

    notes: list[str] = []
    limits = (0.0, 1.0)
    if records[0].command_unit not in SPEED_UNITS:
        limits, known = throttle_limits(records, choices.limits, notes)
        if not known:
            raise InputError(f"{records[0].path}: what throttle 0 and 1 are is not known: --throttle-range LOW HIGH")
    straight = is_straight(records, choices.between, notes)
    numbers = parse_numbers(tuple(settings), "settings (--set)")
    stated = GreyChoices(engine, tuple(fitted), numbers, limits, straight, choices.longest_delay)
    found = fit_engine(records, stated)
    return replace(found, notes=(*found.notes, *notes))
