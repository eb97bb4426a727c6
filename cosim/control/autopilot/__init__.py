"""The autopilot: modes, arming, navigation, mission, failsafes and live parameters, counted in control steps.

Blocks only: no sockets, no clocks, no files.  The same requests at the same steps give the same flight, bit for bit.
``requests`` says what may be asked, ``autopilot`` answers and flies, ``cosim.simulation.autopilot_setup`` joins it
to a flight.
"""
