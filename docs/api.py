"""Pages of reference of the Python API, made of the docstrings; as a program it prints them as JSON.

In it is what a program calls, the exports of ``cosim`` and of its public modules; what it may write for a flight, the
protocols with what they are told; and the records that travel between them.  Docstrings of the first and second have
the sections of numpydoc; a field's comment is its meaning.
"""

from __future__ import annotations

import ast
import inspect
import json
import os
import re
from collections.abc import Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

if __name__ == "__main__":
    os.environ["HEXJET_PURE"] = "1"  # Compiled classes and functions have no docstrings.

import cosim
from cosim.base import protocols
from cosim.control.belief import Belief

ROOT = Path(__file__).parents[1]
SECTION = re.compile(r"^(\w+)\n-{3,}\n", re.MULTILINE)
ENTRY = re.compile(r"^(\S[^\n]*)\n((?:    [^\n]*\n?|\n(?=    ))+)", re.MULTILINE)
MODULES = ("api", "campaign", "commands", "files", "identify", "laws", "loops", "pages")
RECORDS = ("cosim/base/signals.py", "cosim/base/protocols/records.py")


def pages() -> dict[str, str]:
    """Return the pages: the exports, those of each public module, the protocols, the records."""
    exports = {name: called(name) for name in cosim.__all__}
    blocks = {name: each for name, each in vars(protocols).items() if getattr(each, "_is_protocol", False)}
    del exports["Command"]  # a record
    made = {
        "python.md": [
            "# Python: `from cosim import ...`\n\nVectors are tuples of three floats, body forward-right-down or NED "
            "as said; per jet is a tuple from jet 1 on; all is SI, angles are rad. Step `k` acts over `[t_k, t_k+1)`, "
            "`t_k = k dt`. [How it is used](../docs/python.md).\n",
            *(_about(name, each) for name, each in exports.items()),
        ]
    }
    for name in MODULES:
        module = import_module(f"cosim.{name}")
        made[f"python-{name}.md"] = [f"# Python: `from cosim.{name} import ...`\n", *_module(module)]
    made["python-protocols.md"] = [
        "# To write: `cosim.base.protocols`\n\nAny object of the right shape takes the place of a block: "
        "[ways to name it](../docs/own-controller.md#ways-to-name-it).\n",
        *(_about(name, each) for name, each in (blocks | {"Belief": Belief}).items()),
    ]
    made["python-records.md"] = [
        "# Records: `cosim.base.signals`, `cosim.base.protocols`\n\nNamed tuples: fields by name or by place.\n",
        *(_record(each, lines) for module in RECORDS for each, lines in _records(ROOT / module)),
    ]
    return {name: "\n".join(each).rstrip() + "\n" for name, each in made.items()}


def called(name: str) -> Any:
    """Return an export of the package; of a package that is called, the function."""
    export = getattr(cosim, name)
    return getattr(import_module(f"cosim.api.{name}"), name) if inspect.ismodule(export) else export


def _module(module: Any) -> Iterator[str]:
    """What a public module has: what it is about, its constants, then functions and classes."""
    yield _body(module)
    exports = {name: getattr(module, name) for name in module.__all__}
    constants = [f"`{name} = {each!r}`" for name, each in exports.items() if isinstance(each, (int, str))]
    if constants:
        yield f"Constants: {', '.join(constants)}.\n"
    for name, each in exports.items():
        if inspect.isclass(each):
            yield f"## `{name}`\n\n{_body(each)}"
        elif inspect.ismodule(each):
            own = (
                (key, value) for key, value in vars(each).items() if inspect.isclass(value) or inspect.isroutine(value)
            )
            docs = ((key, inspect.getdoc(value)) for key, value in own if value.__module__ == each.__name__)
            lines = [f"- `{name}.{key}`: {_prose(doc.splitlines()[0])}\n" for key, doc in docs if doc]
            yield f"## `{name}`\n\n{_body(each)}\n{''.join(lines)}"
        elif inspect.isroutine(each):
            yield _about(name, each)


