"""Sessions that ground stations control: MAVLink and the local page."""
