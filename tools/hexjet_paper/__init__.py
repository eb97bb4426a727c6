"""The paper's numbers, its experiments, and its comparison with ours."""

import cosim  # noqa: F401 - before numpy, whose kernels it chooses
