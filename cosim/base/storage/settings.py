"""What a call takes as settings or as several values, in the forms that Python users write."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from cosim.base.errors import InputError


def as_settings(values: str | Sequence[str] | Mapping[str, object]) -> list[str]:
    """Return settings as texts ``KEY=VALUE``; a mapping has the values by their dotted keys.

    Raises InputError for a value that is none of TOML on one line.
    """
    if not isinstance(values, Mapping):
        return list(as_sequence(values))
    texts = []
    for key, value in values.items():
        try:
            texts.append(f"{key}={json.dumps(str(value) if isinstance(value, Path) else value, allow_nan=False)}")
        except (TypeError, ValueError):
            raise InputError(f"settings: {key}: {value!r} is no number, text, truth value or list of these") from None
    return texts


def as_texts(values: str | Sequence[str] | Mapping[str, object]) -> list[str]:
    """Return ``KEY=TEXT`` texts from one text, several, or a mapping, whose values may be lists."""
    if isinstance(values, Mapping):
        return [f"{key}={','.join(map(_format_value, as_sequence(value)))}" for key, value in values.items()]
    return list(as_sequence(values))


def as_sequence(values: Any) -> Sequence[Any]:
    """Return a single value, text or path as a sequence of one, several values as a sequence."""
    return tuple(values) if isinstance(values, Iterable) and not isinstance(values, (str, Path, Mapping)) else (values,)


def _format_value(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)
