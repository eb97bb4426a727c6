"""An engine and an aircraft in; a predictor with its model, gains with their margins, and a controller file out.

``loop.channel`` is what lies between a command and its measurement, ``loop.closed_loop`` that channel with a controller
around it, ``tune`` the search, ``design`` the whole of it, ``controller_table`` what ``hexjet fly --controller`` reads.
"""
