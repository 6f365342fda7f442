"""Scenes for validation and to learn from, built and rendered by Blender's Cycles.

Runs in an environment of its own (``pip install bpy==5.0.1``, Python 3.11): nothing here imports
the rest of the project, and of this the rest imports `record` alone, which needs no Blender.
"""
