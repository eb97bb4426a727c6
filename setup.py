"""What pyproject.toml cannot say: the compiled modules, the FMUs, the MAVLink messages, the data inside the package.

``HEXJET_PURE`` set in the environment leaves out what mypyc would compile: see ``cosim/base/compiled.py``.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import sys
import sysconfig
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, ClassVar

from setuptools import Command, Extension, setup
from setuptools.command.build import build
from setuptools.command.build_ext import build_ext
from setuptools.command.editable_wheel import editable_wheel
from setuptools.errors import CompileError

ROOT = Path(__file__).resolve().parent
DATA = ("aircraft", "engines", "scenarios", "studies")  # in the clone at the top, installed under cosim/data/
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


def tell(progress: str) -> None:
    """Say what is being done; the Makefile shows these lines while pip builds."""
    print(f"set-up: {progress}", flush=True)


def build_fmus(engines: Path, fmus: Path) -> None:
    """Build every engine's FMUs with the package's own builder.

    Raises CompileError, which setuptools shows as one line.
    """
    builder = by_path("engine_library", ROOT / "cosim" / "engine" / "library" / "__init__.py")
    try:
        builder.build_all(engines=engines, fmus=fmus)
    except builder.BuildError as error:
        raise CompileError(str(error)) from error


def build_messages(package: Path) -> Path:
    """Make the module of MAVLink messages in ``package``.  Raises CompileError."""
    maker = by_path("mavlink_generate", ROOT / "cosim" / "groundstation" / "mavlink" / "wire" / "generate.py")
    try:
        made: Path = maker.generate(package / "groundstation" / "mavlink" / "wire")
    except maker.GenerateError as error:
        raise CompileError(str(error)) from error
    return made


# mypyc's view of the types: of the package alone, so that it does not matter what else is installed
MYPY = """[mypy]
python_version = 3.11
disallow_untyped_defs = True
follow_imports = silent
[mypy-fmpy.*,jsbsim.*,numpy.*,pydantic.*,pyarrow.*,scipy.*]
follow_imports = skip
ignore_missing_imports = True
"""
NATIVE = "cosim._native"


class BuildExtensions(build_ext):
    """The C extensions, and the modules that mypyc compiles.

    mypyc is asked when extensions are built, and not whenever setuptools wants to know names.
    """

    def run(self) -> None:
        self.parallel = self.parallel or os.cpu_count()
        compiled = by_path("compiled", ROOT / "cosim" / "base" / "compiled.py")
        package = ROOT / "cosim" if self.inplace else Path(self.build_lib) / "cosim"
        shared = package / compiled.SHARED
        if os.environ.get(compiled.PURE_VARIABLE):
            self._remove_compiled(package, compiled)
            super().run()
            return
        modules = [f"cosim/{name}" for name in compiled.MODULES]
        made_of = [ROOT / name for name in (*modules, "setup.py", "requirements.lock", "cosim/base/compiled.py")]
        began = time.time_ns()
        if shared.is_file() and all(path.stat().st_mtime_ns <= shared.stat().st_mtime_ns for path in made_of):
            super().run()
            return
        self._remove_compiled(package, compiled)
        tell(f"mypy translates {len(modules)} modules to C, which takes a minute of a processor to compile")
        self.distribution.ext_modules = [*self.extensions, *by_mypyc(modules, Path(self.build_temp))]
        self.swig_opts = None  # split once already, and not split twice
        self.finalize_options()
        try:
            super().run()
        except BaseException:
            shared.unlink(missing_ok=True)  # without it no module that is there already is used
            raise
        os.utime(shared, ns=(began, began))  # a source that was edited meanwhile is newer

    def build_extension(self, ext: Extension) -> None:
        """Compile the many files of what mypyc's modules share several at a time: one alone takes a minute or two."""
        if len(ext.sources) > 1:
            with ThreadPoolExecutor(os.cpu_count()) as pool:
                objects = []
                for done, made in enumerate(pool.map(lambda source: self._compile_one(ext, source), ext.sources), 1):
                    objects += made
                    if done % 10 == 0 or done == len(ext.sources):
                        tell(f"{done} of {len(ext.sources)} C files compiled")
            ext.sources, ext.extra_objects = [], objects
        super().build_extension(ext)

    def _compile_one(self, ext: Extension, source: str) -> list[str]:
        made: list[str] = self.compiler.compile(
            [source],
            output_dir=self.build_temp,
            include_dirs=ext.include_dirs,
            extra_postargs=ext.extra_compile_args,
            macros=ext.define_macros,
            depends=ext.depends,
        )
        return made

    def _remove_compiled(self, package: Path, compiled: Any) -> None:
        """What an earlier build compiled for this Python: it may be of modules that are no longer compiled."""
        (package / compiled.SHARED).unlink(missing_ok=True)
        suffix = sysconfig.get_config_var("EXT_SUFFIX")
        for path in package.rglob(f"*{suffix}"):
            if not path.with_name(f"{path.name.removesuffix(suffix)}.c").exists():
                path.unlink()


