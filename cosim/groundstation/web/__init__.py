"""The local page of a session: ``feed`` makes its data, ``server`` serves it, ``static`` is the page itself.

Nothing on the page comes from anywhere but this folder.
"""
