"""Built-in scenes, one file each: a function `scene` whose keyword parameters are its knobs.

Nothing is checked or loaded here, so that the command in `__main__` can say in one sentence whose `teleop`
it has found; a scene's own imports check the same.
"""
