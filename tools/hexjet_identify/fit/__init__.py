"""The one fit of an engine's logs: forms, noise, bounds, and whether a form explains what was measured."""
