"""The controlled comparison: the same frames, geometry and scores for every method."""
