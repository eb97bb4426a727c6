"""What ``hexjet gcs`` runs: a vehicle for ground stations, and what is printed of it."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from cosim.api.call import Limits, Result, check_types
from cosim.api.call.choices import list_engine_notes
from cosim.api.flights import load
from cosim.base.wording import printable
from cosim.cli.console import echo, note

if TYPE_CHECKING:
    from cosim.groundstation.links import Links
    from cosim.groundstation.session import Session
    from cosim.results.run import Run


class SessionResult(Result):
    """The flights of a session with ground stations."""

    def __init__(self, runs: Sequence[Run], counts: Mapping[str, Any]) -> None:
        self.runs, self.counts = runs, counts
        self.files = {}

    def to_dict(self) -> dict[str, Any]:
        """Return the summaries of the flights, and the counts of the links."""
        return {"runs": [run.summary.model_dump(mode="json") for run in self.runs], "links": self.counts}

    def lines(self) -> list[str]:
        """Return one line that sums up the session."""
        return [describe_session(self.runs, self.counts)]


@check_types(realtime_factor=Limits(0.0), duration_s=Limits(0.0, is_open=True), log_limit_mb=Limits(1.0))
def gcs(  # noqa: PLR0913 - the options of a command
    scenario: str = "hover",
    *,
    place: str | None = None,
    mavlink: Sequence[str] = (),
    system: int = 1,
    public: bool = False,
    sign_key: str | None = None,
    personality: Literal["px4", "ardupilot", "generic"] = "px4",
    parameters: str | None = None,
    realtime_factor: float = 1.0,
    duration_s: float | None = None,
    web: int | None = None,
    out: str | None = None,
    log_limit_mb: float = 2000.0,
    **choices: Any,
) -> SessionResult:
    """Run a vehicle that waits on the ground for a ground station: QGroundControl, MAVProxy, MAVSDK.

    Every flight leaves a run's folder, with telemetry.tlog and with requests.jsonl: hexjet fly on its scenario.toml
    repeats it without a ground station.

    Parameters
    ----------
    scenario : str
        What gives wind, place and faults: the name of a scenario, or the path of its file.
    place : str or None
        Where it stands, latitude and longitude in degrees.
    mavlink : sequence of str
        udpout:HOST:PORT, udpin:[HOST:]PORT, tcp:HOST:PORT or tcpin:[HOST:]PORT; by default udpout to 127.0.0.1, ports
        14550 and 14540.
    system : int
        Its MAVLink id, 1 to 250: several vehicles beside each other need one each.
    public : bool
        Let udpin and tcpin listen to the network and not to this machine alone.
    sign_key : str or None
        The file of a key: sign, and refuse what is not signed with it.
    personality : str
        What the ground station takes it for.
    parameters : str or None
        The file where parameters are kept, none for nowhere; by default one for each vehicle in the folder for
        settings.
    realtime_factor : float
        Seconds of flight in a second of the clock; 0 is as fast as it goes.
    duration_s : float or None
        Seconds of flight after which it ends; by default it runs until Ctrl-C.
    web : int or None
        Serve a page too, at this port.
    out : str or None
        The folder of the first flight; by default a new one in runs/.
    log_limit_mb : float
        The most that the log of a flight may take: what is flown beyond is not recorded.
    """
    from cosim.base.plugins.entry_points import load_hook
    from cosim.groundstation.links import Links
    from cosim.groundstation.parameter_store import find_default_file, make_vehicle_key
    from cosim.groundstation.session import RecordOptions, Session, parse_place, stop_on_signals

    loaded = load(scenario, **choices)
    changes: dict[str, Any] = {"name": "gcs" if scenario == "hover" else loaded.name}
    if place is not None:
        changes["environment"] = parse_place(place)
    loaded = loaded.replace(**changes)
    for text in list_engine_notes(loaded):
        note(text)
    key = make_vehicle_key(loaded) + (f"-system-{system}" if system != 1 else "")
    kept = None if parameters == "none" else Path(parameters) if parameters else find_default_file(key)
    key_file = None if sign_key is None else Path(sign_key)
    with Links(tuple(mavlink), public, key_file, personality, web, system) as opened:
        session = Session(
            loaded,
            opened.exchange,
            factor=realtime_factor or None,
            parameter_file=kept,
            duration=duration_s,
            records=RecordOptions(None if out is None else Path(out), log_mb=log_limit_mb),
            on_begin=opened.begin,
            on_end=opened.end,
        )
        if (make_checker := load_hook("stability_checker")) is None:
            note("changes of parameters are not judged: hexjet_design is not installed")
        else:
            session.set_stability_checker(make_checker(session.scenario))
        _print_session(session, opened, log_limit_mb)
        with stop_on_signals(session), _show_live_line(opened):
            runs = session.run()
        echo(describe_session(runs, opened.frame_counts))
        return SessionResult(runs, opened.frame_counts)


def _print_session(session: Session, links: Links, log_mb: float) -> None:
    """Print the links' addresses, the vehicle, and the folder of the recording."""
    from cosim.groundstation.session_flight import estimate_hourly_mb
    from cosim.spec.scenario import controller_shown

    scenario, site = session.scenario, session.scenario.environment
    rows = [
        ("vehicle", f"{scenario.aircraft_name}, engine {scenario.engine}, controller {controller_shown(scenario)}"),
        ("place", f"{site.latitude_deg:.6f}, {site.longitude_deg:.6f}, {site.ground_m:g} m above the sea"),
        ("system", str(links.system)),
        *[("MAVLink", _describe_link(url)) for url in links.urls],
        *([("page", links.page_url)] if links.page_url else []),
        ("parameters", f"{session.parameter_file or 'not kept'}"),
        *[("", line) for line in session.describe_saved()],
        ("run", str(session.info.folder)),
        (
            "log",
            f"{estimate_hourly_mb(session.info):.0f} MB an hour of flight, "
            f"{log_mb:g} MB a flight at most (--log-limit)",
        ),
        ("pace", "as fast as it goes" if session.factor is None else f"{session.factor:g} x real time"),
    ]
    for label, value in rows:
        echo(f"{label:11} {value}")
    echo("ready; Ctrl-C ends it")


