"""A vehicle as its ``vehicle.toml`` states it: geometry, mass, engine stations, sensors, gains, identified models.

Body frame: forward-right-down (FRD), origin at the centre of gravity of the vehicle as built.
"""

from cosim.spec.vehicle.body import GroundEffect
from cosim.spec.vehicle.files import (
    VEHICLE,
    aircraft_name,
    aircraft_names,
    aircraft_seen_from,
    as_read,
    engine_of,
    file_seen_from,
    find_aircraft,
    is_file,
    is_own,
    load_vehicle,
)
from cosim.spec.vehicle.gains import (
    AllocationLimits,
    AltitudeGains,
    AttitudeGains,
    Control,
    EngineLead,
    Leads,
    MonitorSettings,
    PilotSettings,
    PositionGains,
    PredictorTuning,
    RateGains,
    Schedule,
    ScheduledGains,
    ThrustLevel,
    WingControl,
)
from cosim.spec.vehicle.rate_model import RateModel, read_models
from cosim.spec.vehicle.sensors import PositionSensor, Sensors
from cosim.spec.vehicle.stations import Airflow, Hinge, Jet, Servo, Surface, layout_of
from cosim.spec.vehicle.vehicle import STEP_S, Limits, Step, Vehicle

__all__ = [
    "STEP_S",
    "VEHICLE",
    "Airflow",
    "AllocationLimits",
    "AltitudeGains",
    "AttitudeGains",
    "Control",
    "EngineLead",
    "GroundEffect",
    "Hinge",
    "Jet",
    "Leads",
    "Limits",
    "MonitorSettings",
    "PilotSettings",
    "PositionGains",
    "PositionSensor",
    "PredictorTuning",
    "RateGains",
    "RateModel",
    "Schedule",
    "ScheduledGains",
    "Sensors",
    "Servo",
    "Step",
    "Surface",
    "ThrustLevel",
    "Vehicle",
    "WingControl",
    "aircraft_name",
    "aircraft_names",
    "aircraft_seen_from",
    "as_read",
    "engine_of",
    "file_seen_from",
    "find_aircraft",
    "is_file",
    "is_own",
    "layout_of",
    "load_vehicle",
    "read_models",
]
