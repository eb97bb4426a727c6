"""PX4's and ArduPilot's parameters of a vehicle: geometry, outputs, rate loops in their units, sticks.

A rate loop of theirs answers with a torque from -1 to 1, and what 1 is of throttle or of a tilt is their mixer's: for
PX4 the normalised pseudo-inverse of ``ControlAllocationPseudoInverse`` and ``ActuatorEffectivenessMCTilt`` (1.17), for
ArduPilot half of the motors' range (``AP_MotorsMatrix::normalise_rpy_factors``, read in 4.6).  Computed from their
sources; what was flown with the programs stands in docs/autopilots.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import degrees, isfinite, nan, pi, sqrt
from pathlib import Path

import numpy as np

from cosim import InputError
from cosim.base.limits import clip
from cosim.base.signals import AXES, Vector3
from cosim.files import read_text
from cosim.spec.vehicle import RateGains, Vehicle
from hexjet_sitl.ardupilot import GNSS_CHANNEL, NEWEST_RELEASE, START_TIMING, Release
from hexjet_sitl.lockstep import PARAMETER_NAME

# Parameters that some releases lack, and do not need.  From 1.16: the low-pass of yaw's torque, 2 Hz as shipped, which
# no design has.  After 1.17: the second-order model that filters the attitude set-point.  As shipped, 50 rad/s, it
# makes roll 40 ms late; and while the stick turns the heading, the loop holds the turn back: a yaw designed for 1 % of
# overshoot had 6 %.  200 rad/s is the most that PX4 accepts.  The last two: latency of GNSS, until 1.17 and after it.
PX4_OF_SOME_RELEASES = ("MC_YAW_TQ_CUTOFF", "MC_REF_W_N", "EKF2_GPS_DELAY", "SENS_GPS0_DELAY")
_HOVER_RANGE = (0.1, 0.8)  # allowed range of MPC_THR_HOVER
_MIN_IMU_HZ, _MAX_IMU_HZ = 100, 1000  # range of IMU_INTEG_RATE


def px4_torque_scale(vehicle: Vehicle, thrust_coefficient: float = 6.5) -> Vector3:
    """Return what PX4's unit of torque commands: throttle for roll, tilt [rad] or throttle for pitch and yaw.

    Tilts count with a torque of 1 each and rotors with their levers, roll and pitch have one scale, and with tilts the
    rotors give no yaw and are told to stand at x = 0, so that they give no pitch.  Only its size: the signs are those
    of :func:`px4_parameters`, with PX4's own CA_ROTOR_CT.  Raises InputError as :func:`tilt_pitch_sign`.
    """
    columns = []
    for jet in vehicle.jets:
        x, y, _ = jet.position_m
        columns.append(
            thrust_coefficient * np.array([-y, 0.0 if vehicle.servo else x, 0.0 if vehicle.servo else jet.reaction_m])
        )
    vertical = [-thrust_coefficient] * len(columns)
    if vehicle.servo:
        pitch = tilt_pitch_sign(vehicle)
        columns += [np.array([0.0, pitch, 1.0]), np.array([0.0, pitch, -1.0])]  # left and right bank, tilted forward
        vertical += [0.0, 0.0]
    mix = np.linalg.pinv(np.vstack([np.array(columns).T, vertical]))
    tilt_scales = [np.sqrt(np.sum(mix[:, i] ** 2) / (0.5 * np.count_nonzero(np.abs(mix[:, i]) > 1e-3))) for i in (0, 1)]
    scales = (max(tilt_scales), max(tilt_scales), float(mix[:, 2].max()))
    tilt_size = vehicle.servo.range_rad if vehicle.servo else 1.0
    roll, pitch, yaw = (float(np.abs(mix[:, i]).max() / scales[i]) for i in range(3))
    return roll, tilt_size * pitch, tilt_size * yaw


def refuse_effectiveness(autopilot: str, vehicle: Vehicle) -> None:
    """Raise InputError for a vehicle with allocation by effectiveness, which autopilots do not have."""
    if vehicle.allocation == "effectiveness":
        raise InputError(
            f"{autopilot}: {vehicle.name}: is flown by effectiveness, whose gains are not in an autopilot's torques"
        )


def pair_rate_gains(vehicle: Vehicle, torque: Vector3) -> tuple[tuple[str, RateGains, float], ...]:
    """Return each axis's name, its rate gains, and the torque scale that the gains are divided by."""
    control = vehicle.control.rate
    return tuple(zip(AXES, (control.roll, control.pitch, control.yaw), torque, strict=True))


