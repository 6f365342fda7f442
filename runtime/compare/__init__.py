"""Comparing images: metrics against a reference, and a page that shows them side by side."""
