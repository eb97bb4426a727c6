"""An engine from its bench logs: what ``hexjet engine from-bench`` calls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from cosim.api.call import Limits, check_types
from cosim.base.errors import InputError
from cosim.base.storage.settings import as_settings
from cosim.base.trust import trust_named_code

if TYPE_CHECKING:
    from hexjet_identify.bench.result import BenchIdentifyResult


@check_types(longest_delay_s=Limits(0.0, 4.0, is_open=True))
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
    """Identify an engine from its bench logs: static line, delay, lags, limits of rise and fall, with bounds.

    Says first whether the model explains the logs, then what they do not tell, and the next test.  Leaves a page,
    identification.json and, of a thrust in N, an engine with its uncertainty.  With ``engine`` the parameters of that
    one are fitted instead: a turbine and its ECU.

    >>> import numpy as np
    >>> from scipy.signal import lfilter
    >>> times, noise = np.arange(0.0, 15.0, 0.01), np.random.default_rng(1).normal(0.0, 0.02, 1500)
    >>> throttle = 0.3 + 0.2 * (times % 3.0 > 1.5)
    >>> rows = np.stack([times, throttle, lfilter([0.0, 2.0], [1.0, -0.9], throttle) + noise], axis=1)
    >>> np.savetxt("bench.csv", rows, delimiter=",", header="time_s,throttle,thrust_N", comments="")
    >>> identify_bench("bench.csv").verdict
    'explained to 0.11 % of the range, 27 of 27 times within 10 %'

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
        Its parameters that are fitted, beside the delay, which always is.
    settings : sequence of str or mapping
        Parameters that are set, or where they begin.
    time_column : str or None
        A table's column of time; None: the one called so.
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
    from cosim.files import parse_numbers
    from cosim.identify.files import FILES, RECORD
    from hexjet_identify.bench import Choices, Columns, read_records
    from hexjet_identify.bench import identify_bench as identify
    from hexjet_identify.bench.engine_form import EngineChoices
    from hexjet_identify.bench.own_parameters import fit_engine
    from hexjet_identify.bench.result import BenchIdentifyResult

    check_results_folder(out, RECORD, *FILES)
    if not logs:
        raise InputError("identify_bench: logs: name one at least")
    if engine is None and (fit or settings):
        raise InputError("identify_bench: fit and settings are for an engine's parameters; name the engine")
    records = read_records([*map(Path, logs)], Columns(command, output, time_column, time_unit, begin, end))
    choices = Choices(throttle_range, between, longest_delay_s)
    if engine is None:
        found = identify(records, choices)
    else:
        texts = as_settings(settings)
        trust_named_code([*texts, engine], Path())
        numbers = parse_numbers(tuple(texts), "settings")
        found = fit_engine(records, EngineChoices(str(engine), tuple(fit), numbers), choices)
    result = BenchIdentifyResult(found)
    return result if out is None else result.write(out)
