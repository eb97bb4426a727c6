"""The vehicle as Gymnasium environments: one flight, ``HexJetEnv``, and many on arrays, ``HexJetVectorEnv``.

The only package that imports ``gymnasium``, which the extra ``gym`` brings.
"""

try:
    import gymnasium
except ModuleNotFoundError as error:
    if error.name != "gymnasium":
        raise
    raise ModuleNotFoundError(
        "hexjet_gym needs gymnasium, which is not installed: pip install gymnasium", name="gymnasium"
    ) from None

from hexjet_gym.env import ANGLE_SCALE, HEIGHT_SCALE, MAX_CLIMB, HexJetEnv, Reward, Signal, Vary, time_on_target
from hexjet_gym.vector_env import HexJetVectorEnv

__all__ = ["ANGLE_SCALE", "HEIGHT_SCALE", "MAX_CLIMB", "HexJetEnv", "HexJetVectorEnv", "Reward", "Signal", "Vary",
           "time_on_target"]  # fmt: skip

gymnasium.register(id="HexJet-v0", entry_point="hexjet_gym:HexJetEnv")
