"""Reading of model descriptions: harmless violations of FMI are listed, ambiguous descriptions are refused.

Of the descriptions that tools export a fifth break a rule of FMI that no step depends on: a unit that is used and not
declared, a variability that is left out.  Such an FMU steps as any other, so FMPy is asked a second time without its
validation, and what that had to say is kept for the user.  Refused stays what decides which number is read or set:
names or references that stand for two variables, and elements or attributes of variables and of the co-simulation
interface that are not as FMI has them.
"""

from __future__ import annotations

import io
import re
import zipfile
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any
from xml.etree import ElementTree

from cosim.engine.fmu.container import BUILD_DESCRIPTION, DESCRIPTION, UnusableError, Zip, to_one_line

# Patterns of FMPy's complaints about parts of a description that no step depends on.
HARMLESS_VIOLATIONS = tuple(
    re.compile(text)
    for text in (
        r'^The (display )?unit ".*" of (the )?variable .* is not defined',
        r"is of type \w+ and must have variability",
        r"^Variable .* has no start value",
        r"^The combination causality=.* and variability=.* is not allowed",
        r"has initial=\"calculated\" but provides a start value",
        r"has causality=\"independent\" but provides a start value",
        r"^Exactly one independent variable must be defined",
        r"^ModelStructure",
        r"dependenciesKind",
        r"contains an illegal (carriage return|line feed|tab) character",
        r"is not a legal variable name",
        r"and must be declared as a local or output",  # rule on states, which are not read
        # Patterns for schema rules about attributes that are not read here.
        r"The attribute '\w+' is not allowed",
        r"Element 'fmiModelDescription', attribute '(generationDateAndTime|variableNamingConvention|version)'",
        r"Element '(ModelStructure|Outputs|Derivatives|InitialUnknowns|Unknown|Output|InitialUnknown|LogCategories|"
        r"Category|VendorAnnotations|Tool|Annotations|Annotation|DisplayUnit|DefaultExperiment|SourceFiles|File)'",
        r"Element '(UnitDefinitions|TypeDefinitions)': This element is not expected",
    )
)


def is_harmless_violation(complaint: str) -> bool:
    """Return whether a complaint of FMPy's validation is about something that stepping does not depend on."""
    return any(pattern.search(complaint) for pattern in HARMLESS_VIOLATIONS)


def read_description(data: bytes) -> tuple[Any, tuple[str, ...]]:
    """Return FMPy's object of an archive's model description, and the harmless violations found in it.

    Raises UnusableError with the first complaint that is none.
    """
    from fmpy.model_description import ValidationError, read_model_description  # type: ignore[import-untyped]

    complaints: list[str] = []
    stumbled = ""
    try:
        return read_model_description(pack_descriptions(data)), ()
    except ValidationError as error:
        complaints = [to_one_line(problem) for problem in error.problems]
    except Exception as error:  # FMPy raises plain exceptions
        stumbled = to_one_line(error)
    try:
        description = read_model_description(pack_descriptions(data, add_missing_initial), validate=False)
    except Exception as error:
        raise _explain_refusal(complaints) if complaints else _make_unusable_error(error) from error
    more = _validate_model(description)
    if more is not None:
        complaints += [complaint for complaint in more if complaint not in complaints]
    elif undeclared := _find_undefined_unit(description):
        complaints.append(undeclared)
    elif stumbled:
        raise _make_unusable_error(stumbled)
    if dangerous := [
        complaint for complaint in [*_repeated_names(description), *complaints] if not is_harmless_violation(complaint)
    ]:
        raise _explain_refusal(dangerous)
    for v in description.modelVariables:
        if (v.causality, v.variability) == ("parameter", "constant"):
            v.causality = "local"  # nobody can set it, so it is a local
    return description, tuple(complaints)


# Causalities by variability that FMI has a default of ``initial`` for.
_CAUSALITIES = {
    "constant": {"output", "local"},
    "fixed": {"structuralParameter", "parameter", "calculatedParameter", "local"},
    "tunable": {"structuralParameter", "parameter", "calculatedParameter", "local"},
    "discrete": {"input", "output", "local"},
    "continuous": {"input", "output", "local", "independent"},
}


def add_missing_initial(xml: bytes) -> bytes:
    """Return a description with ``initial`` added to variables that FMI has no default of it for.

    FMPy, asked without its validation too, reads no description with a parameter that is constant, say, which tools
    write; what its validation says of that is a blemish.
    """
    root = ElementTree.fromstring(xml)
    changed = False
    for v in root.iterfind("ModelVariables/*"):
        varies, cause = v.get("variability"), v.get("causality", "local")
        if root.get("fmiVersion") == "2.0" and varies is None:
            varies = "continuous"
        if varies is not None and v.get("initial") is None and cause not in _CAUSALITIES.get(varies, {cause}):
            v.set("initial", "exact")
            changed = True
    return ElementTree.tostring(root, encoding="utf-8") if changed else xml


def pack_descriptions(data: bytes, change: Callable[[bytes], bytes] = bytes) -> io.BytesIO:
    """Return a new archive of the two descriptions that FMPy reads, ``change`` applied to the model description.

    They have the names that FMI prescribes, whatever system packed the original.
    """
    buffer = io.BytesIO()
    with Zip(io.BytesIO(data)) as source, zipfile.ZipFile(buffer, "w") as target:
        target.writestr(DESCRIPTION, change(source.read(DESCRIPTION)))
        if BUILD_DESCRIPTION in source.namelist():
            target.writestr(BUILD_DESCRIPTION, source.read(BUILD_DESCRIPTION))
    buffer.seek(0)
    return buffer


def _explain_refusal(complaints: Sequence[str]) -> UnusableError:
    more = f" (and {len(complaints) - 1} more)" if len(complaints) > 1 else ""
    return UnusableError(f"modelDescription.xml is not valid: {complaints[0]}{more}")


def _make_unusable_error(error: object) -> UnusableError:
    return UnusableError(f"modelDescription.xml cannot be used: {to_one_line(error)}")


def _validate_model(description: Any) -> list[str] | None:
    """Return the complaints of FMPy's validation of the model; None if FMPy fails."""
    from fmpy.validation import validate_model_description  # type: ignore[import-untyped]

    try:
        return [to_one_line(complaint) for complaint in validate_model_description(description)]
    except Exception:
        return None


def _find_undefined_unit(description: Any) -> str:
    """Return a complaint about a display unit whose unit is undefined, on which FMPy fails; else ""."""
    defined = {unit.name for unit in description.unitDefinitions}
    for v in description.modelVariables:
        unit = v.unit or (v.declaredType.unit if v.declaredType else None)
        if v.displayUnit is not None and unit not in defined:
            return f'The unit "{unit}" of variable "{v.name}" (line {v.sourceline}) is not defined'
    return ""


def _repeated_names(description: Any) -> list[str]:
    """Return a complaint about each variable name that is used twice."""
    names = Counter(v.name for v in description.modelVariables)
    return [f'The variable name "{to_one_line(name)}" is not unique' for name, count in names.items() if count > 1]
