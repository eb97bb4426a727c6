"""A command out of a function: its arguments are the options, its description is the help, its result is printed."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, nullcontext, redirect_stdout
from dataclasses import dataclass, field
from functools import cached_property
from importlib import import_module
from json import dumps
from math import isfinite
from os import devnull
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union, cast, get_args, get_origin

from cosim.base.errors import InputError, nearest
from cosim.base.removed import describe_removed
from cosim.base.trust import trust_everything, without_code
from cosim.base.wording import name_options
from cosim.cli.annotations import format_docstring, read_type
from cosim.cli.console import TerminalProgress, echo, format_help, output_to_stderr, show_result

if TYPE_CHECKING:
    from cyclopts import App, CycloptsError

DONE, FLIGHT_FAILED = 0, 1
# Options named unlike their argument: a sequence's option is in the singular, as it is repeated for each value.
_OPTION_NAMES = {
    "controllers": "controller", "engines": "engine", "metrics": "metric", "observers": "observer", "settings": "set",
}  # fmt: skip
# Placeholder of a value in the help, by argument.
_METAVARS = {
    "aircraft": "NAME|DIR", "controller": "NAME|FILE", "controllers": "NAME|FILE", "engine": "NAME|FILE",
    "folder": "DIR", "metrics": "NAME", "observers": "NAME", "out": "DIR", "scenario": "NAME|FILE", "sensors": "NAME",
    "settings": "KEY=VALUE", "wind": "NAME|FILE",
}  # fmt: skip
_TYPE_PLACEHOLDERS = {int: "N", float: "X", str: "TEXT", Path: "FILE"}
# Endings of files that commands write or read; any other path, such as runs/v1.2, names a folder.
_FILE_ENDINGS = frozenset((
    ".bin", ".c", ".csv", ".fmu", ".h", ".htm", ".html", ".jpg", ".json", ".jsonl", ".log", ".mat", ".mcap", ".md",
    ".parquet", ".pdf", ".png", ".py", ".ssp", ".svg", ".tlog", ".toml", ".txt", ".ulg", ".ulog", ".yaml", ".zip",
))  # fmt: skip
# Options that every command may add.
_JSON, _TRUST, _VERBOSE, _QUIET = "as_json", "trust", "verbose", "quiet"
_HELP_FLAGS = ("-h", "--help")
# Arguments by the question that they answer; the help lists all others as options.
_HELP_GROUPS = {
    "What flies": ("aircraft", "engine", "controller", "controllers", "model", "sensors", "wind", "settings", "seed"),
    "Output": ("out", "resume", _JSON, _VERBOSE, _QUIET),
}


@dataclass(frozen=True)
class Option:
    """Option or argument of a command, made from one parameter of its function."""

    argument: str
    names: tuple[str, ...]  # empty: a positional argument
    kind: Any  # type of each value
    several: bool
    pairs: tuple[type, type] | None  # types of NAME=VALUE, for a mapping
    metavar: str
    text: str
    default: Any
    required: bool
    limits: Any

    @property
    def label(self) -> str:
        """Names and placeholder of the value, as the help shows them."""
        if self.kind is bool:
            short = "".join(f"{name}, " for name in self.names if name[1] != "-")
            return f"{short}{self.names[0]}" if self.default is False else f"{self.names[0]}/--no-{self.names[0][2:]}"
        return f"{self.names[0]} {self.metavar}" if self.names else self.metavar

    @property
    def meaning(self) -> str:
        """Description, allowed values and default, as the help shows them."""
        parts = [self.text] if self.text else []
        choices = get_args(self.kind) if get_origin(self.kind) is Literal else ()
        parts += [f"[{'|'.join(map(str, choices))}]"] if choices else []
        parts += [f"[{self.limits}]"] if self.limits is not None else []
        is_stated = not isinstance(self.default, bool) and self.default not in (None, "", ()) and not self.required
        parts += [f"[default: {self.default}]"] if is_stated else []
        return "  ".join(parts)


@dataclass(frozen=True)
class Command:
    """Command of the command line, made from a function's parameters and docstring."""

    # Words after ``hexjet``.
    name: str
    # ``module:name``, imported when the command runs or its help is shown.
    function: str
    # The rest of a command line after ``hexjet NAME``.
    example: str
    # Names of options that differ from their arguments' names, by argument, separated by blanks. The help shows
    # the first; the others are accepted.
    options: Mapping[str, str] = field(default_factory=dict)
    # Placeholders of values in the help, by argument, where they differ from the usual ones.
    metavars: Mapping[str, str] = field(default_factory=dict)
    # Arguments with values that the command sets; they are no options.
    given: Mapping[str, Any] = field(default_factory=dict)
    # Values of options that may be written without a value, by argument.
    bare: Mapping[str, str] = field(default_factory=dict)
    # Returns the name of the new folder in ``runs/`` from all arguments, if ``out`` is not stated; None: no folder.
    folder: Callable[[Mapping[str, Any]], str | None] | None = None
    # Whether the exit status of a result is 0; else it is 1.
    succeeded: Callable[[Any], bool] = lambda result: True
    # Paragraph of the help on the exit status.
    ends: str = ""
    # Whether the command may run the user's code, which ``--trust`` allows.
    runs_code: bool = True
    # Prints a result, with ``--verbose`` if the function has an argument ``verbose``; and returns the data that
    # ``--json`` prints (None: the command has no ``--json``).
    show: Callable[..., None] = show_result
    data: Callable[[Any], Any] | None = lambda result: result.to_dict()
    # Endings of the files that ``out`` may name; empty: it names a folder.
    writes: tuple[str, ...] = ()
    # Another function, ``module:name``, which receives this function's ``**choices``: its arguments are options too,
    # with the texts of its docstring.
    like: str = ""
    # Other functions, ``module:name``, by the option that selects each of them in place of this function.
    modes: Mapping[str, str] = field(default_factory=dict)
    # Arguments of the function that the command line does not offer.
    hidden: tuple[str, ...] = ()
    # Word that precedes a note of the call on standard error.
    notes: str = "note"
    # Command that continues a call that was interrupted, with ``{folder}`` for its folder; empty:
    # ``hexjet NAME {folder} --resume``.
    goes_on: str = ""
    # Called with all arguments before the function, for example to print warnings.
    before: Callable[[Mapping[str, Any]], None] = lambda arguments: None

    @cached_property
    def call(self) -> Callable[..., Any]:
        """Function of the command, imported at the first use."""
        return _import_function(self.function)

    def sources(self, mode: str = "") -> list[Callable[..., Any]]:
        """Return the function, or that of ``mode``, and the function that receives its ``**choices``."""
        if mode:
            return [_import_function(self.modes[mode])]
        return [self.call, *([_import_function(self.like)] if self.like else [])]

    def parameters(self, mode: str = "") -> dict[str, tuple[inspect.Parameter, Callable[..., Any]]]:
        """Return by name each parameter of the command, or of its ``mode``, with the function that declares it."""
        found: dict[str, tuple[inspect.Parameter, Callable[..., Any]]] = {}
        for function in self.sources(mode):
            for name, parameter in inspect.signature(function).parameters.items():
                if parameter.kind is not parameter.VAR_KEYWORD:
                    found.setdefault(name, (parameter, function))
        return found

    @cached_property
    def all_parameters(self) -> dict[str, tuple[inspect.Parameter, Callable[..., Any]]]:
        """Parameters of the function and of its modes, with one for each mode's option."""
        found = self.parameters()
        for mode in self.modes:
            (function,), own = self.sources(mode), self.parameters(mode)
            flag = inspect.Parameter(mode, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=bool)
            if mode in own:
                flag = flag.replace(default=None, annotation=own[mode][0].annotation)
            found = found | {mode: (flag, function)} | {name: own[name] for name in own if name not in (*found, mode)}
        return found

    @cached_property
    def texts(self) -> tuple[str, dict[str, str]]:
        """Description of the command, and of each argument, from the docstrings."""
        from docstring_parser import DocstringStyle, parse

        def parse_docstring(function: Callable[..., Any]) -> Any:
            return parse(inspect.getdoc(function) or "", DocstringStyle.NUMPYDOC)

        first, *others = map(parse_docstring, self.sources())
        more = [each for each in (first.long_description or "").split("\n\n") if not each.startswith(">>>")]
        about = [text for text in (first.short_description, *more, self.ends) if text]
        parameters = [each for parsed in (*reversed(others), first) for each in parsed.params]
        of = {each.arg_name.lstrip("*"): format_docstring(each.description or "") for each in parameters}
        defaults = {name: each.default for name, (each, _) in self.parameters().items()}
        for mode in self.modes:
            parsed = parse_docstring(self.sources(mode)[0])
            of.setdefault(mode, format_docstring(parsed.short_description))
            own = self.parameters(mode)
            for each in parsed.params:
                name, text = each.arg_name, format_docstring(each.description or "")
                default = own[name][0].default
                if name not in of:
                    of[name] = f"With --{mode}: {text[:1].lower()}{text[1:]}"
                elif default and default != defaults.get(name, default):
                    of[name] += f" With --{mode} {default} by default."
        return "\n\n".join(format_docstring(text) for text in about), of

    @cached_property
    def declared(self) -> list[Option]:
        """Options and arguments from the functions' parameters, in their order, without texts."""
        found = (self._make_option(parameter, function) for parameter, function in self.all_parameters.values())
        return [option for option in found if option is not None]

    def _make_option(self, parameter: inspect.Parameter, function: Callable[..., Any]) -> Option | None:
        name, several = parameter.name, parameter.kind is parameter.VAR_POSITIONAL
        if name in self.given or name in self.hidden:
            return None
        read = read_type(parameter.annotation, function)
        if read is None:
            return None
        kind, repeats, pairs = read
        base = _OPTION_NAMES.get(name, name.removesuffix("_s")).replace("_", "-")
        names = tuple(self.options.get(name, f"--{base}").split())
        # The parameter's name in Python is accepted too.
        names = tuple(dict.fromkeys((*names, f"--{base}", f"--{name.replace('_', '-')}")))
        is_argument = parameter.kind is not parameter.KEYWORD_ONLY and name != "out" and name not in self.options
        metavar = self.metavars.get(name) or _METAVARS.get(name) or _TYPE_PLACEHOLDERS.get(kind, "CHOICE")
        unit = name.rpartition("_")[2]
        metavar = unit.upper() if kind is float and unit in ("s", "hz", "mb") else metavar
        if is_argument:
            metavar = self.metavars.get(name, name.upper())
        default = () if several else parameter.default
        limits = vars(function).get("limits", {}).get(name)
        required = default is parameter.empty
        return Option(
            name, () if is_argument else names, kind, repeats or several, pairs, metavar, "",
            None if required else default, required, limits,
        )  # fmt: skip

    @property
    def rows(self) -> list[Option]:
        """Options and arguments with their texts, the ones common to all commands last."""
        texts = self.texts[1]
        rows = []
        for option in self.declared:
            text = texts.get(option.argument, "")
            if option.argument == "out" and self.folder is not None:
                kinds = "folder or file" if self.writes else "folder"
                text = f"The {kinds} that is written, by default a new folder in runs/."
            rows.append(Option(**vars(option) | {"text": text}))
        return rows + self._common_options

    @property
    def _common_options(self) -> list[Option]:
        """Options common to all commands: output as JSON, verbosity, trust."""
        added = [("--json", _JSON, "Print one JSON object and nothing else.")] if self.data is not None else []
        if self._has_verbose:
            added.append(("--verbose -v", _VERBOSE, "Print the tables too that the page has."))
        added.append(("--quiet -q", _QUIET, "Print nothing but errors."))
        if self.runs_code:
            text = "Run code though you never flew what is in its folder, Python, FMUs and programs, and remember it."
            added.append(("--trust", _TRUST, text))
        return [
            Option(name, tuple(names.split()), bool, False, None, "", text, False, False, None)
            for names, name, text in added
        ]

    @property
    def _has_verbose(self) -> bool:
        return "verbose" in inspect.signature(self.show).parameters

    def help(self, width: int | None = None) -> str:
        """Return the help text, ``width`` columns wide; None: the terminal's width."""
        options, arguments = [each for each in self.rows if each.names], [each for each in self.rows if not each.names]
        usage = [each.metavar + ("..." if each.several else "") for each in arguments]
        usage = [text if each.required else f"[{text}]" for text, each in zip(usage, arguments, strict=True)]
        sections: dict[str, list[tuple[str, str]]] = {"Arguments": [], "What flies": [], "Options": [], "Output": []}
        for each in [*arguments, *options]:
            title = "Options" if each.names else "Arguments"
            title = next((group for group, names in _HELP_GROUPS.items() if each.argument in names), title)
            sections[title].append((each.label, each.meaning))
        sections["Output"].append(("--help", "Show this and end."))
        called = " ".join(["hexjet", self.name, "[OPTIONS]", *usage])
        return format_help(
            called, self.texts[0], sections, self.example and f"hexjet {self.name} {self.example}", width
        )

    def app(self, *, with_help: bool = False) -> App:
        """Return the parser of the options; ``with_help``: with their texts, for a shell's completion."""
        from cyclopts import App, Parameter

        from cosim.cli.complete import make_completer

        kind = inspect.Parameter
        parameters = []
        for option in self.rows if with_help else [*self.declared, *self._common_options]:
            default = () if option.several else kind.empty if option.required else option.default
            may_be_on = option.kind is bool and option.default is not False
            stated = Parameter(
                name=option.names or option.metavar,
                negative=[f"--no-{name[2:]}" for name in option.names] if may_be_on else (),
                validator=_make_validator(option),
                help=option.text,
                completer=make_completer(option.argument, option.names),
                consume_multiple=False,
                allow_repeating=True,
                show_default=False,
            )
            value: Any = list[option.kind] if option.several and option.names else option.kind  # type: ignore[name-defined]
            place: Any = kind.KEYWORD_ONLY if option.names else kind.POSITIONAL_ONLY
            if option.several and not option.names:
                place, default = kind.VAR_POSITIONAL, kind.empty
            typed: Any = Annotated[Union[value, None] if default is None else value, stated]  # noqa: UP007 - made of a value
            parameters.append(kind(option.argument, place, default=default, annotation=typed))

        def placeholder(*values: Any, **named: Any) -> None:
            """Give the parser a signature; it is never called."""

        signature = inspect.Signature(sorted(parameters, key=lambda each: each.kind))
        vars(placeholder)["__signature__"] = signature
        placeholder.__annotations__ = {name: each.annotation for name, each in signature.parameters.items()}
        placeholder.__doc__ = self.texts[0].partition("\n")[0] if with_help else None
        app = App(name=self.name.split()[-1], help_flags=_HELP_FLAGS if with_help else [], version_flags=[])
        app.default(placeholder)
        return app

    def read(self, words: Sequence[str]) -> dict[str, Any]:
        """Return the arguments that the words of a command line state.  Raises InputError."""
        from cyclopts import CycloptsError

        try:
            _, bound, _ = self.app().parse_args(
                list(self._insert_bare_values(words)), exit_on_error=False, print_error=False, help_on_error=False
            )
        except CycloptsError as error:
            raise InputError(self._explain_parse_error(error)) from None
        arguments = dict(bound.arguments)
        for option in self.declared:
            if option.pairs is not None and option.argument in arguments:
                arguments[option.argument] = _parse_pairs(option, arguments[option.argument])
        return arguments

    def check_out(self, out: str | None) -> None:
        """Raise InputError if ``out`` is, or by its ending names, a file that this command does not write."""
        if out is None:
            return
        path, ending = Path(out), Path(out).suffix.lower()
        wanted = f"a folder, or a file that ends in {' or '.join(self.writes)}" if self.writes else "a folder"
        if path.is_file() and ending not in self.writes:
            raise InputError(f"--out {out}: is a file; hexjet {self.name} writes {wanted}")
        if ending in _FILE_ENDINGS and ending not in self.writes and not path.is_dir():
            raise InputError(f"--out {out}: names a file by its ending; hexjet {self.name} writes {wanted}")

    def _check_mode(self, mode: str, others: Iterable[str]) -> None:
        """Raise InputError if ``others``, arguments unknown to the function of ``mode``, are stated."""
        names = {each.argument: each.names[0] if each.names else each.metavar for each in self.declared}
        for other in sorted(others):
            home = next((each for each in self.modes if other in (each, *self.parameters(each))), "")
            raise InputError(f"{names[other]}: goes {f'without --{mode}' if mode else f'with --{home}'}")

    def _insert_bare_values(self, words: Sequence[str]) -> Iterator[str]:
        """Yield the words, with the value from ``bare`` after an option that is written without one."""
        values = {name: self.bare[each.argument] for each in self.declared if each.argument in self.bare
                  for name in each.names}  # fmt: skip
        for word, following in zip(words, [*words[1:], "-"], strict=False):
            yield f"{word}={values[word]}" if word in values and following.startswith("-") else word

    def _explain_parse_error(self, error: CycloptsError) -> str:
        """Return one line on words that this command does not accept."""
        from cyclopts import exceptions

        text, token = " ".join(str(error).split()), cast(Any, getattr(error, "token", None))
        if isinstance(error, exceptions.UnknownOptionError):
            text = self._explain_unknown(token.keyword or token.value)
        elif isinstance(error, exceptions.CoercionError) and token is not None and error.argument is not None:
            choices = error.argument.get_choices()
            where = token.keyword or error.argument.name
            kind = next((each.kind for each in self.declared if where in (*each.names, each.metavar)), str)
            wanted = "a whole number" if kind is int else "a number"
            text = f"{where}: {token.value!r} is not {wanted}"
            text = f"{where}: {token.value!r}: {nearest(token.value, choices)}" if choices else text
        elif isinstance(error, exceptions.UnusedCliTokensError):
            text = f"{' '.join(error.unused_tokens or ())}: one argument too many"
        elif (
            isinstance(error, exceptions.MissingArgumentError) and error.keyword is None and error.argument is not None
        ):
            text = f"Missing argument {error.argument.name!r}"
        elif isinstance(error, exceptions.ValidationError) and error.argument is not None:
            text = f"{error.argument.name}: {error.exception_message}"
        return f"{text} (hexjet {self.name} --help)"

    def _explain_unknown(self, name: str) -> str:
        """Return one line on an unknown option, with its replacement or the nearest option."""
        if (removed := describe_removed(f"hexjet {self.name} {name}")) is not None:
            return f"{name}: {removed}"
        options = [*self.declared, *self._common_options]
        if any("--set" in each.names for each in options):
            from cosim.spec.scenario import suggest_key

            if (meant := suggest_key(name.lstrip("-").replace("-", "_"))) is not None:
                return f"No such option {name!r}; --set KEY=VALUE sets keys of the scenario: {meant}"
        from difflib import get_close_matches

        close = get_close_matches(name, [each.names[0] for each in options if each.names])
        return f"No such option {name!r}{f'; did you mean {close[0]!r}?' if close else ''}"

    def run(self, words: Sequence[str]) -> int:
        """Run the command with these words, print its result, and return the exit status."""
        if set(_HELP_FLAGS) & set(words[: [*words, "--"].index("--")]):
            echo(self.help())
            return DONE
        arguments = self.read(words)
        name_options({each.argument: each.names[0] for each in self.declared if each.names})
        self.check_out(arguments.get("out"))
        as_json, quiet = arguments.pop(_JSON, False), arguments.pop(_QUIET, False)
        shown = {_VERBOSE: arguments.pop(_VERBOSE, False)} if self._has_verbose else {}
        if arguments.pop(_TRUST, False):
            trust_everything()
        arguments |= self.given
        mode = next((each for each in self.modes if arguments.get(each) not in (None, False)), "")
        parameters = {name: parameter for name, (parameter, _) in self.parameters(mode).items()}
        self._check_mode(mode, arguments.keys() - parameters.keys() - {mode})
        if mode not in parameters:
            arguments.pop(mode, None)
        if self.folder is not None and arguments.get("out") is None:
            from cosim.flight import new_folder

            if (name := self.folder(_CompleteArguments(parameters, arguments))) is not None:
                arguments["out"] = str(new_folder(Path("runs"), name))
        with ExitStack() as stack:
            stack.enter_context(nullcontext() if self.runs_code else without_code())
            stack.enter_context(output_to_stderr(as_json))
            if quiet:
                stack.enter_context(redirect_stdout(stack.enter_context(open(devnull, "w"))))
            self.before(_CompleteArguments(parameters, arguments))
            if "progress" in parameters:
                again = self.goes_on or f"hexjet {self.name} {{folder}} --resume"
                goes_on = again if "resume" in parameters else ""
                shows = TerminalProgress(as_json or quiet, goes_on, "" if quiet else self.notes)
                arguments["progress"] = stack.enter_context(shows)
            result = self.sources(mode)[0](*_take_positional(parameters, arguments), **arguments)
        if as_json and self.data is not None:
            echo(dumps(self.data(result)))
        elif not quiet:
            self.show(result, **shown)
        return DONE if self.succeeded(result) else FLIGHT_FAILED


