"""LuxCore's scenes, to test on a renderer that no network has learned from."""