def _about(name: str, each: Any) -> str:
    """A function; or a class, with what it has."""
    if not inspect.isclass(each):
        return f"## `{name}`\n\n{_signature(name, each)}{_body(each)}"
    shown = f"## `{name}`\n\n{_body(each)}"
    for member, value in vars(each).items():
        found = value.__func__ if isinstance(value, (classmethod, staticmethod)) else value
        if member.startswith("_") or not inspect.getdoc(found):
            continue
        if isinstance(found, property):
            shown += f"\n**`{name}.{member}`** {_prose(inspect.getdoc(found) or '')}\n"
        elif inspect.isroutine(found) and str(getattr(found, "__module__", "")).startswith(("cosim", "hexjet_")):
            shown += f"\n{_signature(f'{name}.{member}', found)}{_body(found)}"
    return shown


def _signature(name: str, each: Any) -> str:
    found = inspect.signature(each)
    told = [
        parameter.replace(annotation=inspect.Parameter.empty)
        for parameter in found.parameters.values()
        if parameter.name not in ("self", "cls")
    ]
    plain = str(found.replace(parameters=told, return_annotation=inspect.Signature.empty))
    plain = re.sub(r"<function (\w+) at [^>]*>", r"\1", plain)
    plain = re.sub(r"\w+Path\('([^']*)'\)", r'Path("\1")', plain)
    plain = re.sub(r"'(\w*)'", r'"\1"', plain)  # as the formatter of pages has it
    return f"```python\n{name}{plain}\n```\n\n"


def _body(each: Any) -> str:
    """A docstring: its prose, and the entries of its sections as a list."""
    text = inspect.getdoc(each) or ""
    prose, *sections = SECTION.split(text)
    shown = f"{_prose(prose)}\n"
    for title, body in zip(sections[::2], sections[1::2], strict=True):
        shown += f"\n{title}:\n\n"
        for head, said in ENTRY.findall(f"{body.rstrip()}\n"):
            what, _, kind = head.partition(" : ")
            shown += f"- `{what}`{f' ({kind})' if kind else ''}: {_prose(said)}\n"
    return shown


def _records(path: Path) -> Iterator[tuple[ast.ClassDef, list[str]]]:
    """The named tuples of a module, from its text: a compiled class has none."""
    text = path.read_text(encoding="utf-8")
    for node in ast.parse(text).body:
        if isinstance(node, ast.ClassDef) and any(ast.unparse(base) == "NamedTuple" for base in node.bases):
            yield node, text.splitlines()


def _record(node: ast.ClassDef, lines: Sequence[str]) -> str:
    """A named tuple: its fields with type, default and meaning."""
    rows = []
    for each in node.body:
        if isinstance(each, ast.AnnAssign):
            default = "" if each.value is None else f"`{ast.unparse(each.value)}`"
            meaning = lines[(each.end_lineno or each.lineno) - 1][each.end_col_offset or 0 :].partition("# ")[2]
            kind = ast.unparse(each.annotation).replace("|", "\\|")
            said = _prose(meaning).replace("|", "\\|")
            rows.append(f"| `{ast.unparse(each.target)}` | `{kind}` | {default} | {said} |\n")
    head = "| field | type | default | meaning |\n| --- | --- | --- | --- |\n"
    return f"## `{node.name}`\n\n{_prose(ast.get_docstring(node) or '')}\n\n{head}{''.join(rows)}"


def _prose(text: str) -> str:
    """A docstring's text on one line a paragraph, its roles, literals and examples as Markdown's code."""
    text = re.sub(r":\w+:`~?([^`]+)`", r"`\1`", text.replace("``", "`"))
    parts = inspect.cleandoc(text).split("\n\n")
    return "\n\n".join(f"```python\n{p}\n```" if p[:3] == ">>>" else " ".join(p.split()) for p in parts).strip()


if __name__ == "__main__":
    print(json.dumps(pages()))