def tilt_pitch_sign(vehicle: Vehicle, min_offset_m: float = 0.01) -> float:
    """Return the sign of the pitch moment of a bank that PX4 tilts forward: 1 nose up, -1 nose down.

    A thrust that is turned forward pushes forward at the height of its jet: nose up where that is below the centre of
    gravity (z > 0).  Raises InputError for banks that PX4 has no parameters for: each of its tilts gives as much
    pitch as the other, and yaw to the other side.  ``min_offset_m``: m, to the left or right, below which PX4 gives a
    tilt no yaw.
    """
    levers = {side: [jet.position_m for jet in vehicle.jets if jet.servo == side] for side in ("left", "right")}
    heights = {side: sum(z for _, _, z in positions) for side, positions in levers.items()}
    if heights["left"] * heights["right"] <= 0.0:
        raise InputError(
            f"px4: {vehicle.name}: its banks' jets stand {_describe_height(heights['left'])} (left) and "
            f"{_describe_height(heights['right'])} (right) the centre of gravity; PX4 gives both tilts the same pitch: "
            "allowed are both banks above it, or both below"
        )
    for side, positions in levers.items():
        for x, y, _ in positions:
            if abs(y) <= min_offset_m or (y > 0.0) != (side == "right"):
                raise InputError(
                    f"px4: {vehicle.name}: the {side} bank's jet at x = {x:g} m stands at y = {y:g} m; PX4 takes a "
                    f"tilt's yaw from its side: allowed is more than {min_offset_m:g} m to the {side}"
                )
    return 1.0 if heights["left"] > 0.0 else -1.0


def _describe_height(lever: float) -> str:
    return "below" if lever > 0.0 else "above" if lever < 0.0 else "at the height of"


def px4_parameters(vehicle: Vehicle, max_rotors: int = 12) -> dict[str, float]:
    """Return PX4's parameters of a vehicle on any target: geometry, rate and attitude gains, filters.

    Control allocation is that of a multirotor, or of one with tilts.  PX4 takes what a tilt does from its direction and
    the side of its rotors, wherever these stand in height: a tilt towards the front is nose down to it.  For jets below
    the centre of gravity that is wrong, so the tilt is declared towards the back, which PX4 takes for nose up, and for
    the other side's rotors, as by PX4's rule the yaw of that tilt would have the wrong sign. Raises InputError for a
    vehicle that PX4 has no parameters for.  ``max_rotors``: limit of PX4's control allocation.
    """
    jets, control = vehicle.jets, vehicle.control
    refuse_effectiveness("px4", vehicle)
    if len(jets) > max_rotors:
        raise InputError(f"px4: {vehicle.name}: has {len(jets)} engines; allowed are {max_rotors} at most")
    parameters: dict[str, float] = {"CA_AIRFRAME": 8 if vehicle.servo else 0, "CA_ROTOR_COUNT": len(jets)}
    tilts_back = vehicle.servo is not None and tilt_pitch_sign(vehicle) > 0.0
    for index, jet in enumerate(jets):
        x, y, z = jet.position_m
        parameters |= {
            f"CA_ROTOR{index}_PX": 0.0 if vehicle.servo else x,
            f"CA_ROTOR{index}_PY": y,
            f"CA_ROTOR{index}_PZ": z,
        }
        # Positive for a counter-clockwise rotor, whose reaction turns the nose right.
        parameters[f"CA_ROTOR{index}_KM"] = jet.reaction_m
        if vehicle.servo:
            parameters[f"CA_ROTOR{index}_TILT"] = 1 if (jet.servo == "left") != tilts_back else 2
    if vehicle.servo:
        limit = degrees(vehicle.servo.range_rad)
        parameters["CA_SV_TL_COUNT"] = 2
        for index in range(2):
            parameters |= {f"CA_SV_TL{index}_MINA": -limit, f"CA_SV_TL{index}_MAXA": limit}
            parameters[f"CA_SV_TL{index}_TD"] = 180 if tilts_back else 0  # 180 deg: tilts towards the back
            parameters[f"CA_SV_TL{index}_CT"] = 3  # tilts control pitch and yaw
    for axis, gains, scale in pair_rate_gains(vehicle, px4_torque_scale(vehicle)):
        name = f"MC_{axis.upper()}RATE"
        parameters |= {
            f"{name}_P": gains.p / scale,
            f"{name}_I": gains.i / scale,
            f"{name}_D": gains.d / scale,
            f"{name}_K": 1.0,
        }
    roll, pitch, yaw = control.attitude.gain_1_s
    parameters |= {"MC_ROLL_P": roll, "MC_PITCH_P": pitch, "MC_YAW_P": yaw}
    parameters |= {
        f"MC_{axis.upper()}RATE_MAX": degrees(limit)
        for axis, limit in zip(AXES, control.attitude.rate_limit_rad_s, strict=True)
    }
    parameters |= {"MC_AIRMODE": 1.0, "MC_YAW_TQ_CUTOFF": 0.0, "MC_REF_W_N": 200.0}
    if control.rate.roll.d:
        parameters["IMU_DGYRO_CUTOFF"] = 1.0 / (2.0 * pi * control.rate.roll.d_filter_s)
    return parameters


