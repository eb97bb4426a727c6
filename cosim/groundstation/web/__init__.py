"""The local page of a session: ``feed`` says what it is told, ``server`` serves it, ``static`` is the page itself.

Nothing on the page comes from anywhere but this folder.
"""
