"""Error against run time: the stack's own steps beside every other way to integrate a scene's bodies.

`measure` compares the contenders: the fixed-step methods of `teleop.simulation.integrators`, and scipy's solvers, which
are in `contenders`. The reference is chosen by `reference/truth`: `digits` where every body has a closed form, else
`reference`. `deviation` defines the errors and compares single steps, `report` and `plot` show the result.
"""
