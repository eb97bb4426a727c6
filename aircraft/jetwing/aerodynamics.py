"""Writes jetwing.xml, the aerodynamics of the jetwing, from its geometry: ``python aircraft/jetwing/aerodynamics.py``.

Every number is a choice of geometry, said with its reason, or a formula of textbooks, named where it stands: Helmbold
(1942) for the lift-curve slope of a straight wing, lifting-line theory for induced drag and downwash, thin-airfoil
theory for flaps (Glauert, 1927), strip theory for roll, a flat plate beyond the stall (Hoerner, Fluid-Dynamic Drag).
"""

from __future__ import annotations

from itertools import chain
from math import acos, cos, exp, pi, radians, sin, sqrt
from pathlib import Path

FILE = Path(__file__).parent / "jetwing.xml"

# Geometry, m, chosen: a rectangular wing that carries 4.51 kg from 15 m/s on at a lift coefficient of 1.2
SPAN, CHORD = 1.27, 0.21
AREA = SPAN * CHORD
DIHEDRAL = radians(3.0)
TAIL_AREA, TAIL_ASPECT, TAIL_ARM = 0.05, 4.0, 0.6
FIN_AREA, FIN_ASPECT, FIN_ARM = 0.04, 2.3, 0.6  # aspect 1.5, times 1.55 for the end plate that the tail makes
ELEVATOR, AILERON, RUDDER = 0.3, 0.25, 0.35  # of the chord
AILERON_FROM, AILERON_TO = 0.5, 0.95  # of the half span
# most deflections, rad
ELEVATOR_MOST, AILERON_MOST, RUDDER_MOST = radians(25.0), radians(20.0), radians(25.0)
STATIC_MARGIN = 0.15  # of the chord: the usual 0.05 to 0.2
CRUISE_LIFT = 0.432  # coefficient at which the tail is set to hold the pitching moment at zero: 25 m/s, 4.51 kg
OSWALD = 0.8
VISCOUS = 0.8  # of thin-airfoil theory that a flap of a small aircraft gives, chosen
# Drag areas, m^2: skin friction 0.008 of wetted wing, tail, fin, body (0.35 m^2) and nacelles (4 of 60 x 180 mm, half
# more), bases 4 x 0.0004, and four fixed legs of 8 x 200 mm with a coefficient of 1
WETTED = 2.0 * (AREA + TAIL_AREA + FIN_AREA) + 0.35 + 1.5 * 4.0 * pi * 0.06 * 0.18
DRAG_AREA = 0.008 * WETTED + 4.0 * 0.0004 + 4.0 * 0.0016
SIDE_AREA = 0.15  # m^2 of body and fin seen from the side; a plate
TOP_AREA = AREA + TAIL_AREA + 0.12  # m^2 seen from above
PLATE = 1.2  # drag coefficient of a plate of aspect ratio 6 across the stream (Hoerner, 3-16)
STALL, BLEND = radians(16.0), radians(2.0)  # where lift leaves the straight line, and how softly; Reynolds 350 000


def slope(aspect: float) -> float:
    """Helmbold: ``a = 2 pi A / (2 + sqrt(A^2 + 4))``, per rad."""
    return 2.0 * pi * aspect / (2.0 + sqrt(aspect * aspect + 4.0))


def flap(share: float) -> float:
    """Angle of attack per deflection: ``1 - (t - sin t) / pi`` with ``cos t = 2 share - 1``, less viscosity."""
    t = acos(2.0 * share - 1.0)
    return VISCOUS * (1.0 - (t - sin(t)) / pi)


ASPECT = SPAN / CHORD
WING, TAIL, FIN = slope(ASPECT), slope(TAIL_ASPECT), slope(FIN_ASPECT)
TAIL_VOLUME = TAIL_AREA * TAIL_ARM / (AREA * CHORD)
FIN_VOLUME = FIN_AREA * FIN_ARM / (AREA * SPAN)
DOWNWASH = 2.0 * WING / (pi * ASPECT)  # per rad of angle of attack, far behind
LIFT_SLOPE = WING + TAIL * TAIL_AREA / AREA * (1.0 - DOWNWASH)
ZERO_LIFT = -radians(2.0)  # of a cambered section: the body is level near cruise