def by_mypyc(modules: list[str], folder: Path) -> list[Extension]:
    """The extensions that these modules become; the C is written to ``folder``, a file for each module.

    -O2 and direct calls make a step some 8 % cheaper outside JSBSim than -O1 (processor time, flights in turn), and
    take longer to compile; -Os, which is smaller, makes it a third dearer.
    """
    try:
        from mypyc.build import mypycify
    except ImportError:
        reason = "mypy: not found; install mypy, or set HEXJET_PURE=1 to go without compiled modules"
        raise CompileError(reason) from None

    folder.mkdir(parents=True, exist_ok=True)
    config = folder / "mypy.ini"
    config.write_text(MYPY, encoding="utf-8")
    options = ["--config-file", str(config), "--cache-dir", str(folder / "mypy")]
    found: list[Extension] = mypycify([*options, *modules], target_dir=str(folder), group_name=NATIVE, multi_file=True)
    for extension in found:
        extension.extra_compile_args = [*c_flags(os.environ.get("HEXJET_OPTIMISATION", "-O2")), "-g0", "-w", *DIRECT]
        extension.extra_link_args = list(SYMBOLIC)
        extension.include_dirs.append(str(folder / "cosim"))  # of the group's headers
    return found


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
            tell("the engines' FMUs and the messages of MAVLink")
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
        return [
            str(path)
            for path in (*data, self._data_folder().parent / "groundstation" / "mavlink" / "wire" / "_messages.py")
        ]

    def get_output_mapping(self) -> dict[str, str]:
        """No file here is a link to one in the clone."""
        return {}

    def _data_folder(self) -> Path:
        assert self.build_lib is not None
        return Path(self.build_lib) / "cosim" / "data"


class BuildAll(build):
    """Modules and extension as ever, then the data."""

    sub_commands: ClassVar = [*build.sub_commands, ("build_data", None)]


class PathFile:
    """An editable install as a ``.pth`` file with the folders of all packages, which needs no import hook."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __call__(self, wheel: Any, files: list[str], mapping: dict[str, str]) -> None:
        wheel.writestr(f"__editable__.{self.name}.pth", f"{ROOT}\n{ROOT / 'tools'}\n")

    def __enter__(self) -> PathFile:
        return self

    def __exit__(self, *_: object) -> None:
        """Leave nothing behind."""


class EditableInstall(editable_wheel):
    """An editable install of packages in two folders.

    setuptools writes a ``.pth`` file for one folder alone; for two it would install an import hook, which every start
    of Python in the environment would pay for.
    """

    def _select_strategy(self, name: str, tag: str, build_lib: Any) -> PathFile:
        return PathFile(name)


# The engines' extension keeps to the limited API, which free-threaded builds do not have; the recorder's does not.
LIMITED_API = not sysconfig.get_config_var("Py_GIL_DISABLED")


# What mypyc makes calls itself and Python directly, with no table between.
DIRECT = ("-fno-plt", "-fno-semantic-interposition", "-fvisibility=hidden") if sys.platform == "linux" else ()
SYMBOLIC = ("-Wl,-Bsymbolic",) if sys.platform == "linux" else ()


def c_flags(level: str) -> list[str]:
    """For the compiler: no fused multiply-add, so that every build gives the same bits."""
    return [] if os.name == "nt" else ["-std=c11", level, "-ffp-contract=off"]


setup(
    cmdclass={
        "build": BuildAll,
        "build_data": BuildData,
        "build_ext": BuildExtensions,
        "editable_wheel": EditableInstall,
    },
    ext_modules=[
        Extension(
            "cosim.engine._bank",
            sources=["cosim/engine/_bank.c"],
            define_macros=[("Py_LIMITED_API", "0x030B0000")] if LIMITED_API else [],
            py_limited_api=LIMITED_API,
            extra_compile_args=c_flags("-O2"),
        ),
        Extension(
            "cosim.control.allocation._effectiveness",
            sources=["cosim/control/allocation/_effectiveness.c"],
            depends=["cosim/control/allocation/effectiveness.h"],
            extra_compile_args=c_flags("-O3"),
        ),
        Extension("cosim.base._turning", sources=["cosim/base/_turning.c"], extra_compile_args=c_flags("-O2")),
        Extension(
            "cosim.vehicle._properties", sources=["cosim/vehicle/_properties.c"], extra_compile_args=c_flags("-O2")
        ),
        Extension("cosim.vehicle._noise", sources=["cosim/vehicle/_noise.c"], extra_compile_args=c_flags("-O2")),
        Extension("cosim.results._rows", sources=["cosim/results/_rows.c"], extra_compile_args=c_flags("-O3")),
    ],
)
