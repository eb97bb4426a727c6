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
    os.environ["HEXJET_PURE"] = "1"  # what is compiled has no docstrings

import cosim
from cosim.base import protocols
from cosim.control.belief import Belief

ROOT = Path(__file__).parents[1]
SECTION = re.compile(r"^(\w+)\n-{3,}\n", re.MULTILINE)
ENTRY = re.compile(r"^(\S[^\n]*)\n((?:    [^\n]*\n?|\n(?=    ))+)", re.MULTILINE)
MODULES = ("api", "campaign", "commands", "files", "identify", "laws", "loops", "pages")
RECORDS = ("cosim/base/signals.py", "cosim/base/protocols/records.py")


def pages() -> dict[str, str]:
    """Return the pages by file name: exports, public modules, protocols, records."""
    exports = {name: read_export(name) for name in cosim.__all__}
    blocks = {name: each for name, each in vars(protocols).items() if getattr(each, "_is_protocol", False)}
    del exports["Command"]  # it is a record
    made = {
        "python.md": [
            "# Python: `from cosim import ...`\n\nVectors are tuples of three floats, body forward-right-down or NED "
            "as said; per jet is a tuple from jet 1 on; all is SI, angles are rad. Step `k` acts over `[t_k, t_k+1)`, "
            "`t_k = k dt`. [How it is used](../docs/python.md).\n",
            *(_describe_object(name, each) for name, each in exports.items()),
        ]
    }
    for name in MODULES:
        module = import_module(f"cosim.{name}")
        made[f"python-{name}.md"] = [f"# Python: `from cosim.{name} import ...`\n", *_describe_module(module)]
    made["python-protocols.md"] = [
        "# To write: `cosim.base.protocols`\n\nAny object of the right shape takes the place of a block: "
        "[ways to name it](../docs/own-controller.md#ways-to-name-it).\n",
        *(_describe_object(name, each) for name, each in (blocks | {"Belief": Belief}).items()),
    ]
    made["python-records.md"] = [
        "# Records: `cosim.base.signals`, `cosim.base.protocols`\n\nNamed tuples: fields by name or by place.\n",
        *(_describe_record(each, lines) for module in RECORDS for each, lines in _list_records(ROOT / module)),
    ]
    return {name: "\n".join(each).rstrip() + "\n" for name, each in made.items()}


def read_export(name: str) -> Any:
    """Return an export of the package; for a package that can be called, its function."""
    export = getattr(cosim, name)
    return getattr(import_module(f"cosim.api.{name}"), name) if inspect.ismodule(export) else export


def _describe_module(module: Any) -> Iterator[str]:
    """Return the text on a public module: purpose, constants, functions and classes."""
    yield _format_docstring(module)
    exports = {name: getattr(module, name) for name in module.__all__}
    constants = [f"`{name} = {each!r}`" for name, each in exports.items() if isinstance(each, (int, str))]
    if constants:
        yield f"Constants: {', '.join(constants)}.\n"
    for name, each in exports.items():
        if inspect.isclass(each):
            yield f"## `{name}`\n\n{_format_docstring(each)}"
        elif inspect.ismodule(each):
            own = (
                (key, value) for key, value in vars(each).items() if inspect.isclass(value) or inspect.isroutine(value)
            )
            docs = ((key, inspect.getdoc(value)) for key, value in own if value.__module__ == each.__name__)
            lines = [f"- `{name}.{key}`: {_format_prose(doc.splitlines()[0])}\n" for key, doc in docs if doc]
            yield f"## `{name}`\n\n{_format_docstring(each)}\n{''.join(lines)}"
        elif inspect.isroutine(each):
            yield _describe_object(name, each)


def _describe_object(name: str, each: Any) -> str:
    """Return the text on a function, or on a class with its members."""
    if not inspect.isclass(each):
        return f"## `{name}`\n\n{_format_signature(name, each)}{_format_docstring(each)}"
    shown = f"## `{name}`\n\n{_format_docstring(each)}"
    for member, value in vars(each).items():
        found = value.__func__ if isinstance(value, (classmethod, staticmethod)) else value
        if member.startswith("_") or not inspect.getdoc(found):
            continue
        if isinstance(found, property):
            shown += f"\n**`{name}.{member}`** {_format_prose(inspect.getdoc(found) or '')}\n"
        elif inspect.isroutine(found) and str(getattr(found, "__module__", "")).startswith(("cosim", "hexjet_")):
            shown += f"\n{_format_signature(f'{name}.{member}', found)}{_format_docstring(found)}"
    return shown


def _format_signature(name: str, each: Any) -> str:
    found = inspect.signature(each)
    told = [
        parameter.replace(annotation=inspect.Parameter.empty)
        for parameter in found.parameters.values()
        if parameter.name not in ("self", "cls")
    ]
    plain = str(found.replace(parameters=told, return_annotation=inspect.Signature.empty))
    plain = re.sub(r"<function (\w+) at [^>]*>", r"\1", plain)
    plain = re.sub(r"\w+Path\('([^']*)'\)", r'Path("\1")', plain)
    plain = re.sub(r"'(\w*)'", r'"\1"', plain)  # as pages are formatted
    return f"```python\n{name}{plain}\n```\n\n"


def _format_docstring(each: Any) -> str:
    """Return a docstring as Markdown: its prose, and the entries of its sections as a list."""
    text = inspect.getdoc(each) or ""
    prose, *sections = SECTION.split(text)
    shown = f"{_format_prose(prose)}\n"
    for title, body in zip(sections[::2], sections[1::2], strict=True):
        shown += f"\n{title}:\n\n"
        for head, said in ENTRY.findall(f"{body.rstrip()}\n"):
            what, _, kind = head.partition(" : ")
            shown += f"- `{what}`{f' ({kind})' if kind else ''}: {_format_prose(said)}\n"
    return shown


def _list_records(path: Path) -> Iterator[tuple[ast.ClassDef, list[str]]]:
    """Yield the named tuples of a module, read from its text, as compiled classes have no docstrings."""
    text = path.read_text(encoding="utf-8")
    for node in ast.parse(text).body:
        if isinstance(node, ast.ClassDef) and any(ast.unparse(base) == "NamedTuple" for base in node.bases):
            yield node, text.splitlines()


def _describe_record(node: ast.ClassDef, lines: Sequence[str]) -> str:
    """Return the text on a named tuple: fields with type, default and meaning."""
    rows = []
    for each in node.body:
        if isinstance(each, ast.AnnAssign):
            default = "" if each.value is None else f"`{ast.unparse(each.value)}`"
            meaning = lines[(each.end_lineno or each.lineno) - 1][each.end_col_offset or 0 :].partition("# ")[2]
            kind = ast.unparse(each.annotation).replace("|", "\\|")
            said = _format_prose(meaning).replace("|", "\\|")
            rows.append(f"| `{ast.unparse(each.target)}` | `{kind}` | {default} | {said} |\n")
    head = "| field | type | default | meaning |\n| --- | --- | --- | --- |\n"
    return f"## `{node.name}`\n\n{_format_prose(ast.get_docstring(node) or '')}\n\n{head}{''.join(rows)}"


def _format_prose(text: str) -> str:
    """Return a docstring's text with one line a paragraph, roles, literals and examples as Markdown code."""
    text = re.sub(r":\w+:`~?([^`]+)`", r"`\1`", text.replace("``", "`"))
    parts = inspect.cleandoc(text).split("\n\n")
    return "\n\n".join(f"```python\n{p}\n```" if p[:3] == ">>>" else " ".join(p.split()) for p in parts).strip()


if __name__ == "__main__":
    print(json.dumps(pages()))
