"""Files: written whole or not at all, TOML as typed models, temporary ones in one place, the data installed."""

from cosim.base.storage.files import write_whole
from cosim.base.storage.paths import data_folder
from cosim.base.storage.scratch import scratch
from cosim.base.storage.toml import read_toml, validate
from cosim.flight import new_folder

__all__ = ["data_folder", "new_folder", "read_toml", "scratch", "validate", "write_whole"]
