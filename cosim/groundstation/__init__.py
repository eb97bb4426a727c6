"""The vehicle before ground stations: MAVLink and the local page."""
