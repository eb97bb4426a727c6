"""Files: written whole or not at all, TOML as typed models, temporary ones in one place, the data installed."""

from cosim.base.storage.files import map_os_errors, read_text, write_whole
from cosim.base.storage.paths import data_folder
from cosim.base.storage.scratch import scratch, temporary
from cosim.base.storage.toml import Model, parse_numbers, read_toml, validate
from cosim.flight import new_folder

__all__ = [
    "Model", "data_folder", "map_os_errors", "new_folder", "parse_numbers", "read_text", "read_toml", "scratch",
    "temporary", "validate", "write_whole",
]  # fmt: skip
