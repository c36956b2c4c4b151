"""Stages around any law with two ends: `deadband(0.1) | wave`.

    law = around("deadband(0.1)", Wave(b=3.0))          # --set law='deadband(0.1) | wave(b=3.0)'

A stage has an end of its own at each end of the law, between the law and what is beside it: its message, its force, or
the motion that it is told of. What comes out is a law like any other, a frozen dataclass of floats: the knobs of the
law keep their names, those of the stage have its name before them (`law.deadband_k`).

    names       the stages by name, and how a text names them with their numbers
    compose     a stage and a law made into one class
    deadband, guard, virtual_coupling   the stages, one file each
"""
