"""Cameras of both captures in one world frame, from the pictures alone."""