def describe_session(runs: Sequence[Run], counts: Mapping[str, Any]) -> str:
    """Describe a session: flights, the last one's end, late steps, refused frames, and the command to repeat it."""
    from shlex import quote

    last, beyond = runs[-1], runs[-1].summary.exceeded
    refused = {reason.replace("_", " "): count for reason, count in counts["refused"].items() if count}
    why = f" ({', '.join(f'{count} {reason}' for reason, count in sorted(refused.items()))})" if refused else ""
    signatures = sum(refused.get(reason, 0) for reason in ("signature", "unsigned", "replay"))
    faults = counts["failures"]
    return "; ".join(
        [
            ", ".join([f"{len(runs)} flight{'s' if len(runs) > 1 else ''}, the last {last.summary.ending}", *beyond]),
            *_describe_late_steps(runs),
            f"{counts['taken']} frames taken, {sum(refused.values())} refused{why}",
            f"{signatures} bad signatures",
            *([f"{sum(faults.values())} faults of the links, the first: {next(iter(faults))}"] if faults else []),
            f"recorded in {' '.join(str(run.folder) for run in runs)}",
            f"again: hexjet fly {quote(f'{last.folder}/scenario.toml')}",
        ]
    )


def _describe_late_steps(runs: Sequence[Run]) -> list[str]:
    """Describe how many steps of all flights were late, unless the only flight's ending says so."""
    paced = [run.summary for run in runs if run.summary.pacing is not None]
    if not paced:
        return ["not paced"]
    if len(runs) == 1 and "of them late" in paced[0].ending:
        return []
    late = sum(each.pacing.missed_deadlines for each in paced if each.pacing is not None)
    return [
        f"{late} of {sum(each.steps for each in paced)} steps late{f' in all {len(runs)} flights' if runs[1:] else ''}"
    ]


def _describe_link(url: str) -> str:
    kind, _, address = url.partition(":")
    port = address.rpartition(":")[2]
    listeners = {f"{14540 + n}": " (MAVSDK listens there)" for n in range(10)}
    listeners["14550"] = " (QGroundControl and MAVProxy listen there)"
    if kind == "udpout":
        return f"sends to udp {address}{listeners.get(port, '')}"
    return {"udpin": f"listens at udp {address}", "tcpin": f"listens at tcp {address}"}.get(kind, f"{kind} {address}")


@contextmanager
def _show_live_line(links: Links) -> Iterator[None]:
    """Show the flight's state in one line of a terminal, twice a second, from a thread as a terminal may be slow."""
    if not sys.stderr.isatty():
        yield
        return
    import threading

    over = threading.Event()

    def print_updates() -> None:
        last_shown = 0
        while not over.wait(0.5):
            for message in links.exchange.messages:
                if message.number > last_shown:
                    last_shown = message.number
                    print(f"\r\x1b[K{message.severity.name.lower()}: {printable(message.text)}", file=sys.stderr)
            print(f"\r\x1b[K{_format_state_line(links)}", end="", file=sys.stderr, flush=True)

    thread = threading.Thread(target=print_updates, name="live line", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join(timeout=1.0)
        print("\r\x1b[K", end="", file=sys.stderr, flush=True)


def _format_state_line(links: Links) -> str:
    snapshot = links.exchange.snapshot
    if snapshot is None:
        return ""
    status, pace = snapshot.status, snapshot.pace
    state = "armed" if status.armed else "disarmed"
    speed = "" if pace.reached_factor is None else f"  {pace.reached_factor:.2f} x"
    missed = f"  steps late {pace.missed} of {pace.steps}" if pace.factor else ""
    count = sum(list(links.link.refused.values()))  # a list at once: another thread counts
    refused = f"  frames refused {count}" if count else ""
    return (
        f"{snapshot.time:8.1f} s  {status.mode.value} {state}  {snapshot.measured.altitude:6.1f} m"
        f"  stations {links.stations_heard}{speed}{missed}{refused}"
    )
