"""The paper's figures and pages."""
