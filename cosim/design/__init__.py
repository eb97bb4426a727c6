"""An engine and an aircraft in; a predictor with its model, gains with their margins, and a controller file out.

``channel`` is what lies between a command and its measurement, ``closed`` that channel with a controller around it,
``tune`` the search, ``make`` the whole design, ``file`` what ``hexjet fly --controller`` reads.
"""
