"""Controllers from outside: found by name, loaded, guarded, and told what they may believe."""