def find_gyro_cutoff(vehicle: Vehicle) -> float | None:
    """Return the cutoff [Hz] that gives an autopilot's gyro filter the delay of the vehicle's; None without one.

    The autopilot's is a Butterworth filter of second order, whose delay well below its cutoff ``f`` is
    ``sqrt(2) / (2 pi f)``; the vehicle's, of first order, is ``filter_s`` late, with which its gains were designed.
    """
    filter_s = vehicle.sensors.gyro.filter_s
    return sqrt(2.0) / (2.0 * pi * filter_s) if filter_s > 0.0 else None


def px4_outputs(vehicle: Vehicle, prefix: str = "PWM_MAIN") -> dict[str, float]:
    """Return the parameters that assign PX4's outputs: first engines, then tilts.  ``prefix``: ``HIL_ACT`` in HIL."""
    functions = [101 + index for index in range(len(vehicle.jets))] + ([201, 202] if vehicle.servo else [])
    return {f"{prefix}_FUNC{number}": function for number, function in enumerate(functions, 1)}


def px4_link(step: float) -> dict[str, float]:
    """Return PX4 parameters for flights here in steps of ``step`` [s]: estimator rate, and sticks by MAVLink.

    PX4 answers a sample after its estimator, which has to run at each.  Sticks are in proportion, without a dead zone
    and, of yaw, a low-pass; the fifth channel arms, and the sixth selects the mode: Stabilized, and Position at
    its upper end.  Raises InputError for a step that PX4's estimator does not follow.
    """
    if step < 1.0 / _MAX_IMU_HZ:
        raise InputError(f"px4: step_s = {step:g}: its estimator takes {_MAX_IMU_HZ} samples a second at most")
    parameters: dict[str, float] = {"IMU_INTEG_RATE": max(round(1.0 / step), _MIN_IMU_HZ)}
    parameters |= {"COM_RC_IN_MODE": 0, "RC_MAP_ROLL": 1, "RC_MAP_PITCH": 2, "RC_MAP_THROTTLE": 3, "RC_MAP_YAW": 4}
    parameters |= {"RC_MAP_ARM_SW": 5, "RC_MAP_FLTMODE": 6, "RC_CHAN_CNT": 8, "RC3_TRIM": 1000}
    parameters |= {"MAN_DEADZONE": 0.0, "MPC_THR_CURVE": 1, "MPC_MANTHR_MIN": 0.0, "MPC_MAN_Y_TAU": 0.0}
    return parameters | {f"COM_FLTMODE{slot}": 8 for slot in range(1, 6)} | {"COM_FLTMODE6": 2}


def px4_hover(throttle: float) -> dict[str, float]:
    """Return PX4's parameter of the hover throttle, with which height control and landing detection start."""
    return {"MPC_THR_HOVER": clip(throttle, *_HOVER_RANGE)}


PX4_TARGETS = ("sitl", "hil", "board")  # targets of PX4 parameters


