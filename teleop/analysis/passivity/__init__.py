"""Terminations with which a scene stays stable: passivity of one port, absolute stability of two.

`sampled` is the damping that a force held between samples needs, `coupling` what a virtual coupling allows the
environment behind it, `two_port` the hybrid matrix of a teleoperator and Llewellyn's criterion; `peak` finds the
worst frequency for them. `one_port` judges a scene without a slave, what is not linear in it too;
`report` and `plot` show it.
"""
