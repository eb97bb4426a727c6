"""The constants and the C of the allocation by effectiveness, as an exported controller has them.

The C is the one that flies here, ``cosim/control/allocation/effectiveness.h``: its types go into the controller's
header and its functions into the controller, with the names that the controller's files have.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import cosim
from cosim import InputError
from cosim.base.signals import Vector3
from cosim.blocks import MAX_FIRST, MAX_ITERATIONS, EffectivenessAllocator
from cosim.spec.vehicle import Vehicle

SOURCE = Path(cosim.__file__).parent / "control" / "allocation" / "effectiveness.h"  # C source that is copied
_STRUCTURES = ("Vector", "Link", "JetStation", "ServoMover", "RowLevel", "Effectors")  # structures that are copied
_SIZES = {  # array sizes: in the source, and here
    "MOST_JETS": "JETS",
    "MOST_MOVERS": "SERVOS",
    "MOST_LINKS": "LINKS",
    "MOST_EFFECTORS": "EFFECTORS",
    "ROWS": "ROWS",
}


def make_hinged_form(allocator: EffectivenessAllocator, vehicle: Vehicle) -> dict[str, Any]:
    """Return the constants of the allocation to hinges.  Raises InputError for a vehicle with surfaces."""
    if allocator.surfaces:
        raise InputError(
            f"{vehicle.name}: surfaces have no C form; with loops the loops alone are exported, for a "
            "mixer of your own, by hexjet export vehicle the whole vehicle as an FMU"
        )
    known, servos = allocator.constants, len(vehicle.actuators)
    links = max(1, *(len(chain) for _, _, _, chain in known.stations))
    movers = [
        {"point": _vector_form(point), "axis": _vector_form(axis), "wrench": [0.0] * 6}
        | {"least": least, "most": most, "step": step, "lead": lead}
        for point, axis, least, most, step, lead in known.hinges
    ]
    effectors: dict[str, Any] = {
        "jets": str(len(known.stations)),
        "hinges": str(len(known.hinges)),
        "movers": str(len(known.hinges)),
        "jet": [
            {"place": _vector_form(place), "axis": _vector_form(axis), "twist": twist, "links": str(len(chain))}
            | ({"chain": [_link_form(*link) for link in chain]} if chain else {})
            for place, axis, twist, chain in known.stations
        ],
    }
    if movers:
        effectors["mover"] = movers
    effectors |= {"scale": known.scales, "norm": list(known.norms), "weight": known.weight, "given": "GIVEN"}
    reach = [*known.servo_limits, *[(0.0, 0.0)] * (servos - len(known.servo_limits))]
    return {
        "kind": "effectiveness",
        "links": links,
        "passes": MAX_ITERATIONS,
        "first_passes": MAX_FIRST,
        "values": {
            "effectors": effectors,
            "levels": str(len(known.levels)),
            "level": [{"rows": str(len(rows)), "row": [str(row) for row in rows]} for rows in known.levels],
            "tensor": [list(row) for row in known.tensor],
            "inverse": [list(row) for row in known.inverse],
            "share_low": [low for low, _ in known.shares],
            "share_high": [high for _, high in known.shares],
            "end_low": [low for low, _ in known.thrust_limits],
            "end_high": [high for _, high in known.thrust_limits],
            "preferred": known.preferred,
            "reach_low": [low for low, _ in reach],
            "reach_high": [high for _, high in reach],
            "rest": list(allocator.rest),
        },
    }


def _vector_form(value: Vector3) -> dict[str, float]:
    x, y, z = value
    return {"x": x, "y": y, "z": z}


def _link_form(hinge: int, effect: float, carries: bool) -> dict[str, Any]:
    return {"hinge": str(hinge), "effect": effect, "carries": "true" if carries else "false"}


def render_solver(name: str) -> tuple[str, str]:
    """Return C types and functions of the allocation, their names prefixed by the controller's ``name``."""
    text = SOURCE.read_text(encoding="utf-8")
    _, _, text = text.partition("#define MOST_EFFECTORS (MOST_JETS + MOST_MOVERS)\n\n")
    types, _, functions = text.partition("/* --- functions, and what they alone know --- */\n\n")
    functions, _, _ = functions.rpartition("#endif")
    for size, here in _SIZES.items():
        types, functions = (re.sub(rf"\b{size}\b", f"{name.upper()}_{here}", part) for part in (types, functions))
    for kind in _STRUCTURES:
        types, functions = (re.sub(rf"\b{kind}\b", f"{name}_{kind}", part) for part in (types, functions))
    return re.sub(r"\bReal\b", f"{name}_Real", types).rstrip() + "\n", _read_method_note() + functions.rstrip() + "\n"


def _read_method_note() -> str:
    """Return the comment of the C source that explains the method and its origin."""
    head, _, _ = SOURCE.read_text(encoding="utf-8").partition(" */\n")
    _, _, method = head.partition(" * --- What is solved ---\n *\n")
    return "/* Allocation.\n *\n" + method.replace(" * --- By priority ---\n *\n", "") + " */\n"
