"""Loading of an engine by name or file, measured and ready for a bank."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from cosim.base.errors import EngineError, InputError, nearest
from cosim.engine.fmu.air import STANDARD_AIR, Air
from cosim.engine.fmu.instance import InstanceError
from cosim.engine.fmu.port_kinds import AMBIENT
from cosim.engine.fmu.variables import Variable
from cosim.engine.measure import EngineMeasurement
from cosim.engine.response import ResponseError, settling_window
from cosim.engine.rundown import MODELLED, FlameOutLaw, make_flame_out_law
from cosim.engine.source import EngineSource, check_whole_steps, resolve_parameters
from cosim.engine.spec import EngineSpec


def load_unchecked(
    source: EngineSource,
    parameters: Mapping[str, float],
    step: float,
    measure: Callable[[EngineSource, Mapping[str, float], float, Air], EngineMeasurement],
    air: Air = STANDARD_AIR,
) -> EngineSpec:
    """Return an engine, validated for steps of ``step`` seconds, and measured with ``measure``.

    ``measure`` is called with the other arguments, and with the standard ``air`` where the engine has no port for any.

    Raises InputError: one line that names the engine, what is wrong, and what is allowed.
    """
    archive, definition, mapping = source.archive, source.engine, source.mapping
    check_whole_steps(archive, definition, step)
    if not any(port in archive.ports for port in AMBIENT):
        air = STANDARD_AIR
    resolved, settings = resolve_parameters(source, parameters)
    uncertainty, ledger = source.uncertainty, definition.ledger if definition else {}
    nominal = {} if uncertainty is None else resolve_parameters(source, {})[0]
    ranges = [] if uncertainty is None else uncertainty.ranges(nominal, source.archive.parameters)
    delay = resolved.get(ledger.get("delay", ""))
    try:
        measured = measure(source, parameters, step, air)
    except (EngineError, InstanceError, ResponseError) as error:
        raise InputError(f"{archive.path}: {error}") from error
    return EngineSpec(
        name=source.name,
        title=definition.title if definition else mapping.title or archive.model,
        library=definition is not None,
        path=archive.path,
        fmi=archive.version,
        sha256=archive.sha256,
        parameters=resolved,
        curve=measured.curve,
        internal_step=definition.internal_step if definition else archive.internal_step,
        pole=resolved.get(ledger.get("pole", "")),
        delay_samples=None if delay is None else round(delay),
        start=measured.start,
        rotor_inertia=definition.rotor_inertia if definition else mapping.rotor.inertia_kg_m2,
        flame_out=_make_flame_out_law(source),
        specified_delay=mapping.ledger.delay_s,
        mapping=source.path if source.path.suffix.lower() == ".toml" else None,
        archive=archive,
        settings=settings,
        settling_window=settling_window(measured.response.delay),
        ripple=measured.ripple,
        air=air,
        small_step=measured.small,
        logged_outputs=_find_logged_outputs(source),
        uncertainty=uncertainty,
        uncertain_ranges=tuple(ranges),
    )


def _find_logged_outputs(source: EngineSource) -> tuple[tuple[str, Variable], ...]:
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


def _make_flame_out_law(source: EngineSource) -> FlameOutLaw | None:
    if "run" in source.archive.ports:
        return MODELLED
    if source.engine is not None:
        return make_flame_out_law(source.engine.flame_out) if source.engine.flame_out else None
    stated = source.mapping.flame_out
    return make_flame_out_law(stated.model_dump(exclude_none=True)) if stated else None
