"""hexjet gcs: a vehicle for ground stations."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

from cosim.base.wording import printable
from cosim.cli.console import echo, note, output_to_stderr
from cosim.cli.old import opt
from cosim.cli.old.options import DONE, FLIGHT_FAILED, Flight, example

if TYPE_CHECKING:
    from cosim.groundstation.links import Links
    from cosim.groundstation.session import Session
    from cosim.results.run import Run


class Gcs(Flight, opt.Output):
    """Options of ``hexjet gcs``."""

    scenario = opt.option(
        "--scenario",
        default="hover",
        metavar="NAME|FILE",
        help="Scenario that gives wind, place and faults.  [default: a calm day]",
    )
    aircraft = opt.word(
        "--aircraft", "NAME|DIR", "Overrides the scenario's, with its engine; see: hexjet list aircraft."
    )
    engines = opt.ENGINES
    controller = opt.word("--controller", "NAME|FILE", "See: hexjet list controllers.")
    settings = opt.SETTINGS
    seed = opt.whole("--seed", None, "Overrides the scenario's seed.")
    metrics, own_observers, sensors, wind = opt.METRICS, opt.OBSERVERS, opt.SENSORS, opt.WIND
    unchecked_engine = opt.flag("--unchecked-engine", "As in hexjet fly.")
    place = opt.word("--place", "LAT,LON", "Where it stands, in degrees.")
    links = opt.words(
        "--mavlink",
        "URL",
        "udpout:HOST:PORT, udpin:[HOST:]PORT, tcp:HOST:PORT or tcpin:[HOST:]PORT.  [default: udpout "
        "to 127.0.0.1, ports 14550 and 14540]",
    )
    system = opt.option(
        "--system",
        type=int,
        default=1,
        show_default=True,
        metavar="N",
        help="Its MAVLink id, 1 to 250: several vehicles beside each other need one each.",
    )
    public = opt.flag("--public", "Let udpin and tcpin listen to the network and not to this machine alone.")
    sign_key = opt.path("--sign-key", "FILE", "Sign, and refuse what is not signed with it.")
    personality = opt.choice(
        "--personality", ["px4", "ardupilot", "generic"], "What the ground station takes it for.", "px4"
    )
    parameters = opt.renamed(
        opt.path(
            "--parameters",
            "FILE.toml",
            "Where parameters are kept; none: nowhere.  [default: one file a vehicle in the folder for settings]",
        ),
        "--params",
    )
    rtf = opt.number(
        "--rtf", "X", "Pace the flight at X times real time; 0 is as fast as it goes.", min=0.0, default=1.0
    )
    duration = opt.positive("--duration", "S", "[default: until Ctrl-C]")
    web: int | None = opt.option(
        "--web", type=click.IntRange(0, 65535), is_flag=False, flag_value=8765, metavar="[PORT]",
        help="Serve a page too.",
    )  # fmt: skip
    out = opt.OUT
    log_limit = opt.number(
        "--log-limit",
        "MB",
        "The most that a flight's log may take: what is flown beyond is not recorded.",
        min=1.0,
        default=2000.0,
    )
    as_json = opt.json("Print one JSON object at the end and nothing else.")


@click.command(epilog=example("hexjet gcs --engine edf-as-flown --place 22.35,113.59 --web"))
@opt.takes(Gcs)
def gcs(options: Gcs) -> int:
    """Run a vehicle that waits on the ground for a ground station: QGroundControl, MAVProxy, MAVSDK.

    Every flight leaves a run's folder, with telemetry.tlog and with requests.jsonl: hexjet fly on its scenario.toml
    repeats it without a ground station.  Status as of hexjet fly, for the last flight: 0 completed within its
    limits; 1 it failed or went beyond them; 2 wrong input.
    """
    from cosim.base.plugins.entry_points import load_hook
    from cosim.groundstation.links import Links
    from cosim.groundstation.parameter_store import find_default_file, make_vehicle_key
    from cosim.groundstation.session import RecordOptions, Session, parse_place, stop_on_signals

    loaded = options.load()
    changes: dict[str, Any] = {"name": "gcs" if options.scenario == "hover" else loaded.name}
    if options.place is not None:
        changes["environment"] = parse_place(options.place)
    loaded = loaded.replace(**changes)
    key = make_vehicle_key(loaded) + (f"-system-{options.system}" if options.system != 1 else "")
    parameters = None if str(options.parameters) == "none" else options.parameters or find_default_file(key)
    as_json = options.as_json
    with (
        output_to_stderr(as_json),
        Links(
            options.links, options.public, options.sign_key, options.personality, options.web, options.system
        ) as opened,
    ):
        session = Session(
            loaded,
            opened.exchange,
            factor=options.rtf or None,
            parameter_file=parameters,
            duration=options.duration,
            records=RecordOptions(options.out, log_mb=options.log_limit),
            on_begin=opened.begin,
            on_end=opened.end,
        )
        if (make_checker := load_hook("stability_checker")) is None:
            note("changes of parameters are not judged: hexjet_design is not installed")
        else:
            session.set_stability_checker(make_checker(session.scenario))
        print_gcs(session, opened, options.log_limit, to_stderr=as_json)
        with stop_on_signals(session), live_line(opened, quiet=as_json):
            runs = session.run()
        counts = opened.frame_counts
    print_session(runs, counts, to_stderr=as_json)
    options.answer(
        lambda: {"runs": [run.summary.model_dump(mode="json") for run in runs], "links": counts}, lambda: None
    )
    return DONE if runs[-1].summary.succeeded else FLIGHT_FAILED


def print_gcs(session: Session, links: Links, log_mb: float, to_stderr: bool) -> None:
    """Print where to connect, what flies, and where it is recorded."""
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
        echo(f"{label:11} {value}", err=to_stderr)
    echo("ready; Ctrl-C ends it", err=to_stderr)


def print_session(runs: Sequence[Run], counts: Mapping[str, Any], to_stderr: bool) -> None:
    """Print in a line how a session went."""
    echo(session_line(runs, counts), err=to_stderr)


def session_line(runs: Sequence[Run], counts: Mapping[str, Any]) -> str:
    """Describe a session: flights, the last one's end, late steps, what the links refused, and how to repeat it."""
    from shlex import quote

    last, beyond = runs[-1], runs[-1].summary.exceeded
    refused = {reason.replace("_", " "): count for reason, count in counts["refused"].items() if count}
    why = f" ({', '.join(f'{count} {reason}' for reason, count in sorted(refused.items()))})" if refused else ""
    signatures = sum(refused.get(reason, 0) for reason in ("signature", "unsigned", "replay"))
    faults = counts["failures"]
    return "; ".join(
        [
            ", ".join([f"{len(runs)} flight{'s' if len(runs) > 1 else ''}, the last {last.summary.ending}", *beyond]),
            *_late_steps(runs),
            f"{counts['taken']} frames taken, {sum(refused.values())} refused{why}",
            f"{signatures} bad signatures",
            *([f"{sum(faults.values())} faults of the links, the first: {next(iter(faults))}"] if faults else []),
            f"recorded in {' '.join(str(run.folder) for run in runs)}",
            f"again: hexjet fly {quote(f'{last.folder}/scenario.toml')}",
        ]
    )


def _late_steps(runs: Sequence[Run]) -> list[str]:
    """Return how many steps of all flights were late, where the end of the only flight does not say so."""
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
def live_line(links: Links, quiet: bool) -> Iterator[None]:
    """Show a line about the flight, twice a second, on a terminal; from a thread, because a terminal may be slow."""
    if quiet or not sys.stderr.isatty():
        yield
        return
    import threading

    over = threading.Event()

    def show() -> None:
        last_shown = 0
        while not over.wait(0.5):
            for message in links.exchange.messages:
                if message.number > last_shown:
                    last_shown = message.number
                    print(f"\r\x1b[K{message.severity.name.lower()}: {printable(message.text)}", file=sys.stderr)
            print(f"\r\x1b[K{_state(links)}", end="", file=sys.stderr, flush=True)

    thread = threading.Thread(target=show, name="live line", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join(timeout=1.0)
        print("\r\x1b[K", end="", file=sys.stderr, flush=True)


def _state(links: Links) -> str:
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
