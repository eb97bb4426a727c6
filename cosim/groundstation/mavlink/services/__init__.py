"""MAVLink's protocols, one a file: commands, missions, parameters, files, logs."""
