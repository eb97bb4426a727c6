"""Docstrings for the compiled modules: mypyc drops them, and ``help()`` should say of a class what its source says.

mypyc writes all modules into one C file, each as its tables of methods and types, the function that executes it, and
its definition.  Their places for documentation hold a signature or nothing; here the source's docstrings are added.

Imports nothing of the package: the build reads it by its path.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Mapping

_EXECUTES = re.compile(r"^ *static int CPyExec_cosim___(\w+?)__impl\(PyObject \*module\)$", re.M)
_CLASS = re.compile(r"^ *static PyMethodDef \w*?___(_*[A-Za-z]\w*)_methods\[\] = \{$(.*?)^ *\};$", re.M | re.S)
_GETTERS = re.compile(r"^ *static PyGetSetDef \w*?___(_*[A-Za-z]\w*)_getseters\[\] = \{$(.*?)^ *\};$", re.M | re.S)
_SIGNATURE = re.compile(r'PyDoc_STR\("(\w+)(\([^"]*\)(?: -> [^"]*)?\\n--\\n\\n)"\)')
_ATTRIBUTE = re.compile(r'(\{"(\w+)",\s*\(getter\)\w+, (?:\(setter\)\w+|NULL),\s*)NULL, NULL\}')
_TYPE = re.compile(r'(\.tp_doc = )PyDoc_STR\("(\w+)(\([^"]*\)\\n--\\n\\n)"\)')


def documented(text: str, sources: Mapping[str, str]) -> str:
    """mypyc's C with the docstrings of ``sources``, the modules' text by dotted name without the package's."""
    heads = list(_EXECUTES.finditer(text))
    parts, begin = [], 0
    for head, after in zip(heads, [*heads[1:], None], strict=True):
        name = head[1].replace("___", ".")
        # a module's tables stand before the function that executes it, its definition behind
        end = text.find("PyInit", head.end()) if after is None else text.find("PyInit", head.end(), after.start())
        end = head.end() if end < 0 else end
        parts.append(_module(text[begin:end], sources[name]) if name in sources else text[begin:end])
        begin = end
    return "".join([*parts, text[begin:]])


def _module(text: str, source: str) -> str:
    tree = ast.parse(source)
    classes = {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}
    functions = _docs(tree)

    def of_class(found: re.Match[str]) -> str:
        docs = _docs(classes[found[1]]) if found[1] in classes else {}
        return _SIGNATURE.sub(lambda m: _with(m[1] + m[2], docs.get(m[1])), found[0])

    def of_attributes(found: re.Match[str]) -> str:
        docs = _docs(classes[found[1]]) if found[1] in classes else {}
        return _ATTRIBUTE.sub(lambda m: f"{m[1]}{_string(docs[m[2]])}, NULL}}" if m[2] in docs else m[0], found[0])

    def of_type(found: re.Match[str]) -> str:
        node = classes.get(found[2])
        doc = ast.get_docstring(node) if node is not None else None
        return found[1] + _with(found[2] + found[3], doc)

    text = _TYPE.sub(of_type, _GETTERS.sub(of_attributes, _CLASS.sub(of_class, text)))
    text = re.sub(
        r'(?<=METH_KEYWORDS, )PyDoc_STR\("(\w+)([^"]*\\n--\\n\\n)"\) /\* docstring \*/',
        lambda m: _with(m[1] + m[2], functions.get(m[1])),
        text,
    )
    whole = ast.get_docstring(tree)
    if whole:
        text = text.replace("NULL, /* docstring */", f"{_string(whole)}, /* docstring */")
    later = [(name, doc) for name, node in classes.items() if (doc := ast.get_docstring(node)) and _made_later(node)]
    return _when_executed(text, later)


def _made_later(node: ast.ClassDef) -> bool:
    """Whether Python makes the class when the module is executed: named tuples, dataclasses and protocols."""
    names = [ast.unparse(base) for base in (*node.bases, *node.decorator_list)]
    return any(name.split("(")[0].split("[")[0].split(".")[-1] in _MADE_LATER for name in names)


_MADE_LATER = {"NamedTuple", "Protocol", "dataclass", "TypedDict", "Enum", "StrEnum", "IntEnum"}


def _when_executed(text: str, docs: list[tuple[str, str]]) -> str:
    lines = [
        f"""    {{
        PyObject *cls = PyObject_GetAttrString(module, "{name}");
        PyObject *doc = cls ? PyUnicode_FromString({_string(doc)}) : NULL;
        if (!doc || PyObject_SetAttrString(cls, "__doc__", doc) < 0) PyErr_Clear();
        Py_XDECREF(doc);
        Py_XDECREF(cls);
    }}
"""
        for name, doc in docs
    ]
    head = next(_EXECUTES.finditer(text), None)
    if head is None or not lines:
        return text
    end = text.index("return 0;", head.end())
    return text[:end] + "".join(lines).lstrip() + "    " + text[end:]


def _docs(node: ast.Module | ast.ClassDef) -> dict[str, str]:
    made = {each.name: ast.get_docstring(each) for each in node.body if isinstance(each, ast.FunctionDef)}
    return {name: doc for name, doc in made.items() if doc}


def _with(signature: str, doc: str | None) -> str:
    return f'PyDoc_STR("{signature}{_escaped(doc or "")}")'


def _string(text: str) -> str:
    return f'"{_escaped(text)}"'


def _escaped(text: str) -> str:
    """As a C string has it; octal, because a hexadecimal escape would take in digits that follow it."""
    plain = {0x22: '\\"', 0x5C: "\\\\", 0x0A: "\\n", 0x3F: "\\?"}
    return "".join(plain.get(b) or (chr(b) if 0x20 <= b < 0x7F else f"\\{b:03o}") for b in text.encode())
