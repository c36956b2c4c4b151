"""Error against run time: the exact steps beside every other way to integrate a scene's bodies.

`measure` runs the contenders, `methods` are the fixed-step ones and `outsiders` scipy's; `agreement` shows
that two references agree, `deviation` says what an error is, `report` and `figure` tell it.
"""
