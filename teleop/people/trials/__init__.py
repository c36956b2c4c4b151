"""Trials with a person: `teleop study run`, the page's processes and server with a screen of a participant's own.

command.py (what is typed), conduct.py (the session, step by step,
and all that is sent to the screen), rig.py (slave, channel and master, from trial to trial), records.py (what is kept
and measured of a trial), markers.py (Lab Streaming Layer), screen.html with its style and scripts.
"""
