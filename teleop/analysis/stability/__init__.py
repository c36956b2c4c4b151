"""The exact closed loop of a linear scene, delay and all, and how far it is from the edge.

`linear` finds the two ends as matrices, `loop` counts the roots that grow, `roots` finds the dominant one,
`margins` looks for the edge, `continuous` does so without sampling. `assess` puts them together, with the verdict of
virtual time for what is not linear; `report` tells it, `picture` and `plot` draw it.
"""
