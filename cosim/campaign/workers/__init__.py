"""Who flies: processes here, machines elsewhere."""
