"""What the identification.json of every identification has (docs/identification.md)."""

SHARED = {
    "subject", "command", "output", "command_unit", "output_unit", "found", "refused", "estimates", "notes",
}  # fmt: skip
