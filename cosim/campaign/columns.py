"""What a campaign's folder says of its columns, so that looking at it runs none of the code that it brings.

``columns.json`` has the names of the user's metrics, and the keys that are varied.
"""

from __future__ import annotations

import json
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

from cosim.base.errors import InputError
from cosim.base.removed import WRITTEN_BEFORE
from cosim.base.storage.files import parse_json, read_file, write_whole
from cosim.campaign.folder import COLUMNS
from cosim.campaign.study.key import Key
from cosim.campaign.study.study import Study
from cosim.campaign.workers.flight_row import Kinds, custom_metric_names, kinds


def write_columns(folder: Path, study: Study) -> None:
    """Write the names of a study's columns into its folder.  Raises OSError; InputError for wrong user code."""
    keys = [asdict(replace(study.key(name), field=None)) for name in study.drawn]
    write_whole(folder / COLUMNS, json.dumps({"own": custom_metric_names(study), "keys": keys}, indent=1) + "\n")


def stored_kinds(folder: Path, study: Study) -> Kinds:
    """Return the columns of a campaign's rows and their types, as stored in its folder.

    Raises InputError for a file that is missing or says something else.
    """
    path = folder / COLUMNS
    if not path.is_file():
        raise InputError(f"{folder}: {COLUMNS} is missing, as where it was {WRITTEN_BEFORE}")
    try:
        content = parse_json(read_file(path), COLUMNS, finite=False)  # limits may be infinite
    except InputError as error:
        raise InputError(f"{path}: not the columns of a campaign: {error}") from error
    try:
        metrics = [str(name) for name in _as_list(content["own"])]
        keys = [Key(**{**key, "choices": tuple(_as_list(key["choices"]))}) for key in _as_list(content["keys"])]
    except (LookupError, TypeError) as error:
        raise InputError(
            f'{path}: not the columns of a campaign: must be an object with "own", a list of names, and "keys", a list '
            f"of objects with {', '.join(field.name for field in fields(Key))}"
        ) from error
    study.set_keys({key.path: key for key in keys})
    return kinds(study, metrics)


def _as_list(value: object) -> list[Any]:
    if not isinstance(value, list):
        raise TypeError
    return value