DERIVATIVES = {
    "elevator, moment": -TAIL_VOLUME * TAIL * flap(ELEVATOR) * ELEVATOR_MOST,
    "elevator, lift": TAIL_AREA / AREA * TAIL * flap(ELEVATOR) * ELEVATOR_MOST,
    "pitch damping": -2.2 * TAIL * TAIL_VOLUME * TAIL_ARM / CHORD,  # a tenth for the wing
    "roll damping": -WING / 6.0,  # strips of a rectangular wing
    "aileron, roll": WING * flap(AILERON) * (AILERON_TO**2 - AILERON_FROM**2) / 4.0 * AILERON_MOST,
    "dihedral": -WING * DIHEDRAL / 4.0,
    "yaw damping": -2.0 * FIN * FIN_VOLUME * FIN_ARM / SPAN,
    "rudder, yaw": -FIN * FIN_VOLUME * flap(RUDDER) * RUDDER_MOST,
    "rudder, side": FIN * FIN_AREA / AREA * flap(RUDDER) * RUDDER_MOST,
}


def attached(alpha: float) -> float:
    """The share of the flow that is attached: 1 below the stall, 0 well beyond, and 0 from behind."""
    return 1.0 / (1.0 + exp(max(-60.0, min(60.0, (abs(alpha - ZERO_LIFT) - STALL) / (0.25 * BLEND)))))


def coefficients(alpha: float) -> tuple[float, float, float]:
    """Lift, drag and pitching moment about the centre of gravity, surfaces at zero.

    Attached: ``CL = a (alpha - alpha_0)``, ``CD = CD0 + CL^2 / (pi e A)``, ``Cm = SM (CL_cruise - CL)``.  Separated: a
    plate, whose force stands across it, ``CN = 1.2 sin alpha`` on all that is seen from above, at its middle.
    """
    share = attached(alpha)
    lift = LIFT_SLOPE * (alpha - ZERO_LIFT)
    drag = lift * lift / (pi * OSWALD * ASPECT)
    normal = PLATE * TOP_AREA / AREA * sin(alpha)
    moment = STATIC_MARGIN * (CRUISE_LIFT - lift)
    plate_moment = -STATIC_MARGIN * normal
    return (
        share * lift + (1.0 - share) * normal * cos(alpha),
        DRAG_AREA / AREA + share * drag + (1.0 - share) * normal * sin(alpha),
        share * moment + (1.0 - share) * plate_moment,
    )


def weathercock(beta: float) -> tuple[float, float]:
    """Yawing moment of the fin, its two parts: attached as a wing, ``a_v V_v beta``, and a plate."""
    share = attached(beta + ZERO_LIFT)
    return FIN_VOLUME * share * FIN * beta, FIN_VOLUME * (1.0 - share) * PLATE * sin(beta)


def alphas() -> list[float]:
    """Degrees, finer where lift bends."""
    return sorted({*map(float, chain(range(-180, -30, 5), range(-30, 31, 1), range(35, 181, 5)))})


def table(name: str, points: list[tuple[float, float]], over: str = "aero/alpha-deg") -> str:
    rows = "\n".join(f"          {at:g} {value:.6f}" for at, value in points)
    return f"""      <table name="aero/{name}">
        <independentVar lookup="row">{over}</independentVar>
        <tableData>
{rows}
        </tableData>
      </table>"""


def coefficient(name: str, which: int) -> str:
    return table(name, [(a, coefficients(radians(a))[which]) for a in alphas()])


def product(*factors: str | float) -> str:
    return "".join(f"<value>{f:.8g}</value>" if isinstance(f, float) else f"<property>{f}</property>" for f in factors)


def function(name: str, *factors: str | float, inner: str = "") -> str:
    return f"""    <function name="aero/{name}">
      <product>
        {product(*factors)}
{inner}      </product>
    </function>"""


def shared(name: str, terms: str) -> str:
    """A function that others multiply by, which JSBSim computes once, before them."""
    return f"""  <function name="aero/{name}">
    {terms}
  </function>"""


# Lift, drag and pitch see the stream in the plane of symmetry alone: cos^2 beta of the dynamic pressure
IN_PLANE = "<pow><cos><property>aero/beta-rad</property></cos><value>2</value></pow>"
# Surfaces work while the stream comes from ahead: by its part along body x, cos alpha cos beta, and none from behind.
# In a stream from the side alpha is that of next to nothing, and turns round when that does.
AHEAD = """<max><value>0</value><product>
      <cos><property>aero/alpha-rad</property></cos><cos><property>aero/beta-rad</property></cos>
    </product></max>"""