def px4_target(vehicle: Vehicle, step: float, target: str) -> dict[str, float]:
    """Return all PX4 parameters for a target: its SITL, a board in the loop, or a board that flies.

    A board that flies keeps its own radio and modes, and filters its gyro as the vehicle's is, or as PX4 ships; what a
    simulation sends is filtered already.  A name that the target does not have is an error to PX4.
    """
    parameters = px4_parameters(vehicle) | px4_outputs(vehicle, "HIL_ACT" if target == "hil" else "PWM_MAIN")
    if target == "board":
        cutoff = find_gyro_cutoff(vehicle)
        return parameters if cutoff is None else parameters | {"IMU_GYRO_CUTOFF": cutoff}
    parameters["IMU_GYRO_CUTOFF"] = 0.0
    late = round(1e3 * step * vehicle.sensors.gnss.latency_samples)  # ms; the older parameter is a float
    parameters |= px4_link(step) | {"EKF2_GPS_DELAY": float(late), "SENS_GPS0_DELAY": late}
    # PX4 logs torques and rates at each sample: logged at 50 Hz, a command would seem to act 8 ms earlier.
    return parameters | ({"SDLOG_PROFILE": 1 + 8 + 16} if target == "sitl" else {})


def without_px4_gains(parameters: Mapping[str, float]) -> dict[str, float]:
    """Return PX4's parameters without gains, rate limits and filters, so that PX4's defaults stay."""
    return {name: value for name, value in parameters.items() if not name.startswith(("MC_", "IMU_GYRO", "IMU_DGYRO"))}


# ArduCopter's frames with four motors by FRAME_TYPE: name, and each motor's number by its place and turn (front, right,
# counter-clockwise: 1, 0 or -1 each), from AP_MotorsMatrix::setup_quad_matrix, read in 4.6; 18 was flown (4.5.0-dev).
# ArduCopter's mixer knows the numbers alone: a rotor that turns the other way makes the heading run away.
_QUAD_FRAMES: dict[int, tuple[str, dict[tuple[int, int, int], int]]] = {
    1: ("X", {(1, 1, 1): 1, (-1, -1, 1): 2, (1, -1, -1): 3, (-1, 1, -1): 4}),
    18: ("X, reversed", {(-1, 1, 1): 1, (1, 1, -1): 2, (-1, -1, -1): 3, (1, -1, 1): 4}),
    0: ("plus", {(0, 1, 1): 1, (0, -1, 1): 2, (1, 0, -1): 3, (-1, 0, -1): 4}),
    6: ("plus, reversed", {(0, 1, -1): 1, (0, -1, -1): 2, (1, 0, 1): 3, (-1, 0, 1): 4}),
}
# Parameters for the sticks of hexjet sitl, 1000 to 2000 us; ArduPilot's defaults are 1100 to 1900 us, with dead zones
# of 20 and 30 us. The seventh channel arms, the last disables GNSS. Full stick is that of START_TIMING.
_ARDUPILOT_STICKS: dict[str, float] = {
    **{f"RC{n}_{key}": value for n in range(1, 5) for key, value in (("MIN", 1000), ("MAX", 2000), ("DZ", 0))},
    **{f"RC{n}_TRIM": 1000 if n == 3 else 1500 for n in range(1, 5)},
    "ATC_ANGLE_MAX": START_TIMING.lean_deg,
    "PILOT_Y_RATE": START_TIMING.turn_deg_s,
    "PILOT_Y_EXPO": 0.0,
    "RC7_OPTION": 153,
    f"RC{GNSS_CHANNEL}_OPTION": 65,
    "ARMING_SKIPCHK": -1,
}
# Names up to ArduCopter 4.6 by today's names, and the factor from today's unit. ARMING_CHECK listed the checks to make,
# and ARMING_SKIPCHK lists those to skip: all are skipped.
_NAMES_UNTIL_4_6: dict[str, tuple[str, float]] = {
    "ATC_ANGLE_MAX": ("ANGLE_MAX", 100.0),
    **{f"ATC_ACC_{axis}_MAX": (f"ATC_ACCEL_{axis}_MAX", 100.0) for axis in "RPY"},
    "ARMING_SKIPCHK": ("ARMING_CHECK", 0.0),
    "SIM_GPS1_LAG_MS": ("SIM_GPS_LAG_MS", 1.0),
}


