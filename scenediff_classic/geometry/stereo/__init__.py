"""Depth of every view, from the other views."""
