"""Error against run time: the stack's own steps beside every other way to integrate a scene's bodies.

`measure` runs the contenders: the fixed-step ones are `methods` on bodies that are piecewise linear, `nonlinear` on
others and `relaxed` on those that remember, `contenders` puts them into a scene (`parts`), and `outsiders` are
scipy's. `truth` is what they are measured against, made of `reference` and `tight`; `agreement` shows what single
steps are worth, `deviation` says what an error is, `costs` what a step takes, `report` and `plot` show it.
"""