# What goes with sin beta cos beta: dihedral, which a wing across the stream does not have; and of a force along body y
# in proportion to sin beta the part across the stream.  The part along the stream, a drag, goes with sin^2 beta.
ACROSS = "        <sin><property>aero/beta-rad</property></sin><cos><property>aero/beta-rad</property></cos>\n"
SIDEWAYS = "        <pow><sin><property>aero/beta-rad</property></sin><value>2</value></pow>\n"


def document() -> str:
    d = DERIVATIVES
    q, span = "aero/pressure-area", "aero/pressure-area-span"
    c, plane, ahead = "metrics/cbarw-ft", "aero/in-plane", "aero/ahead"
    p, r, w = "velocities/p-aero-rad_sec", "velocities/r-aero-rad_sec", "velocities/q-aero-rad_sec"
    plate = SIDE_AREA / AREA * PLATE
    betas = [float(x) for x in range(-90, 91, 3)]
    turning, turned = (
        table(name, [(x, weathercock(radians(x))[part]) for x in betas], "aero/beta-deg")
        for part, name in enumerate(("cn", "cn-plate"))
    )
    common = [
        shared("pressure-area", f"<product>{product('aero/qbar-psf', 'metrics/Sw-sqft')}</product>"),
        shared("pressure-area-span", f"<product>{product(q, 'metrics/bw-ft')}</product>"),
        shared("in-plane", IN_PLANE),
        shared("ahead", AHEAD),
    ]
    axes = {
        "LIFT": [
            function("lift", q, plane, inner=coefficient("cl", 0) + "\n"),
            function("lift-elevator", q, "fcs/elevator-cmd-norm", d["elevator, lift"], ahead),
        ],
        "DRAG": [
            function("drag", q, plane, inner=coefficient("cd", 1) + "\n"),
            function("drag-side", q, plate, inner=SIDEWAYS),
        ],
        "SIDE": [
            function("side", q, -plate, inner=ACROSS),
            function("side-rudder", q, "fcs/rudder-cmd-norm", d["rudder, side"], ahead),
        ],
        "ROLL": [
            function("roll-dihedral", span, d["dihedral"], inner=ACROSS),
            function("roll-damping", span, "aero/bi2vel", p, d["roll damping"]),
            function("roll-aileron", span, "fcs/aileron-cmd-norm", d["aileron, roll"], ahead),
        ],
        "PITCH": [
            function("pitch", q, c, plane, inner=coefficient("cm", 2) + "\n"),
            function("pitch-damping", q, c, "aero/ci2vel", w, d["pitch damping"]),
            function("pitch-elevator", q, c, "fcs/elevator-cmd-norm", d["elevator, moment"], ahead),
        ],
        "YAW": [
            function("yaw-weathercock", span, ahead, inner=turning + "\n"),
            function("yaw-fin-across", span, inner=turned + "\n"),
            function("yaw-damping", span, "aero/bi2vel", r, d["yaw damping"]),
            function("yaw-rudder", span, "fcs/rudder-cmd-norm", d["rudder, yaw"], ahead),
        ],
    }
    body = "\n".join(common) + "\n"
    body += "\n".join(f'  <axis name="{name}">\n' + "\n".join(parts) + "\n  </axis>" for name, parts in axes.items())
    return f"""<?xml version="1.0" encoding="utf-8"?>
<!-- Written by aerodynamics.py beside this file, which says where every number comes from. -->
<fdm_config name="jetwing" version="2.0" release="ALPHA">
 <metrics>
  <wingarea unit="M2">{AREA:.6g}</wingarea>
  <wingspan unit="M">{SPAN:.6g}</wingspan>
  <chord unit="M">{CHORD:.6g}</chord>
 </metrics>
 <aerodynamics>
{body}
 </aerodynamics>
</fdm_config>
"""


if __name__ == "__main__":
    FILE.write_text(document(), encoding="utf-8")
    most = max(coefficients(radians(a))[0] for a in range(30))
    print(f"slope {LIFT_SLOPE:.3f} 1/rad, CD0 {DRAG_AREA / AREA:.4f}, most lift {most:.2f}")
    print({key: round(value, 4) for key, value in DERIVATIVES.items()})
