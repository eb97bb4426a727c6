"""What pyproject.toml cannot say: the C extension, the FMUs, the MAVLink messages, the data inside the package."""

from __future__ import annotations

import importlib.util
import os
import shutil
import sys
import sysconfig
from pathlib import Path
from typing import Any, ClassVar

from setuptools import Command, Extension, setup
from setuptools.command.build import build
from setuptools.errors import CompileError

ROOT = Path(__file__).resolve().parent
DATA = ("aircraft", "engines", "scenarios")  # in the clone at the top, in the installed package under cosim/data/
NOT_DATA = shutil.ignore_patterns("__pycache__", "*.pyc", ".*")


def by_path(name: str, path: Path) -> Any:
    """One module of the package, without the package: the build's environment lacks what ``import cosim`` may need."""
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look themselves up there
    spec.loader.exec_module(module)
    return module


def build_fmus(engines: Path, fmus: Path) -> None:
    """Build every engine's FMUs with the package's own builder.

    Raises CompileError, which setuptools shows as one line.
    """
    builder = by_path("engine_build", ROOT / "cosim" / "engine" / "build.py")
    try:
        builder.build_all(engines=engines, fmus=fmus)
    except builder.BuildError as error:
        raise CompileError(str(error)) from error


def build_messages(package: Path) -> Path:
    """Make the module of MAVLink messages in ``package``.  Raises CompileError."""
    maker = by_path("mavlink_generate", ROOT / "cosim" / "mavlink" / "generate.py")
    try:
        made: Path = maker.generate(package / "mavlink")
    except maker.GenerateError as error:
        raise CompileError(str(error)) from error
    return made


class BuildData(Command):
    """Data, FMUs and messages, into the package; an editable install has its data in the clone and needs the rest only.

    A command of its own, because setuptools goes on with an editable install when a changed ``build_py`` fails.
    """

    user_options: ClassVar = [("build-lib=", "d", "where the package is put together")]

    def initialize_options(self) -> None:
        self.build_lib: str | None = None
        self.editable_mode = False

    def finalize_options(self) -> None:
        self.set_undefined_options("build", ("build_lib", "build_lib"))

    def run(self) -> None:
        if self.editable_mode:
            build_fmus(ROOT / "engines", ROOT / "fmus")
            build_messages(ROOT / "cosim")
            return
        data = self._data_folder()
        shutil.rmtree(data, ignore_errors=True)  # an earlier build may have left what is no longer in the clone
        for name in DATA:
            shutil.copytree(ROOT / name, data / name, ignore=NOT_DATA)
        build_fmus(data / "engines", data / "fmus")
        build_messages(data.parent)

    def get_source_files(self) -> list[str]:
        """None to add: MANIFEST.in names the folders."""
        return []

    def get_outputs(self) -> list[str]:
        if self.editable_mode:
            return []
        data = [path for path in self._data_folder().rglob("*") if path.is_file()]
        return [str(path) for path in (*data, self._data_folder().parent / "mavlink" / "_messages.py")]

    def get_output_mapping(self) -> dict[str, str]:
        """No file here is a link to one in the clone."""
        return {}

    def _data_folder(self) -> Path:
        assert self.build_lib is not None
        return Path(self.build_lib) / "cosim" / "data"


class BuildAll(build):
    """Modules and extension as ever, then the data."""

    sub_commands: ClassVar = [*build.sub_commands, ("build_data", None)]


# The extension keeps to the limited API, so that one wheel serves every Python; free-threaded builds do not have it.
LIMITED_API = not sysconfig.get_config_var("Py_GIL_DISABLED")

setup(
    cmdclass={"build": BuildAll, "build_data": BuildData},
    ext_modules=[
        Extension(
            "cosim.engine._bank",
            sources=["cosim/engine/_bank.c"],
            define_macros=[("Py_LIMITED_API", "0x030B0000")] if LIMITED_API else [],
            py_limited_api=LIMITED_API,
            # no fused multiply-add: the same bits from every build
            extra_compile_args=[] if os.name == "nt" else ["-std=c11", "-O2", "-ffp-contract=off"],
        )
    ],
    options={"bdist_wheel": {"py_limited_api": "cp311"}} if LIMITED_API else {},
)
