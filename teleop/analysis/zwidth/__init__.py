"""Z-width: the range of impedance that a device renders, from its own to the most it keeps passive.

`passive` is the passive region in the plane of virtual stiffness and damping, `plane` the stable one, `impedance` the
curves over frequency; `assess` asks them all, what comes to rest in virtual time and what widens it. `report` and
`plot` show it.
"""
