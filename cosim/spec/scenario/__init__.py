"""Models of a scenario's TOML: vehicle, controller, commands, disturbances, faults and expected results.

Angles in the file are in degrees where the key says ``_deg``; everything behind
:mod:`cosim.simulation.script.command_script` and :mod:`cosim.simulation.script.disturbance_script` is in rad and SI.
"""

from cosim.spec.scenario.commands import (
    SIGNALS,
    CommandEntry,
    DoubletCommand,
    GuidedCommand,
    PlaceCommand,
    RampCommand,
    StepCommand,
    SticksCommand,
    SweepCommand,
    TableCommand,
    TrackCommand,
    VelocityCommand,
    Waypoint,
    WaypointsCommand,
)
from cosim.spec.scenario.disturbances import (
    DisturbanceEntry,
    ForceDisturbance,
    GustDisturbance,
    MomentDisturbance,
    PayloadDisturbance,
    TorqueCommandDisturbance,
    WindDisturbance,
)
from cosim.spec.scenario.faults import (
    DelayGrowth,
    EngineFault,
    Fault,
    FlameOut,
    SensorBias,
    SensorDropout,
    SensorFault,
    ServoJam,
    SlowSpool,
    StuckThrottle,
    ThrustLoss,
)
from cosim.spec.scenario.files import find_scenario, scenario_names
from cosim.spec.scenario.mismatch import Mismatch
from cosim.spec.scenario.parameter_file import parameter_files
from cosim.spec.scenario.provenance import (
    FlownParameters,
    controller_shown,
    copy_parameters,
    flown_parameters,
    list_changes,
    list_differing_keys,
)
from cosim.spec.scenario.scenario import PREDICTOR_KEEPS_MODEL, UNKNOWN_TO_CONTROLLER, Scenario, suggest_key
from cosim.spec.scenario.sections import (
    Environment,
    Expectation,
    FlightLimits,
    Initial,
    Range,
    RequireEntry,
    Station,
    unique_names,
)
from cosim.spec.scenario.substeps import SUBSTEPS, StepErrors, measured_errors