def _convert_to_release(release: Release, parameters: Mapping[str, float]) -> dict[str, float]:
    """Return parameters with the names and units of a release of ArduCopter."""
    if release > (4, 6):
        return dict(parameters)
    older = [(_NAMES_UNTIL_4_6.get(name, (name, 1.0)), value) for name, value in parameters.items()]
    return {name: unit * value + 0.0 for (name, unit), value in older}


def ardupilot_sticks(release: Release = NEWEST_RELEASE) -> dict[str, float]:
    """Return ArduPilot's parameters for the sticks and switches of :class:`hexjet_sitl.ardupilot.Transmitter`."""
    return _convert_to_release(release, _ARDUPILOT_STICKS)


def ardupilot_torque_scale(vehicle: Vehicle) -> Vector3:
    """Return what ArduPilot's unit of torque commands: half of the motors' throttle range, or all of the tilts'."""
    half = 0.5 * (1.0 - vehicle.control.allocation.throttle_min)
    tilt = vehicle.servo.range_rad if vehicle.servo else half
    return half, tilt, tilt


def ardupilot_frame(vehicle: Vehicle) -> tuple[int, list[int]]:
    """Return ArduCopter's FRAME_TYPE of a quadrotor, and the number of its motor at each jet.

    Raises InputError for a vehicle that is no frame of ArduCopter with four motors.
    """
    jets = vehicle.jets
    if len(jets) != 4:
        raise InputError(
            f"ardupilot: {vehicle.name}: no frame of ArduCopter with {len(jets)} engines is known here, only with "
            "four; state parameters of yours (defaults): the first outputs are the engines"
        )
    positions = [tuple(int(np.sign(v)) for v in (*jet.position_m[:2], jet.reaction_m)) for jet in jets]
    for number, (_, motors) in _QUAD_FRAMES.items():
        if set(positions) == set(motors):
            return number, [motors[position] for position in positions]  # type: ignore[index]
    names = "; ".join(name for name, _ in _QUAD_FRAMES.values())
    turns = ", ".join(f"{jet.reaction_m:g}" for jet in jets)
    raise InputError(
        f"ardupilot: {vehicle.name}: vehicle.jets: no frame of ArduCopter has four rotors that stand and turn like "
        f"these (reaction_m = {turns}); allowed: {names}, where rotors across the middle turn the same way"
    )


def ardupilot_script(vehicle: Vehicle, max_motors: int = 12) -> str | None:
    """Return the Lua script that mixes the outputs of two tilting banks; None if a frame of ArduCopter fits.

    ``Motors_6DoF`` takes a motor's part of roll, pitch, yaw and throttle as they are
    (``AP_MotorsMatrix_6DoF_Scripting`` and ``AC_AttitudeControl_Multi_6DoF``, read in 4.6): an engine has throttle and
    roll, and a tilt is a motor that goes both ways, with pitch and yaw alone.  That frame flies sideways without a lean
    as it ships, which is switched off. Raises InputError for more outputs than it has.  ``max_motors``: of ArduCopter,
    AP_MOTORS_MAX_NUM_MOTORS in 4.6.
    """
    if vehicle.servo is None:
        return None
    jets = vehicle.jets
    if len(jets) + 2 > max_motors:
        raise InputError(
            f"ardupilot: {vehicle.name}: {len(jets)} engines and two tilts; allowed are {max_motors} outputs at most"
        )
    pitch = 1 if sum(jet.position_m[2] for jet in jets) > 0.0 else -1  # below the centre: nose up
    rows = [("0.5" if jet.servo == "left" else "-0.5", 0, 0, 1, "false") for jet in jets]
    rows += [("0", pitch, yaw, 0, "true") for yaw in (1, -1)]
    return "\n".join(
        [
            f"-- {vehicle.name}: {len(jets)} engines, then the left and the right tilt. For ArduCopter's folder",
            "-- scripts, with FRAME_CLASS 16 and SCR_ENABLE 1. Of each: number; roll, pitch, yaw, throttle, forward,",
            "-- right; whether it goes both ways; order in the motor test.",
            *(
                f"Motors_6DoF:add_motor({index}, {roll}, {tilt}, {yaw}, {throttle}, 0, 0, {both}, {index + 1})"
                for index, (roll, tilt, yaw, throttle, both) in enumerate(rows)
            ),
            f"assert(Motors_6DoF:init({len(rows)}), 'hexjet: the motors were not set up')",
            f"motors:set_frame_string('{vehicle.name[:20]}')",
            "attitude_control:set_forward_enable(false)",
            "attitude_control:set_lateral_enable(false)",
            "",
        ]
    )