class _CompleteArguments(dict[str, Any]):
    """Arguments of a call; defaults complete the stated ones."""

    def __init__(self, parameters: Mapping[str, inspect.Parameter], stated: Mapping[str, Any]) -> None:
        super().__init__({name: each.default for name, each in parameters.items()} | dict(stated))


def _import_function(name: str) -> Callable[..., Any]:
    module, _, function = name.partition(":")
    found: Callable[..., Any] = getattr(import_module(module), function)
    return found


def _take_positional(parameters: Mapping[str, inspect.Parameter], arguments: dict[str, Any]) -> list[Any]:
    """Remove and return the arguments that the function takes as ``*values``."""
    values: list[Any] = []
    for name, parameter in parameters.items():
        if parameter.kind is parameter.VAR_POSITIONAL:
            values += arguments.pop(name, ())
    return values


def _make_validator(option: Option) -> Callable[[Any, Any], None]:
    """Return a validator that refuses numbers that are not finite or outside the option's limits."""

    def validate(kind: Any, value: Any) -> None:
        for each in value if isinstance(value, (list, tuple)) else (value,):
            if isinstance(each, float) and not isfinite(each):
                raise ValueError(f"{each} is not a finite number")
            if option.limits is not None and each is not None and each not in option.limits:
                raise ValueError(f"{each:g}; allowed: {option.limits}")

    return validate


def _parse_pairs(option: Option, texts: Sequence[str]) -> dict[Any, Any]:
    """Return texts ``NAME=VALUE`` as a mapping.  Raises InputError."""
    assert option.pairs is not None
    pairs: dict[Any, Any] = {}
    of_name, of_value = option.pairs
    for text in texts:
        name, equals, value = text.partition("=")
        try:
            if not equals or not name.strip() or not value.strip():
                raise ValueError
            pairs[of_name(name.strip())] = of_value(value.strip())
        except ValueError:
            raise InputError(f"{option.names[0]} {text}: must be {option.metavar}") from None
    return pairs
