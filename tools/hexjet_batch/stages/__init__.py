"""The stages of a control step over arrays; :mod:`hexjet_batch.stages.step` has them in order."""
