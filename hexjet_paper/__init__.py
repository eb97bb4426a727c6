"""The paper's numbers, its experiments, and its comparison with ours."""
