"""Loading of an engine by name or file, measured and ready for a bank."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from cosim.base.errors import EngineError, InputError, nearest
from cosim.engine.fmu.air import STANDARD_AIR, Air
from cosim.engine.fmu.instance import InstanceError
from cosim.engine.fmu.mapping import is_mapping
from cosim.engine.fmu.port_kinds import AMBIENT
from cosim.engine.fmu.uncertainty import ParameterRange, Uncertainty
from cosim.engine.fmu.variables import Variable
from cosim.engine.measure import EngineMeasurement, measure_once
from cosim.engine.response import ResponseError, settling_window
from cosim.engine.rundown import MODELLED, FlameOutLaw, make_flame_out_law
from cosim.engine.source import EngineSource, check_whole_steps, find_source, resolve_parameters
from cosim.engine.spec import EngineSpec, file_label


def load_unchecked(
    name_or_path: str,
    parameters: Mapping[str, float],
    step: float,
    *,
    measured: EngineMeasurement | None = None,
    air: Air = STANDARD_AIR,
    measure_foreign: Callable[[str, Mapping[str, float], float, Air], EngineMeasurement] | None = None,
    source: EngineSource | None = None,
) -> EngineSpec:
    """Find, validate and measure an engine that will be stepped by ``step`` seconds.

    The engine is an FMI 2.0 or 3.0 co-simulation FMU, by its name in the library, by path, or by the path of a mapping
    file; see ``cosim.engine.fmu.mapping`` for it, ``ports`` for how its ports are found.

    ``measured``: the result of an earlier measurement.  ``measure_foreign``: measures the engine, from the other
    arguments, where this process should not.  ``source``: the engine, where it was found before.

    ``air``: in which it is measured, if it has a port for any of it; without one it is the same in every air.

    Raises InputError: one line that names the engine, what is wrong, and what is allowed.
    """
    source = source or find_source(name_or_path)
    archive, engine, mapping = source.archive, source.engine, source.mapping
    check_whole_steps(archive, engine, step)
    if not any(port in archive.ports for port in AMBIENT):
        air = STANDARD_AIR
    resolved, settings = resolve_parameters(source, parameters)
    uncertainty, ledger = source.uncertainty, engine.ledger if engine else {}
    delay = resolved.get(ledger.get("delay", ""))
    try:
        if measured is None and measure_foreign is not None:
            measured = measure_foreign(name_or_path, parameters, step, air)
            if engine is not None:
                measured = measured._replace(small=None)
        elif measured is None:
            measured = measure_once(archive, settings, archive.start, step, air, small=engine is None)
    except (EngineError, InstanceError, ResponseError) as error:
        raise InputError(f"{archive.path}: {error}") from error
    return EngineSpec(
        name=name_or_path if engine else file_label(source.path),
        title=engine.title if engine else mapping.title or archive.model,
        library=engine is not None,
        path=archive.path,
        fmi=archive.version,
        sha256=archive.sha256,
        parameters=resolved,
        curve=measured.curve,
        internal_step=engine.internal_step if engine else archive.internal_step,
        pole=resolved.get(ledger.get("pole", "")),
        delay_samples=None if delay is None else round(delay),
        start=measured.start,
        rotor_inertia=engine.rotor_inertia if engine else mapping.rotor.inertia_kg_m2,
        flame_out=_flame_out(source),
        specified_delay=mapping.ledger.delay_s,
        mapping=source.path if is_mapping(source.path) else None,
        archive=archive,
        settings=settings,
        settling_window=settling_window(measured.response.delay),
        quiet=measured.quiet,
        air=air,
        isolated=bool(mapping.isolated),
        small_step=measured.small,
        logged_outputs=_logged(source),
        uncertainty=uncertainty,
        uncertain_ranges=() if uncertainty is None else _uncertain_ranges(source, uncertainty),
    )


def _logged(source: EngineSource) -> tuple[tuple[str, Variable], ...]:
    """Return the outputs that a mapping file adds to the log, by column name."""
    columns = []
    for name, output in source.mapping.log.items():
        where = f"{source.path}: log.{name} = {output!r}"
        matches = [v for v in source.archive.outputs if v.name == output]
        if not matches:
            known = [v.name for v in source.archive.outputs]
            raise InputError(f"{where}: no such output; {nearest(output, known)}")
        if not name.isidentifier() or not name.isascii():
            raise InputError(f"{where}: a column's name is of letters, digits and _, no digit first")
        columns.append((name, matches[0]))
    return tuple(columns)


def _uncertain_ranges(source: EngineSource, uncertainty: Uncertainty) -> tuple[ParameterRange, ...]:
    nominal, _ = resolve_parameters(source, {})
    return tuple(uncertainty.ranges(nominal, source.archive.parameters))


def _flame_out(source: EngineSource) -> FlameOutLaw | None:
    if "run" in source.archive.ports:
        return MODELLED
    if source.engine is not None:
        return make_flame_out_law(source.engine.flame_out) if source.engine.flame_out else None
    return source.mapping.flame_out.law() if source.mapping.flame_out else None