def _ardupilot_frame_parameters(vehicle: Vehicle) -> dict[str, float]:
    """Return the parameters of frame and output functions."""
    if ardupilot_script(vehicle) is None:
        frame, motors = ardupilot_frame(vehicle)
        parameters: dict[str, float] = {"FRAME_CLASS": 1, "FRAME_TYPE": frame}
    else:
        motors = list(range(1, len(vehicle.jets) + 3))
        # A tilt is a reversible motor, whose dead zone is as large as the headroom kept for yaw.
        parameters = {"FRAME_CLASS": 16, "SCR_ENABLE": 1, "MOT_YAW_HEADROOM": 0}
    for number, motor in enumerate(motors, 1):
        parameters[f"SERVO{number}_FUNCTION"] = (32 if motor <= 8 else 73) + motor
        parameters |= {f"SERVO{number}_MIN": 1000, f"SERVO{number}_MAX": 2000}
    return parameters


ARDUPILOT_TARGETS = ("sitl", "board")  # targets of ArduPilot parameters


def ardupilot_parameters(
    vehicle: Vehicle, step: float, release: Release = NEWEST_RELEASE, target: str = "sitl"
) -> dict[str, float]:
    """Return ArduPilot's parameters of a vehicle for its SITL or a board that flies: frame, gains, filters.

    A board keeps its radio, modes and checks, and filters its gyro as the vehicle's is, or as ArduPilot ships.  The
    SITL gets the vehicle's own measurements, with bias, noise, filter and latency: drift of the gyro, noise of the
    barometer and latency of GNSS of ArduPilot's simulation are switched off.
    Raises InputError for a vehicle that neither a frame, see :func:`ardupilot_frame`, nor a script, see
    :func:`ardupilot_script`, fits.
    """
    control = vehicle.control
    refuse_effectiveness("ardupilot", vehicle)
    throttle_min = control.allocation.throttle_min
    parameters: dict[str, float] = {"SCHED_LOOP_RATE": min(round(1.0 / step), 400)}
    parameters |= _ardupilot_frame_parameters(vehicle)
    for axis, gains, scale in pair_rate_gains(vehicle, ardupilot_torque_scale(vehicle)):
        name = f"ATC_RAT_{'RLL' if axis == 'roll' else 'PIT' if axis == 'pitch' else 'YAW'}"
        parameters |= {f"{name}_P": gains.p / scale, f"{name}_I": gains.i / scale, f"{name}_D": gains.d / scale}
        # The loop was designed with the gyro's filter alone; filters of set-point and error would add delay.
        parameters |= {f"{name}_FLTT": 0.0, f"{name}_FLTE": 0.0}
        parameters[f"{name}_FLTD"] = 1.0 / (2.0 * pi * gains.d_filter_s) if gains.d else 0.0
        parameters[f"{name}_IMAX"] = min(gains.integral_limit / scale, 1.0)
    names = [f"ATC_ANG_{axis}_P" for axis in ("RLL", "PIT", "YAW")]
    parameters |= dict(zip(names, control.attitude.gain_1_s, strict=True))
    # Without shaping and feed-forward only the attitude gain remains, and without acceleration limits large errors are
    # treated like small ones: see hexjet_design.loop.firmware.
    parameters |= {"ATC_RATE_FF_ENAB": 0} | {f"ATC_ACC_{axis}_MAX": 0 for axis in "RPY"}
    parameters |= {"MOT_PWM_MIN": 1000, "MOT_PWM_MAX": 2000, "MOT_THST_EXPO": 0.0, "MOT_SPIN_MAX": 1.0}
    parameters |= {"MOT_SPIN_MIN": throttle_min, "MOT_SPIN_ARM": throttle_min}
    if target == "board":
        cutoff = find_gyro_cutoff(vehicle)
        return _convert_to_release(release, parameters | ({} if cutoff is None else {"INS_GYRO_FILTER": round(cutoff)}))
    parameters |= {"SIM_RATE_HZ": round(1.0 / step), "SIM_DRIFT_SPEED": 0, "SIM_BARO_RND": 0, "SIM_GPS1_LAG_MS": 0}
    return _convert_to_release(release, parameters | _ARDUPILOT_STICKS | {"INS_GYRO_FILTER": 0})


