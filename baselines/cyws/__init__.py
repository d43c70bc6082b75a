"""CYWS-2D and CYWS-3D: networks that box what differs between two pictures (see docs/cyws.md)."""
