"""What the JSON of every identification, validation and replay has (docs/identification.md)."""

SHARED = {
    "subject", "command", "output", "command_unit", "output_unit", "verdict", "evidence", "found", "refused", "estimates",
    "notes",
}  # fmt: skip
