"""Error against run time: the stack's own steps beside every other way to integrate a scene's bodies.

`measure` compares the contenders: the fixed-step methods of `teleop.simulation.integrators`, and scipy's solvers, which
are in `contenders/outsiders`. The reference is chosen by `reference/truth`: `digits` and `digit_bodies` where
every body has a closed form, else `reference` and `tight`. `steps` compares single steps, `deviation` defines the
errors, `costs` times the steps, `report` and `plot` show the result.
"""
