"""Pages of reference, made of the code: ``pages()`` gives each by its name.

Commands from the command line's own tree, keys from the models that read the files, columns from the one description
of the log, metrics from their records.  They are made anew whenever the site is built and are not kept, so none can be
older than the code.  A key's meaning is the comment behind its field, or above it, or in ``cosim/spec/meanings.toml``.
"""

from __future__ import annotations

import inspect
import re
import types
from collections.abc import Iterable, Iterator
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from cosim.base.signals import JETS, MAX_JETS
from cosim.base.storage.paths import data_folder, files_in
from cosim.base.storage.toml import read_toml
from cosim.campaign.study.autopilot import StudyAutopilot
from cosim.campaign.study.key import unit_of
from cosim.campaign.study.study import Study
from cosim.cli import table as commands
from cosim.cli.declare import Command
from cosim.cli.main import DONE, FLIGHT_FAILED, INTERRUPTED, TERMINATED, WRONG_INPUT
from cosim.engine.fmu.mapping import MappingFile
from cosim.results.log.columns import log_columns
from cosim.results.metrics import Metrics
from cosim.simulation.controllers.controller_file import ControllerFile
from cosim.spec.meanings import comments_of, meaning_of
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Vehicle
from hexjet_sitl.study import AutopilotTable


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a table in Markdown, whose cells are Markdown."""
    head = list(head)
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def cell(text: str) -> str:
    """Return a text as one line of a Markdown cell, with HTML and emphasis escaped."""
    shown = re.sub(r":\w+:`~?([^`]+)`", r"`\1`", text.replace("``", "`"))
    pieces = re.split(r"(`[^`]*`)", " ".join(shown.split()))
    pieces[::2] = [re.sub(r"([\\*_<>$\[\]])", r"\\\1", piece) for piece in pieces[::2]]
    return "".join(pieces).replace("|", "\\|")


def commands_page() -> str:
    """Return the page of all commands: usage, purpose, arguments and options."""
    said = (
        "# Commands\n\nAs `hexjet COMMAND --help` prints it. `hexjet --version` says which version runs. [What a command "
        "leaves behind as its exit status, and what it reads from the environment](environment.md).\n"
    )
    return said + "".join(_describe_command(name) for name in commands.list_names())


def _describe_command(name: str) -> str:
    command = commands.load(name)
    if not isinstance(command, Command):
        return f"\n## hexjet {name}\n\n```text\n{command.help(80)}\n```\n"
    about = "\n\n".join(map(cell, command.texts[0].split("\n\n")))
    rows = [[f"`{each.label.replace('|', chr(92) + '|')}`", cell(each.meaning)] for each in command.rows]
    shown = f"\n## hexjet {name}\n\n{about}\n\n{table(('option', 'meaning'), rows)}"
    return f"{shown}\n```text\nhexjet {name} {command.example}\n```\n"


class Key(NamedTuple):
    """Key of a scenario, study or vehicle file."""

    table: str  # such as [control.rate.roll]
    name: str
    kind: str
    default: str
    meaning: str


# Models of the tables that tools read, by their protocol.
TOOL_MODELS: dict[type, type[BaseModel]] = {StudyAutopilot: AutopilotTable}


def tables(model: type[BaseModel], table: str = "") -> Iterator[tuple[str, type[BaseModel]]]:
    """Yield every table of a file by its heading with its model; a table of several kinds comes once for each."""
    yield table, model
    for name, field in model.model_fields.items():
        kind, inside = repr(field.annotation), list(_list_models(field.annotation))
        for each in inside:
            named = ("NAME", "AXIS")[: kind.count("dict[") + kind.count("Dict[")]
            path = ".".join(filter(None, (table.strip("[]").partition("]")[0], name, *named)))
            which = each.model_fields.get("kind") if len(inside) > 1 else None
            heading = f"[[{path}]]" if "list[" in kind else f"[{path}]"
            yield from tables(each, f'{heading} kind = "{get_args(which.annotation)[0]}"' if which else heading)


def keys(model: type[BaseModel]) -> Iterator[Key]:
    """Yield every key of a file, table by table."""
    for heading, each in tables(model):
        for name, field in each.model_fields.items():
            default = "needed" if field.is_required() else _format_default(field.get_default(call_default_factory=True))
            yield Key(
                heading, name, _describe_type(field.annotation, field.metadata), default, _read_meaning(each, name)
            )


def keys_page(model: type[BaseModel], head: str) -> str:
    """Return the page of all keys of a file, with a heading for each table."""
    rows: dict[str, list[list[str]]] = {}
    for key in keys(model):
        rows.setdefault(key.table, []).append([f"`{key.name}`", key.kind, key.default, key.meaning])
    shown = head
    for heading, each in tables(model):
        title = f"`{heading}`" if heading else "At the top of the file"
        said = f"{cell(each.__doc__)}\n\n" if heading and each.__doc__ else ""
        shown += f"\n## {title}\n\n{said}{table(('key', 'type', 'default', 'meaning'), rows[heading])}"
    return shown


def _list_models(kind: Any) -> Iterator[type[BaseModel]]:
    if inspect.isclass(kind) and get_origin(kind) is None:
        kind = TOOL_MODELS.get(kind, kind)
        if issubclass(kind, BaseModel):
            yield kind
        return
    for each in get_args(kind):
        yield from _list_models(each)


def _read_meaning(model: type[BaseModel], name: str) -> str:
    """Return what a key means, from the comment of its field."""
    comment = comments_of(model).get(name)
    return cell(comment) if comment else meaning_of(model, name, markdown=True)


def _format_default(value: Any) -> str:
    if value is None:
        return "-"
    if value is PydanticUndefined:
        return ""
    if isinstance(value, BaseModel):
        return "as below"
    if value in ("", [], {}, ()):
        return "none"
    if isinstance(value, (list, tuple)):
        return f"`[{', '.join(_format_toml(each) for each in value)}]`"
    return f"`{_format_toml(value)}`"


def _format_toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else f"{value:g}" if isinstance(value, float) else str(value)


def _describe_type(kind: Any, metadata: Iterable[Any] = ()) -> str:
    """Return a type in words, with its bounds."""
    said = " ".join(filter(None, [_name_type(kind), _describe_bounds(metadata)]))
    return said.replace("|", "\\|")


def _name_type(kind: Any) -> str:
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return " ".join(filter(None, [_name_type(arguments[0]), _describe_bounds(arguments[1:])]))
    if origin is Literal:
        return ", ".join(f"`{_format_toml(each)}`" for each in arguments)
    if origin in (Union, types.UnionType):
        words = dict.fromkeys(_name_type(each) for each in arguments if each is not type(None))
        return " or ".join(words)
    if origin is tuple:
        if len(set(arguments)) == 1:
            return (
                f"{len(arguments)} numbers"
                if _name_type(arguments[0]).startswith("number")
                else f"{len(arguments)} texts"
            )
        return "pair of " + " and ".join(_name_type(each) for each in arguments)
    if origin is list:
        return f"list: {_name_type(arguments[0])}"
    if origin is dict:
        return f"table: {_name_type(arguments[1])} by name"
    if inspect.isclass(kind) and issubclass(TOOL_MODELS.get(kind, kind), BaseModel):
        return "table"
    return {float: "number", int: "whole number", bool: "true, false", str: "text", Any: "any"}.get(kind, "text")


def _describe_bounds(metadata: Iterable[Any]) -> str:
    signs = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤"}
    found = []
    for each in metadata:
        inside = getattr(each, "metadata", None) or [each]
        found += [
            f"{sign} {getattr(part, name):g}" for part in inside for name, sign in signs.items() if hasattr(part, name)
        ]
        for part in inside:
            if hasattr(part, "min_length") and part.min_length:
                found.append(f"at least {part.min_length}")
    return ", ".join(found).replace("<", "&lt;").replace(">", "&gt;")


def columns_page() -> str:
    """Return the page of all columns of the log."""
    head = (
        "# Columns of the log\n\nOne row of `flight.parquet` is one control step `k`. True and measured quantities are taken at `t_k`, before the "
        f"step; everything else acts over `[t_k, t_k+1)`. All are float64. A vehicle with more than {JETS} jets has the columns of jets up "
        f"to {MAX_JETS} too; one with fewer has NaN there. Body is forward-right-down, NED north-east-down with its origin on the ground "
        "below the start. Columns that a block [of your own](../docs/own-controller.md#your-own-metric-wind-sensors-and-observer) shows come last. In exports the names are the same, or "
        "[stated beside](../docs/runs.md#the-log-in-other-tools).\n\n"
    )
    rows = [
        [f"`{each.name}`", cell(each.unit) or "-", cell(each.frame) or "-", cell(each.meaning)]
        for each in log_columns()
    ]
    return head + table(("column", "unit", "frame", "meaning"), rows)


def metrics() -> Iterator[tuple[str, str]]:
    """Yield every metric with its meaning."""
    axes = {"axes": ("roll", "pitch", "yaw")}
    for name, field in Metrics.model_fields.items():
        inside = list(_list_models(field.annotation))
        for model in inside:
            for prefix in axes.get(name, (name,)):
                about = (inspect.getdoc(model) or "").replace(
                    "One axis.  None stands for what this flight cannot tell.", ""
                )
                for inner in model.model_fields:
                    yield f"{prefix}.{inner}", _read_meaning(model, inner) or cell(about)
        if not inside:
            yield name, _read_meaning(Metrics, name)


def metrics_page() -> str:
    """Return the page of all metrics with their units."""
    head = (
        "# Metrics\n\nNames as `[[expect]]`, `[success]`, `--success`, `summary.json` and campaigns use them; the [definitions](../docs/metrics.md), "
        "with what each leaves out. A metric [of your own](../docs/own-controller.md#your-own-metric-wind-sensors-and-observer) is `own.NAME`.\n\n"
    )
    rows = [[f"`{name}`", _read_unit(name), meaning] for name, meaning in metrics()]
    return head + table(("metric", "unit", "meaning"), rows)


def _read_unit(name: str) -> str:
    return "%" if name.endswith("_percent") else unit_of(name) or "-"


# Environment variables that are read, and what for.
ENVIRONMENT = {
    "COLUMNS": "width of tables in the terminal and in a pipe",
    "NO_COLOR": "set: no colours in the terminal",
    "TMPDIR": "where temporary files are made",
    "XDG_CACHE_HOME": "where it is remembered what an engine's check and its measured curve said; `~/.cache` without it",
    "XDG_DATA_HOME": "where `hexjet --install-completion bash` writes its file; `~/.local/share` without it",
    "XDG_CONFIG_HOME": "where it is remembered whose code is run (`hexjet/trusted`); `~/.config` without it",
    "HEXJET_TRUST": "1: code that files name is run and remembered without a question, as with `--trust`",
    "HEXJET_PURE": "set at run time: everything runs from source, nothing compiled; set at the build: nothing is compiled",
    "HEXJET_OPTIMISATION": "at the build: the C compiler's level for the compiled modules, `-O2` without it; the bits are the same",
    "HEXJET_PORT": "set by `hexjet sitl` for Betaflight: where its ports begin",
    "HEXJET_PROCESS": "set by `hexjet` for the processes that it starts, which are found by it and ended with all that they started",
    "ARDUPILOT_SITL": "the ArduPilot program that `hexjet sitl` runs",
    "BETAFLIGHT_SITL": "the Betaflight program that `hexjet sitl` runs",
    "PX4_SITL": "the PX4 program that `hexjet sitl` runs",
    "HEXJET_BROWSER": "the browser that tests, pictures of pages and `hexjet benchmark` drive",
    "CC": "the C compiler that builds FMUs and extensions; `cc` without it",
    "PYTHONPATH": "where Python finds modules of your own; a campaign's workers on this machine have the same",
    "PATH": "where compiler and CMake are found",
    "OMP_NUM_THREADS": "threads of numpy's libraries; 1 unless it is stated, as of OpenBLAS, MKL and the like",
}  # fmt: skip


def environment_page() -> str:
    """Return the page of exit statuses and environment variables."""
    statuses = {
        DONE: "done: flown as planned, or completed within its limits and nothing checked, or what was asked for is written",
        FLIGHT_FAILED: "the flight crashed, diverged or failed, went beyond [its limits](../docs/metrics.md#limits), or missed what its "
        "scenario expects or requires; a check found a fault; a margin is less than was asked for; the machine had no more to give (disk, memory)",
        WRONG_INPUT: "the input was wrong: one line on standard error says what, where, and what is allowed",
        INTERRUPTED: "Ctrl-C: one line says what is kept",
        TERMINATED: "SIGTERM, the same",
    }
    return (
        "# Exit statuses, environment\n\n## Exit statuses\n\n"
        + table(("status", "when"), [[str(status), said] for status, said in statuses.items()])
        + "\n## Environment\n\n"
        + table(("name", "meaning"), [[f"`{name}`", said] for name, said in ENVIRONMENT.items()])
    )


def catalogue_page(kind: str, head: str) -> str:
    """Return the page of what is shipped of a kind: name, title, and its file."""
    shown = head
    for name in files_in(kind):
        data = read_toml(data_folder(kind) / f"{name}.toml")
        shown += (
            f"\n## {name}\n\n{cell(data.get('title', ''))}\n\n{cell(data.get('description', ''))}\n\n"
            f"```{{literalinclude}} ../{kind}/{name}.toml\n:language: toml\n```\n"
        )
    return shown


def pages() -> dict[str, str]:
    """Return every page by its file's name."""
    return {
        "commands.md": commands_page(),
        "scenario.md": keys_page(
            Scenario,
            "# Keys of a scenario\n\nThe tables and keys of a scenario's TOML; on the command line they are dotted names: "
            "`--set initial.altitude_m=12`, `--set command.0.amplitude=5`. [The shipped ones](scenarios.md).\n",
        ),
        "vehicle.md": keys_page(
            Vehicle,
            "# Keys of a vehicle\n\nThe tables and keys of `vehicle.toml`; a scenario writes over them under `vehicle.`. "
            "[An aircraft of your own](../docs/own-aircraft.md).\n",
        ),
        "study.md": keys_page(
            Study, "# Keys of a study\n\nThe tables and keys of a study's TOML. [Campaigns](../docs/campaigns.md).\n"
        ),
        "mapping.md": keys_page(
            MappingFile,
            "# Keys of a mapping file\n\nWhat may be said of a foreign engine. [An engine of your own](../docs/own-engine.md).\n",
        ),
        "controller.md": keys_page(
            ControllerFile,
            "# Keys of a controller file\n\nWhat `hexjet design --out` writes. [Control design](../docs/control-design.md).\n",
        ),
        "columns.md": columns_page(),
        "metrics.md": metrics_page(),
        "environment.md": environment_page(),
        "scenarios.md": catalogue_page("scenarios", "# Scenarios that are shipped\n\nEach is an example and a test.\n"),
        "studies.md": catalogue_page("studies", "# Studies that are shipped\n\nEach is an example.\n"),
    }