def ardupilot_hold(throttle: float, least: float) -> dict[str, float]:
    """Return parameters for ArduPilot's position hold, Loiter, which the fifth channel selects.

    ``throttle``: of hover, with which height control starts; ``least``: MOT_SPIN_MIN.
    """
    return {"FLTMODE6": 5, "MOT_THST_HOVER": clip((throttle - least) / (1.0 - least), 0.125, 0.6875)}


def without_ardupilot_gains(parameters: Mapping[str, float]) -> dict[str, float]:
    """Return ArduPilot's parameters without gains, shaping, filters and thrust curve: its defaults stay."""
    own = ("ATC_RA", "ATC_ANG_", "ATC_ACC", "INS_GYRO")
    kept = {name: value for name, value in parameters.items() if not name.startswith(own)}
    kept.pop("MOT_THST_EXPO", None)
    return kept


def read_parameters(path: Path) -> dict[str, float]:
    """Return the parameters of an ArduPilot file, a name and a value a line; # begins a comment.

    Raises InputError for a file that cannot be read, and for another line.
    """
    parameters: dict[str, float] = {}
    for number, line in enumerate(read_text(path).splitlines(), 1):
        words = line.split("#")[0].replace(",", " ").split()
        if not words:
            continue
        try:
            value = float(words[1])
        except (IndexError, ValueError):
            value = nan
        if not PARAMETER_NAME.fullmatch(words[0]) or not isfinite(value):
            raise InputError(f"{path}: line {number}: {line.strip()!r}: must be a name and a number, a finite one")
        parameters[words[0]] = value
    return parameters


NOTES = {  # comment lines of parameter files
    "px4": (
        "The rate loop runs at IMU_GYRO_RATEMAX, not at our step;",
        "its derivative has one filter for all axes, here roll's, and its integral a limit of its own (MC_RR_INT_LIM).",
        "With tilts the engines are told to stand at x = 0, so that the tilts alone give pitch, as ours do.",
        "With jets below the centre of gravity the tilts are told to go back (TD 180) and to carry the other side:",
        "by PX4's rule of signs that is what they do. A positive output tilts forward: the first servo is the left.",
    ),
    "ardupilot": (
        "The shipped quadrotor's and the Hex-Jet's, with its script, flew ArduCopter 4.6.0-dev and",
        "4.8.0-dev in its SITL, hover and doublets; no hardware has flown with any of them.",
    ),
}


def parameter_file(autopilot: str, parameters: Mapping[str, float], notes: Sequence[str] = ()) -> str:
    """Return the text of a parameter file: for PX4 ids, name, value and type on a line, else name and value.

    ``notes``: comment lines before those of :data:`NOTES`.
    """
    lines = [f"# {line}" for line in (*notes, *NOTES[autopilot])]
    for name, value in sorted(parameters.items()):
        if autopilot == "px4":
            whole = float(value).is_integer() and not _is_real(name)
            lines.append(f"1\t1\t{name}\t{value:.9g}\t{6 if whole else 9}")
        else:
            lines.append(f"{name},{value:.9g}")
    return "\n".join(lines) + "\n"


def _is_real(name: str) -> bool:
    """Return whether PX4 stores a parameter as a float, whatever its value."""
    integer_prefixes = (
        "CA_AIRFRAME", "CA_ROTOR_COUNT", "CA_SV_TL_COUNT", "COM_", "RC_MAP", "RC_CHAN", "MC_AIRMODE", "HIL_ACT",
        "PWM_MAIN", "IMU_INTEG_RATE", "MPC_THR_CURVE", "SDLOG_", "SENS_GPS",
    )  # fmt: skip
    return not (name.startswith(integer_prefixes) or name.endswith(("_TILT", "_CT", "_TD")))
