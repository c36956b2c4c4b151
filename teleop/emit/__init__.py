"""Printer of an end as C99: the lines of its tick and the guard around them, for microcontrollers.

    types        the types of C, and what stands for a value while a function is printed
    primitives   Python's functions that C has a line for, and what each refuses where Python raises
    expressions, calls, statements   one Python function as one C function
    ticks        the generator of a live end as `init` and `tick`
    guard        the guard around the tick as `begin` and `step`
    vectors      what Python answers to inputs, tame and wild, for check.c and for tests
    wire         the numbers of packets
    compiled     C and Python beside each other, where a compiler is there
    files        the files; `command` has the command
"""
