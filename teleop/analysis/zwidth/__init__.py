"""Z-width: the range of impedance that a device renders, from its own to the most it keeps passive.

`passive` is the passive region in the plane of virtual stiffness and damping, `plane` the stable one, `impedance` the
curves over frequency, `measured` what comes to rest in virtual time, `levers` what widens it; `assess` asks them all,
`report` and `plot` show it.
"""
