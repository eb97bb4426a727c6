"""Predictor and gains designed for an engine, margins measured in flight, and the limit of what any design reaches.

``loop.channel`` is what lies between a command and its measurement, ``loop.closed_loop`` that channel with a controller
around it, ``tune`` the search, ``design`` the whole of it, ``controller_table`` what ``hexjet fly --controller`` reads.
``measured.excitation`` breaks a loop and flies a multisine through the break, ``measured.estimate`` turns the periods
into margins with bounds, ``measured.computed`` has those of a built-in controller, ``measured.margins`` is the whole.
"""
