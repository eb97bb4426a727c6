"""An engine of one's own: an FMU of FMI 3, here written in Python, checked, measured and flown.

Any tool may make it: OpenModelica, Simulink, C by hand.  This one is made with PythonFMU3 (``pip install pythonfmu3``).
"""

# %% The engine: faster down than up, which no engine of the library is
import subprocess
import sys
from pathlib import Path

from cosim import Scenario, fly
from cosim.files import new_folder

SOURCE = '''
from math import exp
from pythonfmu3 import Fmi3Causality, Fmi3Slave, Fmi3Variability, Float64

class Mine(Fmi3Slave):
    """Thrust follows 25 N throttle with a lag of 60 ms up and 40 ms down."""
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.time, self.throttle, self.thrust = 0.0, 0.0, 0.0
        moving = {"variability": Fmi3Variability.continuous}
        self.register_variable(Float64("time", causality=Fmi3Causality.independent, **moving))
        self.register_variable(Float64("throttle", causality=Fmi3Causality.input, **moving))
        self.register_variable(Float64("thrust", causality=Fmi3Causality.output, **moving))

    def do_step(self, time, step):
        wanted = 25.0 * self.throttle
        lag = 0.06 if wanted > self.thrust else 0.04
        self.thrust += (1.0 - exp(-step / lag)) * (wanted - self.thrust)
        return True
'''
folder = new_folder(Path("runs"), "own-engine")
folder.mkdir(parents=True)
(folder / "mine.py").write_text(SOURCE)
subprocess.run(
    [sys.executable, "-P", "-m", "pythonfmu3", "build", "-f", "mine.py", "-d", "."],
    cwd=folder,
    check=True,
    capture_output=True,
)
fmu = folder / "Mine.fmu"

# %% Its ports are found by name, its thrust at rest is measured: fly on six of it, and on five of ours and one of it
mine = str(fmu.absolute())
hover = Scenario.load("hover").replace(controller="baseline", duration_s=0.4, expect=[])
six = fly(hover.replace(engine=mine))
one = fly(hover.replace(engine="edf", stations={"3": {"engine": mine}}))
throttle, thrust = six.summary.engine_curve[-1]
print(f"{fmu.name}: {thrust:.2f} N at throttle {throttle:g}")
for name, run in (("six of it", six), ("one of it at station 3", one)):
    throttle, error = run.log["throttle_3"][-1], run.summary.altitude.max_abs_error_m
    print(f"{name}: {run.outcome}, throttle 3 in hover {throttle:.3f}, greatest error of the height {error:.3f} m")
print(
    f"next: hexjet engine check {fmu}, and hexjet design --engine {fmu} for a predictor and gains with stated margins"
)
