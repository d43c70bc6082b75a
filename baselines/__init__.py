"""Methods to compare with, behind the same interface."""
