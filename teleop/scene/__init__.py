"""Scenes: their parts, the files in which they are found, and the knobs by which they are varied.

    from teleop.scene import Scene, load_scene
"""

from teleop.scene.loading import load_scene as load_scene
from teleop.scene.scene import Scene as Scene
