"""The old name of ``hexjet_gym.vector_env``, for this version."""

import sys
from importlib import import_module

sys.modules[__name__] = import_module("hexjet_gym.vector_env")
