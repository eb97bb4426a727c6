"""Docstrings for the compiled modules: mypyc drops them, and ``help()`` should say of a class what its source says.

mypyc writes all modules into one C file, each as its tables of methods and types, the function that executes it, and
its definition.  The tables' places for documentation hold a signature or nothing; here the source's docstrings are
added.  Classes, and what Python makes of the members of some, get theirs when the module is executed.

Imports nothing of the package: the build reads it by its path.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Mapping

_EXECUTES = re.compile(r"^ *static int CPyExec_cosim___(\w+?)__impl\(PyObject \*module\)$", re.M)
_CLASS = re.compile(r"^ *static PyMethodDef \w*?___(_*[A-Za-z]\w*)_methods\[\] = \{$(.*?)^ *\};$", re.M | re.S)
_MODULE = re.compile(r"^ *static PyMethodDef \w+module_methods\[\] = \{$(.*?)^ *\};$", re.M | re.S)
_GETTERS = re.compile(r"^ *static PyGetSetDef \w*?___(_*[A-Za-z]\w*)_getseters\[\] = \{$(.*?)^ *\};$", re.M | re.S)
# with its signature, or NULL where a default value has no short form
_METHOD = re.compile(r'(\{"(\w+)",\s*\(PyCFunction\)\w+,\s*[\w| ]+, )PyDoc_STR\((?:"([^"]*\\n--\\n\\n)"|NULL)\)')
_ATTRIBUTE = re.compile(r'(\{"(\w+)",\s*\(getter\)\w+,\s*(?:\(setter\)\w+|NULL),\s*)NULL, NULL\}')


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

    def of_class(match: re.Match[str]) -> str:
        docs = _docs(classes[match[1]]) if match[1] in classes else {}
        return _METHOD.sub(lambda m: m[1] + _with(m[3] or "", docs.get(m[2])), match[0])

    def of_attributes(match: re.Match[str]) -> str:
        docs = _docs(classes[match[1]]) if match[1] in classes else {}
        return _ATTRIBUTE.sub(lambda m: f"{m[1]}{_string(docs[m[2]])}, NULL}}" if m[2] in docs else m[0], match[0])

    def of_module(match: re.Match[str]) -> str:
        return _METHOD.sub(lambda m: m[1] + _with(m[3] or "", functions.get(m[2])), match[0])

    text = _MODULE.sub(of_module, _GETTERS.sub(of_attributes, _CLASS.sub(of_class, text)))
    whole = ast.get_docstring(tree)
    if whole:
        text = text.replace("NULL, /* docstring */", f"{_string(whole)}, /* docstring */")
    later = [(name, doc) for name, node in classes.items() if (doc := ast.get_docstring(node))]
    made = {name: _docs(node) for name, node in classes.items() if _made_by_python(node)}
    later += [(f"{name}.{member}", doc) for name, docs in made.items() for member, doc in docs.items()]
    return _when_executed(text, later)


def _made_by_python(node: ast.ClassDef) -> bool:
    """Whether Python makes the class when the module is executed: named tuples, dataclasses and protocols."""
    names = [ast.unparse(base) for base in (*node.bases, *node.decorator_list)]
    return any(name.split("(")[0].split("[")[0].split(".")[-1] in _MADE_BY_PYTHON for name in names)


_MADE_BY_PYTHON = {"NamedTuple", "Protocol", "dataclass", "TypedDict", "Enum", "StrEnum", "IntEnum"}


def _when_executed(text: str, docs: list[tuple[str, str]]) -> str:
    """Said of classes, and of members that are in no table, at the end of the module."""
    lines = []
    for name, doc in docs:
        owner, _, member = name.partition(".")
        of = f'cls ? PyObject_GetAttrString(cls, "{member}") : NULL' if member else "Py_XNewRef(cls)"
        lines.append(f"""    {{
        PyObject *cls = PyObject_GetAttrString(module, "{owner}");
        PyObject *of = {of};
        PyObject *doc = of ? PyUnicode_FromString({_string(doc)}) : NULL;
        if (!doc || PyObject_SetAttrString(of, "__doc__", doc) < 0) PyErr_Clear();
        Py_XDECREF(doc);
        Py_XDECREF(of);
        Py_XDECREF(cls);
    }}
""")
    head = next(_EXECUTES.finditer(text), None)
    if head is None or not lines:
        return text
    end = text.index("return 0;", head.end())
    return text[:end] + "".join(lines).lstrip() + "    " + text[end:]


def _docs(node: ast.Module | ast.ClassDef) -> dict[str, str]:
    made = {
        function.name: ast.get_docstring(function) for function in node.body if isinstance(function, ast.FunctionDef)
    }
    return {name: doc for name, doc in made.items() if doc}


def _with(signature: str, doc: str | None) -> str:
    return f'PyDoc_STR("{signature}{_escaped(doc or "")}")'


def _string(text: str) -> str:
    return f'"{_escaped(text)}"'


def _escaped(text: str) -> str:
    """As a C string has it; octal, because a hexadecimal escape would take in digits that follow it."""
    plain = {0x22: '\\"', 0x5C: "\\\\", 0x0A: "\\n", 0x3F: "\\?"}
    return "".join(plain.get(b) or (chr(b) if 0x20 <= b < 0x7F else f"\\{b:03o}") for b in text.encode())
