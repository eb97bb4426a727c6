"""What every test runs under."""

from __future__ import annotations

import signal
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from command_tools import Done, Hexjet
from hypothesis import HealthCheck, settings
from patience import PATIENCE
from places import TESTS

from cosim.base.runtime.kernels import set_for_command
from cosim.base.runtime.threads import one_thread
from cosim.base.storage.scratch import scratch

one_thread()  # beside other tests
set_for_command()  # in the processes that tests start too: some import numpy before cosim
# a machine that is busy with other work is no failure
settings.register_profile("any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any machine")

# A shell starts what it runs in the background with Ctrl-C ignored, and every process of a test would inherit that.
if threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

BROWSER_FLAGS = [
    # WebGL by software, the same on every machine
    "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
]  # fmt: skip


KINDS = {"clients": "client", "process": "process", "flight": "flight", "unit": "unit"}  # those that wait most first
# the files that take longest: a worker that began one of them last would end long after the others
LONG = (
    "test_gcs_mavsdk", "test_engine_broken", "test_gcs_conformance", "test_failsafes", "test_campaign_cluster", "test_design_proof",
    "test_gcs_link", "test_design", "test_pilot_energy", "test_campaign_workers", "test_engine_check", "test_codegen", "test_campaign_store",
    "test_own_controller", "test_gcs_session", "test_web", "test_pilot_flight", "test_scenarios", "test_campaign_run", "test_reproduce",
    "test_pilot_envelope", "test_campaign_report", "test_prove", "test_engine_out", "test_faults", "test_identify", "test_measured_margins",
    "test_campaign_rare", "test_worst_folder", "test_engine_archives", "test_controller_process", "test_package",
    "test_vehicle_export", "test_design_stored", "test_own_blocks", "test_examples",
    "test_engine_library", "test_engine_build",
)  # fmt: skip


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """A test has the mark of the folder that it is in; long files come first, files of short tests last."""
    for item in items:
        item.add_marker(KINDS[_kind(item)])
    kinds, places = list(KINDS), {name: place for place, name in enumerate(LONG)}
    items.sort(key=lambda item: (places.get(item.path.stem, len(LONG)), kinds.index(_kind(item))))


def _kind(item: pytest.Item) -> str:
    return next(part for part in item.path.relative_to(TESTS).parts if part in KINDS)


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """What is remembered about engines, and whose code is trusted, is remembered for these tests alone."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        patch.setenv("XDG_CONFIG_HOME", str(tmp_path_factory.mktemp("settings")))
        patch.setenv("HEXJET_TRUST", "1")  # what a test writes is the test's; test_trust.py is a stranger's
        scratch()  # now, so that a test which looks for temporary files finds all others
        yield


@pytest.fixture(scope="session")
def built_engines() -> None:
    """The shipped engines' FMUs, built from the sources there are."""
    from cosim.engine.source import build_engines

    build_engines()


@pytest.fixture
def hexjet(capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Hexjet:
    """Run the command in an empty folder; everything that any library prints is caught too."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str) -> Done:
        from cosim.cli.main import main

        with pytest.raises(SystemExit) as end:
            main(list(arguments))
        out, err = capfd.readouterr()
        return Done(int(end.value.code or 0), out, err)

    return run


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A headless browser that is installed; without one the test says that it was skipped."""
    from benchmarks.measures.browser import find_browser

    found = find_browser()
    # what stands in for a browser that is not installed answers with an error
    if found is None or subprocess.run([found, "--version"], capture_output=True).returncode:
        pytest.skip("no browser: install chromium, or name one in HEXJET_BROWSER")
    playwright = pytest.importorskip("playwright.sync_api", reason="no playwright: pip install playwright")
    with playwright.sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=found, args=BROWSER_FLAGS)
        started.new_context, started.new_page = patient(started.new_context), patient(started.new_page)
        yield started
        started.close()


def patient(make: Callable[..., Any]) -> Callable[..., Any]:
    """What opens a page or a context that waits as tests wait: half a minute is too short on a busy machine."""

    def opened(**options: Any) -> Any:
        made = make(**options)
        made.set_default_timeout(1000.0 * PATIENCE)
        return made

    return opened
