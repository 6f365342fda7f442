"""Scenes for validation, built and rendered by Blender's Cycles: a second renderer.

Runs in an environment of its own (``pip install bpy==5.0.1``, Python 3.11): nothing here imports
the rest of the project, and the rest never imports this.
"""
