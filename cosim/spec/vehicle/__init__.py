"""A vehicle as its ``vehicle.toml`` states it: geometry, mass, engine stations, sensors, gains, identified models.

Body frame: forward-right-down (FRD), origin at the centre of gravity of the vehicle as built.
"""

from cosim.spec.vehicle.body import GroundEffect
from cosim.spec.vehicle.files import (
    VEHICLE,
    aircraft_name,
    aircraft_names,
    aircraft_seen_from,
    engine_of,
    file_seen_from,
    find_aircraft,
    is_aircraft_path,
    is_file,
    load_vehicle,
    read_tables,
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
