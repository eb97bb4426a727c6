"""Generated text of an engine's archive: the C header of its variables, and both model descriptions."""

from __future__ import annotations

from collections.abc import Iterable
from xml.etree import ElementTree

from .definition import EngineDefinition, VariableDefinition
from .unit_table import UNITS

GENERATION_TOOL = "hexjet-cosim"  # named in modelDescription.xml
TIME = VariableDefinition("time", 0, "independent", False, "s", None, None, None, "Simulated time")


def _to_c_literal(value: float | None, default: str) -> str:
    return default if value is None else repr(value)


def _table_row(v: VariableDefinition) -> str:
    kind = f'"{v.name}", {v.causality.upper()}, {"INTEGER" if v.integer else "REAL"}, offsetof(Variables, {v.name})'
    limits = f"{_to_c_literal(v.min, '-HUGE_VAL')}, {_to_c_literal(v.max, 'HUGE_VAL')}, {_to_c_literal(v.start, '0.0')}"
    return f"    {{{kind}, {limits}}}"


def render_variables_header(engine: EngineDefinition, token: str) -> str:
    """Return the text of ``variables.h``, the data of ``engine.toml`` that the C code needs."""
    fields = [f"    {'int32_t' if v.integer else 'double'} {v.name};" for v in engine.variables]
    limits = [f"#define {v.name.upper()}_MAX {int(v.max)}" for v in engine.variables if v.integer and v.max is not None]
    return "\n".join(
        [
            "/* Generated from engine.toml: do not edit. */",
            "#ifndef VARIABLES_H",
            "#define VARIABLES_H",
            "",
            "#include <stdint.h>",
            "",
            f'#define ENGINE_TOKEN "{token}"',
            f"#define ENGINE_STEP {engine.internal_step!r}",
            *limits,
            "",
            "typedef struct {",
            *fields,
            "} Variables;",
            "",
            "/* name, causality, type, offset, min, max, start; the first has value reference 1 */",
            "#define ENGINE_TABLE \\",
            ", \\\n".join(map(_table_row, engine.variables)),
            "",
            "#endif",
            "",
        ]
    )


def _to_xml(root: ElementTree.Element) -> bytes:
    ElementTree.indent(root)
    return bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)) + b"\n"


def _add(parent: ElementTree.Element, tag: str, **attributes: str | None) -> ElementTree.Element:
    """Add an XML element, without attributes that are None."""
    return ElementTree.SubElement(parent, tag, {key: text for key, text in attributes.items() if text is not None})


def _make_root(engine: EngineDefinition, version: str, **token: str) -> ElementTree.Element:
    return ElementTree.Element(
        "fmiModelDescription",
        {
            "fmiVersion": version,
            "modelName": engine.name,
            **token,
            "description": f"{engine.title}: {engine.description}",
            "generationTool": GENERATION_TOOL,
            "variableNamingConvention": "flat",
        },
    )


def _add_head(root: ElementTree.Element, engine: EngineDefinition) -> ElementTree.Element:
    """Add the elements of units, log categories and default experiment; return the element for the variables."""
    definitions = _add(root, "UnitDefinitions")
    for unit in sorted({"s", *(v.unit for v in engine.variables if v.unit)}):
        base = {key: repr(x) if key == "factor" else str(int(x)) for key, x in UNITS[unit].items()}
        _add(_add(definitions, "Unit", name=unit), "BaseUnit", **base)
    categories = _add(root, "LogCategories")
    _add(categories, "Category", name="logStatusError", description="Why a function returned an error")
    _add(root, "DefaultExperiment", startTime="0", stepSize=repr(engine.internal_step))
    return _add(root, "ModelVariables")


def _identity(v: VariableDefinition) -> dict[str, str]:
    return {
        "name": v.name,
        "valueReference": str(v.reference),
        "causality": v.causality,
        "variability": "fixed" if v.causality == "parameter" else "continuous",
        "description": v.description,
    }


def _value(v: VariableDefinition) -> dict[str, str | None]:
    """Return the XML attributes of a variable's value: unit, limits and start."""
    numbers = {"min": v.min, "max": v.max, "start": v.start}
    texts = {key: str(int(x)) if v.integer else repr(x) for key, x in numbers.items() if x is not None}
    return {"unit": v.unit, **texts}


def render_model_description_3(engine: EngineDefinition, token: str) -> bytes:
    """Return ``modelDescription.xml`` of the FMI 3.0 archive."""
    root = _make_root(engine, "3.0", instantiationToken=token)
    # The two step attributes of FMI 3.0 together say what this slave does: the step may vary from call to call and
    # should be a whole multiple of the internal step.
    _add(
        root,
        "CoSimulation",
        modelIdentifier=engine.identifier,
        needsExecutionTool="true" if engine.tool else None,
        canGetAndSetFMUState=None if engine.tool else "true",
        canSerializeFMUState=None if engine.tool else "true",
        canHandleVariableCommunicationStepSize="true",
        fixedInternalStepSize=repr(engine.internal_step),
    )
    variables = _add_head(root, engine)
    for v in (TIME, *engine.variables):
        _add(variables, "Int32" if v.integer else "Float64", **_identity(v), **_value(v))
    structure = _add(root, "ModelStructure")
    outputs = [str(v.reference) for v in engine.variables if v.causality == "output"]
    for reference in outputs:
        # Between steps the outputs depend on the state alone: there is no direct feed-through.
        _add(structure, "Output", valueReference=reference, dependencies="")
    for reference in outputs:
        _add(structure, "InitialUnknown", valueReference=reference)
    return _to_xml(root)


def render_model_description_2(engine: EngineDefinition, token: str, sources: Iterable[str]) -> bytes:
    """Return ``modelDescription.xml`` of the FMI 2.0 archive, which lists the C ``sources``."""
    root = _make_root(engine, "2.0", guid=token)
    # FMI 2.0 cannot state an internal step, so "variable step" would promise more than the slave provides.
    slave = _add(
        root,
        "CoSimulation",
        modelIdentifier=engine.identifier,
        needsExecutionTool="true" if engine.tool else None,
        canHandleVariableCommunicationStepSize="false",
        canNotUseMemoryManagementFunctions="true",
        canGetAndSetFMUstate=None if engine.tool else "true",
        canSerializeFMUstate=None if engine.tool else "true",
    )
    files = _add(slave, "SourceFiles")
    for name in sources:
        _add(files, "File", name=name)
    variables = _add_head(root, engine)
    for v in (TIME, *engine.variables):
        _add(_add(variables, "ScalarVariable", **_identity(v)), "Integer" if v.integer else "Real", **_value(v))
    structure = _add(root, "ModelStructure")
    indices = [str(v.reference + 1) for v in engine.variables if v.causality == "output"]  # counted from 1
    outputs = _add(structure, "Outputs")
    for index in indices:
        _add(outputs, "Unknown", index=index, dependencies="")
    unknowns = _add(structure, "InitialUnknowns")
    for index in indices:
        _add(unknowns, "Unknown", index=index)
    return _to_xml(root)


def render_build_description(engine: EngineDefinition, sources: Iterable[str]) -> bytes:
    """Return ``buildDescription.xml`` of the FMI 3.0 archive, which lists the C ``sources``."""
    root = ElementTree.Element("fmiBuildDescription", {"fmiVersion": "3.0"})
    files = _add(_add(root, "BuildConfiguration", modelIdentifier=engine.identifier), "SourceFileSet", language="C99")
    for name in sources:
        _add(files, "SourceFile", name=name)
    return _to_xml(root)
