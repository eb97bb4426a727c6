"""Build of the library's engines: two archives each, generated and compiled from the engine's folder.

Everything is generated from ``engine.toml``: the C struct, both model descriptions and the token that ties them
together.  Needs the standard library and FMPy only and imports nothing of the package around it, because the package's
own build loads it by its path.
"""

from .archives import (
    ADAPTER_FILES,
    ADAPTER_GENERATED,
    FMI_VERSIONS,
    LIBRARY_SUFFIX,
    archive_path,
    build_all,
    build_one,
    compile_sources,
    hash_build_inputs,
    list_engines,
    platform_folder,
    write_archive,
)
from .definition import FMI2_SUFFIX, BuildError, EngineDefinition, VariableDefinition, read_engine
from .description import GENERATION_TOOL
from .unit_table import BASE_UNITS, UNITS

__all__ = [
    "ADAPTER_FILES",
    "ADAPTER_GENERATED",
    "BASE_UNITS",
    "FMI2_SUFFIX",
    "FMI_VERSIONS",
    "GENERATION_TOOL",
    "LIBRARY_SUFFIX",
    "UNITS",
    "BuildError",
    "EngineDefinition",
    "VariableDefinition",
    "archive_path",
    "build_all",
    "build_one",
    "compile_sources",
    "hash_build_inputs",
    "list_engines",
    "platform_folder",
    "read_engine",
    "write_archive",
]
